"""Is the gripper where the part is, and does it go as the part goes?

While it holds, it is at the object and carried along by the joint. Where it is not, the poses of
camera and gripper are not in the same world: the usual slips are tried, and the one that puts the
gripper on the object is named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import BoolArray, Doubt, FloatArray, Recording, RgbdFrame
from factors.joint import Joint

_OPENGL = gtsam.Pose3(gtsam.Rot3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
_MM = 1e-3
_LARGE_M = 50.0  # farther than any arm or camera from its world; 5 cm in millimetres


@dataclass(frozen=True, slots=True)
class GripperPlaceConfig:
    """What counts as apart."""

    apart_m: float = 0.2  # from the object's surface: handles, fingers and calibration are less
    together_m: float = 0.15  # where another reading of the poses puts it
    points: int = 3000  # of the object's surface
    slip_m: float = 0.05  # by which fingers may slide along a handle
    slip_share: float = 0.3  # of the gripper's way, on top
    turn_rad: float = 0.35  # of the gripper: less is how a hand leans
    turn_share: float = 0.7  # of the larger turn, by which the two may differ: hands pivot


@dataclass(frozen=True, slots=True)
class _Slip:
    """A way to get a pose wrong."""

    name: str
    camera: Callable[[gtsam.Pose3], gtsam.Pose3]  # what T_world_cam would be
    gripper: Callable[[FloatArray], FloatArray]  # where the gripper would be


def _same(x: FloatArray) -> FloatArray:
    return x


def _from_mm(x: FloatArray) -> FloatArray:
    """Where millimetres put it; nowhere if it was near enough to be in metres."""
    return _MM * x if np.linalg.norm(x) > _LARGE_M else np.full(3, np.inf)


_SLIPS = (
    _Slip("T_world_cam is likely inverted: it should take the camera's axes to the world's",
          lambda T: T.inverse(), _same),
    _Slip("T_world_cam is likely in OpenGL's axes (y up, z backwards): x right, y down, z forward",
          lambda T: T * _OPENGL, _same),
    _Slip("T_world_cam is likely inverted and in OpenGL's axes",
          lambda T: (_OPENGL * T).inverse(), _same),
    _Slip("T_world_gripper is likely in millimetres", lambda T: T, _from_mm),
    _Slip("T_world_cam is likely in millimetres",
          lambda T: gtsam.Pose3(T.rotation(), _from_mm(T.translation())), _same),
)  # fmt: skip


def place_doubts(
    recording: Recording, object_mask: BoolArray, config: GripperPlaceConfig | None = None
) -> list[Doubt]:
    """About where the gripper is, when it takes hold, against the object in the first frame.

    Args:
        recording: its gripper's poses, where it has any.
        object_mask: (H, W) in the first frame.
        config: tuning.
    """
    config = config or GripperPlaceConfig()
    if recording.T_world_gripper is None or recording.grasp_frames is None:
        return []
    hand = np.asarray(recording.T_world_gripper[recording.grasp_frames[0]].translation())
    first = recording.frames[0]
    p_cam = _surface(first, object_mask, config)
    if not p_cam.size:
        return []
    apart_m = _distance(first.T_world_cam, p_cam, hand)
    if apart_m <= config.apart_m:
        return []
    tried = [
        (_distance(slip.camera(first.T_world_cam), p_cam, slip.gripper(hand)), slip.name)
        for slip in _SLIPS
    ]
    nearest_m, name = min(tried)
    off = f"the gripper takes hold {apart_m:.2f} m from the object"
    if nearest_m < config.together_m:
        return [Doubt(f"{off}: {name}")]
    return [Doubt(f"{off}; expected T_world_gripper and T_world_cam in the same world, metres")]


def motion_doubts(
    recording: Recording, joint: Joint, q: FloatArray, config: GripperPlaceConfig | None = None
) -> list[Doubt]:
    """About how the gripper goes while it holds, against the part.

    Args:
        recording: its gripper's poses, where it has any.
        joint: by which the part goes.
        q: (T,) its states; NaN where unknown.
        config: tuning.
    """
    config = config or GripperPlaceConfig()
    grips, held = recording.T_world_gripper, recording.grasp_frames
    if grips is None or held is None:
        return []
    known = np.flatnonzero(np.isfinite(q))
    known = known[(known >= held[0]) & (known <= held[1])]
    if known.size < 2:
        return []
    a, b = int(known[q[known].argmin()]), int(known[q[known].argmax()])
    R, t = joint.motion(q[[a, b]])
    part = gtsam.Pose3(gtsam.Rot3(R[1] @ R[0].T), t[1] - R[1] @ R[0].T @ t[0])
    grip = grips[b] * grips[a].inverse()
    return _apart(part, grip, np.asarray(grips[a].translation()), config)


def _apart(
    part: gtsam.Pose3, grip: gtsam.Pose3, hand: FloatArray, config: GripperPlaceConfig
) -> list[Doubt]:
    """Of two motions of what should be one body, world, at the gripper's place."""
    gone, carried = grip.transformFrom(hand) - hand, part.transformFrom(hand) - hand
    off_m, way_m = float(np.linalg.norm(gone - carried)), float(np.linalg.norm(gone))
    found = []
    same = "expected a gripper that holds the part, in the camera's world and at its time"
    if off_m > config.slip_m + config.slip_share * max(way_m, float(np.linalg.norm(carried))):
        found.append(
            Doubt(
                f"while it holds, the gripper goes {way_m:.2f} m where the part would take it "
                f"{np.linalg.norm(carried):.2f} m, {off_m:.2f} m apart; {same}"
            )
        )
    turns = [float(np.linalg.norm(gtsam.Rot3.Logmap(T.rotation()))) for T in (grip, part)]
    apart = float(np.linalg.norm(gtsam.Rot3.Logmap(part.rotation().between(grip.rotation()))))
    if turns[0] > config.turn_rad and apart > config.turn_share * max(turns):
        found.append(
            Doubt(
                f"while it holds, the gripper turns by {np.rad2deg(turns[0]):.0f} deg and the part "
                f"by {np.rad2deg(turns[1]):.0f}, {np.rad2deg(apart):.0f} deg apart; {same}"
            )
        )
    return found


def _surface(frame: RgbdFrame, mask: BoolArray, config: GripperPlaceConfig) -> FloatArray:
    """Points (N, 3) of the masked pixels in the camera's axes, thinned out."""
    v, u = np.nonzero(mask & np.isfinite(frame.depth_m))
    step = max(1, v.size // config.points)
    v, u = v[::step], u[::step]
    uv = np.stack([u, v], axis=-1).astype(np.float64)
    return frame.camera.back_project(uv, frame.depth_m[v, u].astype(np.float64))


def _distance(T_world_cam: gtsam.Pose3, p_cam: FloatArray, hand_world: FloatArray) -> float:
    """Of the gripper from the nearest point."""
    hand_cam = T_world_cam.transformTo(hand_world)
    distance = float(np.linalg.norm(p_cam - hand_cam, axis=1).min())
    return distance if np.isfinite(distance) else np.inf
