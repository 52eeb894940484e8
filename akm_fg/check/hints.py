"""What will hinder a fit, a line each: what is seen, and what is expected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.check.records import Changes, RecordingCheck
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.other_view import stands_still
from akm_fg.perception.rig.camera_motion import StillCamera
from akm_fg.perception.rig.depth_against_colour import depth_unit_doubts, lag_doubts
from akm_fg.perception.rig.gripper_place import place_doubts
from akm_fg.perception.rig.unseen import unseen_doubts
from akm_fg.records import BoolArray, Recording


@dataclass(frozen=True, slots=True)
class HintConfig:
    """From when on something is said."""

    least_frames: int = 8
    slowest_hz: float = 5.0  # points that go farther between two frames are lost
    gap_steps: float = 4.0  # times the median step
    least_depth: float = 0.5  # share of the pixels
    dark: float = 25.0  # median grey level
    bright: float = 240.0
    least_object: float = 0.02  # share of the picture
    border: float = 0.25  # of the picture's edge, taken by the object
    least_corners: int = 40
    least_change: float = 0.002  # share of the picture
    most_change: float = 0.7
    off_up_deg: float = 15.0
    roll_deg: float = 45.0


@dataclass(frozen=True, slots=True)
class Looked:
    """What the hints rest on, besides what is told."""

    recording: Recording
    compared: NDArray[np.int_]  # numbers of frames
    object_mask: BoolArray | None
    changes: Changes
    perception: PerceptionConfig
    noise_times: float  # NaN where unknown


def hints_of(found: RecordingCheck, looked: Looked, config: HintConfig) -> RecordingCheck:
    """What was found, with its hints."""
    hints = [
        *_of_depth(found, looked, config),
        *_of_rig(looked),
        *_of_motion(found, config),
        *_of_object(found, looked, config),
        *_of_time(found, config),
        *_of_floor(found, config),
    ]
    return replace(found, hints=tuple(hints))


def _of_depth(found: RecordingCheck, looked: Looked, config: HintConfig) -> list[str]:
    rig = looked.perception.rig
    frames = looked.recording.frames
    said = [doubt.text for doubt in depth_unit_doubts(frames[0], rig.depth)]
    if found.depth_share < config.least_depth:
        share = 100 * found.depth_share
        said.append(f"only {share:.0f} % of the pixels have depth; expected half of them or more")
    if looked.object_mask is not None:
        some = [frames[i] for i in looked.compared]
        said += [d.text for d in unseen_doubts(some, looked.object_mask, rig.without_depth)]
    trusted = looked.perception.observe.measured_noise.trusted
    assumed = trusted > 0.0  # else (--sensor measured) the first picture says it, whatever it is
    if assumed and found.noise_times is not None and found.noise_times > trusted:
        said.append(
            f"depth is {found.noise_times:.1f} times as noisy as assumed: bounds will be wider; "
            "--sensor says which camera it is"
        )
    return said


def _of_rig(looked: Looked) -> list[str]:
    """Camera, gripper, depth and colour against each other, as a fit does."""
    recording, rig = looked.recording, looked.perception.rig
    if looked.object_mask is None:
        return []
    first, noise = recording.frames[0], looked.perception.observe.noise
    still = StillCamera(first, looked.object_mask, noise, rig.camera)
    motion = still.motion({int(i): recording.frames[i] for i in looked.compared})
    said = [] if motion is None else [motion.doubt().text]
    said += [d.text for d in place_doubts(recording, looked.object_mask, rig.gripper)]
    if motion is None and stands_still(recording.frames):
        said += [doubt.text for doubt in lag_doubts(recording.frames, rig.depth)]
    return said


def _of_motion(found: RecordingCheck, config: HintConfig) -> list[str]:
    share = found.changes.changed_share
    if len(found.compared) > 1 and share < config.least_change:
        return ["nothing moves by more than a centimetre; expected a part that opens"]
    if share > config.most_change:
        told = f"{100 * share:.0f} % of the picture changes"
        return [f"{told}; expected surroundings that stand still, seen by a camera that does"]
    return []


def _of_object(found: RecordingCheck, looked: Looked, config: HintConfig) -> list[str]:
    if found.object_mask is None:
        return ["no object stands out from floor and wall; expected one, or mask/ in the folder"]
    said = []
    if found.object_share < config.least_object:
        share = 100 * found.object_share
        said.append(f"the object fills {share:.1f} % of the picture; expected a closer camera")
    mask = found.object_mask
    edge = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    if edge.mean() > config.border:
        said.append("the object is cut off by the picture's border; expected the whole in view")
    if found.object_corners < config.least_corners:
        told = f"only {found.object_corners} points on the object can be followed"
        said.append(f"{told}; expected texture, light, or a closer camera")
    if not config.dark <= found.brightness <= config.bright:
        word = "dark" if found.brightness < config.dark else "bright"
        told = f"the picture is too {word} (median grey level {found.brightness:.0f} of 255)"
        said.append(f"{told}; expected {config.dark:.0f} to {config.bright:.0f}")
    return said


def _of_time(found: RecordingCheck, config: HintConfig) -> list[str]:
    said = []
    if found.frames < config.least_frames:
        said.append(f"only {found.frames} frames; expected {config.least_frames} or more")
    if found.rate_hz is not None and found.rate_hz < config.slowest_hz:
        told = f"{found.rate_hz:.2g} frames a second"
        said.append(f"{told}: points may be lost between them; expected {config.slowest_hz:g}")
    if found.rate_hz is not None and found.longest_gap_s * found.rate_hz > config.gap_steps:
        said.append(
            f"a gap of {found.longest_gap_s:.2f} s between frames, where the usual step is "
            f"{1 / found.rate_hz:.3f} s; expected frames that follow on each other"
        )
    return said


def _of_floor(found: RecordingCheck, config: HintConfig) -> list[str]:
    floor = found.floor
    if floor is None:
        return []
    said = []
    if floor.off_up_deg > config.off_up_deg:
        said.append(
            f"the floor's normal is {floor.off_up_deg:.0f} deg off the world's up: if it is a "
            "floor, T_world_cam is inverted, in other axes, or --up is another axis"
        )
    if abs(floor.roll_deg) > config.roll_deg:
        said.append(f"the picture is turned by {floor.roll_deg:.0f} deg; expected it upright")
    return said
