"""The frames that a report shows, drawn on and encoded."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.posterior import JointPosterior, normal_bound
from akm_fg.records import Recording
from akm_fg.report.axis_image import ELLIPSE_SIGMAS, axis_of_joint
from akm_fg.report.overlay import Image, OverlayConfig, draw_frame, enlargement, region_name
from akm_fg.report.summary import RunSummary
from akm_fg.report.wording import size, state

_MAGNIFICATIONS = (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)


@dataclass(frozen=True, slots=True)
class Picture:
    """One encoded picture with its words (plain text)."""

    jpeg: bytes
    caption: str
    width: int
    height: int


def shown_frames(summary: RunSummary) -> tuple[int, ...]:
    """The end of the pull first, then the beginning and the end of the run; none twice."""
    n = summary.frame_count
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
    frames = _recording(summary).frames
    states, q = summary.frame_states, _state_at(summary, index)
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    factor = band_magnification(summary, config)
    image = draw_frame(
        frames[index], index, summary.tracks, joint, q, summary.truth, config, factor
    )
    words = [f"Frame {index} (of 0–{len(frames) - 1}), {_phase(summary, index)}"]
    words.append(f"{frames[index].stamp_s - frames[0].stamp_s:.1f} s")
    if states is not None:
        words.append(f"state {state(q, states.unit)}" if np.isfinite(q) else "state not seen")
    if summary.tracks is None or index >= len(summary.tracks.pixels.visible):
        words.append("points were not tracked here")
    height, width = image.shape[:2]
    return Picture(_jpeg(image, config.jpeg_quality), ", ".join(words) + ".", width, height)


def _recording(summary: RunSummary) -> Recording:
    if summary.recording is None:
        raise ValueError("a run without images has no pictures")
    return summary.recording


def _state_at(summary: RunSummary, index: int) -> float:
    """NaN where unknown."""
    states = summary.frame_states
    known = states is not None and index < len(states.mean)
    return float(states.mean[index]) if states is not None and known else float("nan")


def _phase(summary: RunSummary, index: int) -> str:
    if summary.closed_loop_frame is None:
        return "recording"
    return "pull" if index < summary.closed_loop_frame else "closed loop"


def band_magnification(summary: RunSummary, config: OverlayConfig | None = None) -> int:
    """How many times as wide as it is the axis' 95 % region is drawn; 1 where it can be seen."""
    config = config or OverlayConfig()
    half = _half_width_px(summary, config)
    if half is None or half == 0 or half >= config.thin_band_px:
        return 1
    wanted = config.visible_band_px / half
    return next((m for m in _MAGNIFICATIONS if m >= wanted), _MAGNIFICATIONS[-1])


def axis_note(summary: RunSummary, config: OverlayConfig | None = None) -> str | None:
    """What the axis in the pictures says in numbers, and whether its band is to scale."""
    config = config or OverlayConfig()
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is None:
        return None
    angle = size(joint.axis_bound_rad(), "rad")
    if not joint.turns:
        text = f"The arrow shows the sliding direction, with 95 % probability true to {angle}. "
    else:
        place = size(joint.pivot_bound_m(), "m")
        text = (
            f"The line shows the hinge axis, with 95 % probability true to {angle} "
            f"and to {place} at the pivot (the dot). "
        )
    return text + _width_note(summary, joint, config)


def _width_note(summary: RunSummary, joint: JointPosterior, config: OverlayConfig) -> str:
    half = _half_width_px(summary, config)
    name, factor = region_name(joint.kind), band_magnification(summary, config)
    if half is None:
        return "It lies outside the picture, or the camera looks along it."
    if factor == 1:
        return f"Its {name} is to scale and reaches {half:.0f} px to either side of the line."
    width = "less than 0.1 px" if half < 0.1 else f"{half:.1f} px"
    return (
        f"Its {name} reaches {width} to either side, which cannot be seen: it is drawn {factor} "
        "times as wide as it is. The lines are where they are."
    )


def _half_width_px(summary: RunSummary, config: OverlayConfig) -> float | None:
    """Largest half width of the 95 % region in the main, enlarged picture; None if unseen."""
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is None:
        return None
    index = shown_frames(summary)[0]
    frame = _recording(summary).frames[index]
    reach = config.reach_m if joint.turns else config.arrow_m
    q = _state_at(summary, index)
    axis = axis_of_joint(joint, q, frame.camera, frame.T_world_cam, reach)
    inside = ((axis.uv >= 0) & (axis.uv < (frame.camera.width, frame.camera.height))).all(axis=1)
    half = axis.half_width_px[inside & np.isfinite(axis.half_width_px)]
    if not half.size:
        return None
    # A cone's end is an ellipse, of two dimensions.
    shape = 1.0 if joint.turns else ELLIPSE_SIGMAS / normal_bound()
    return float(half.max()) * shape * enlargement(frame.camera.width, config)


def _jpeg(image: Image, quality: int) -> bytes:
    """Encoded at full colour resolution, so that thin lines keep their colour."""
    settings = [
        cv2.IMWRITE_JPEG_QUALITY, quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]  # fmt: skip
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)
    assert done, "an 8 bit image can always be encoded"
    return data.tobytes()
