"""The frames that a report shows, drawn on and encoded."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.estimation.posterior import JointPosterior
from akm_fg.report.axis_image import axis_of_joint
from akm_fg.report.overlay import Image, OverlayConfig, draw_frame, enlargement
from akm_fg.report.summary import RunSummary
from akm_fg.report.wording import size, state

_JPEG_QUALITY = 85
_THIN_BAND_PX = 3.0  # half width in the enlarged picture below which the line hides its band


@dataclass(frozen=True, slots=True)
class Picture:
    """One encoded picture with its words (plain text)."""

    jpeg: bytes
    caption: str
    width: int
    height: int


def shown_frames(summary: RunSummary) -> tuple[int, ...]:
    """The end of the pull first, then the beginning and the end of the run; none twice."""
    n = len(summary.recording.frames)
    turn = summary.closed_loop_frame
    pull_end = n - 1 if turn is None else max(turn - 1, 0)
    start = (0,) if n > 1 else ()
    middle = (pull_end // 2,) if turn is None else ()
    return tuple(dict.fromkeys((pull_end, *start, *middle, n - 1)))


def pictures(summary: RunSummary, config: OverlayConfig | None = None) -> tuple[Picture, ...]:
    """Draw the shown frames; the main one first."""
    config = config or OverlayConfig()
    return tuple(_picture(summary, index, config) for index in shown_frames(summary))


def _picture(summary: RunSummary, index: int, config: OverlayConfig) -> Picture:
    frames = summary.recording.frames
    states = summary.frame_states
    known = states is not None and index < len(states.mean)
    q = float(states.mean[index]) if states is not None and known else float("nan")
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    image = draw_frame(frames[index], index, summary.tracks, joint, q, summary.truth, config)
    words = [f"Frame {index} of {len(frames) - 1}, {_phase(summary, index)}"]
    words.append(f"{frames[index].stamp_s - frames[0].stamp_s:.1f} s")
    if states is not None:
        words.append(f"state {state(q, states.unit)}" if np.isfinite(q) else "state not seen")
    if summary.tracks is None or index >= len(summary.tracks.pixels.visible):
        words.append("points were not tracked here")
    height, width = image.shape[:2]
    return Picture(_jpeg(image), ", ".join(words) + ".", width, height)


def _phase(summary: RunSummary, index: int) -> str:
    if summary.closed_loop_frame is None:
        return "recording"
    return "pull" if index < summary.closed_loop_frame else "closed loop"


def axis_note(summary: RunSummary, config: OverlayConfig | None = None) -> str | None:
    """What the axis in the pictures says in numbers, and whether its band can be seen at all."""
    config = config or OverlayConfig()
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is None:
        return None
    angle = size(joint.axis_bound_rad(), "rad")
    if joint.kind == "prismatic":
        text = f"The arrow shows the sliding direction, with 95 % probability true to {angle}"
    else:
        place = size(joint.pivot_bound_m(), "m")
        text = (
            f"The line shows the hinge axis, with 95 % probability true to {angle} "
            f"and to {place} at the pivot (the dot)"
        )
    return text + _width_note(summary, joint, config)


def _width_note(summary: RunSummary, joint: JointPosterior, config: OverlayConfig) -> str:
    frame = summary.recording.frames[shown_frames(summary)[0]]
    reach = config.arrow_m if joint.kind == "prismatic" else config.reach_m
    axis = axis_of_joint(joint, 0.0, frame.camera, frame.T_world_cam, reach)
    inside = ((axis.uv >= 0) & (axis.uv < (frame.camera.width, frame.camera.height))).all(axis=1)
    half = axis.half_width_px[inside & np.isfinite(axis.half_width_px)]
    half = half * enlargement(frame.camera.width, config)
    if not inside.any():
        return ". It lies outside the picture."
    if not half.size:
        return ". The camera looks along it, so it shows as a point."
    name = "cone" if joint.kind == "prismatic" else "band"
    if half.max() < _THIN_BAND_PX:
        return (
            f". Its {name} is at most {half.max():.1f} px wide to either side: the line hides it."
        )
    return f". Its {name} reaches up to {half.max():.0f} px to either side of the line."


def _jpeg(image: Image) -> bytes:
    """Encoded at full colour resolution, so that thin lines keep their colour."""
    settings = [
        cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]  # fmt: skip
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)
    assert done, "an 8 bit image can always be encoded"
    return data.tobytes()
