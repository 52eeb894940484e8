"""Which pixels of a fitted recording are the part's, and which rest: its frames as views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.geometry.rigid_motion import MIN_POINTS, RigidMotion
from akm_fg.model.surface_cloud import View
from akm_fg.perception.change.depth_change import depth_change, surface_points
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.moving_part.part_mask import propagate_masks
from akm_fg.perception.observed import ObservedMotion
from akm_fg.posterior import JointPosterior
from akm_fg.records import BoolArray, FloatArray, Recording
from akm_fg.steps import to_end


@dataclass(frozen=True, slots=True)
class PartView:
    """One frame: where the part is in it, and what of its pixels is the part's."""

    number: int  # in the recording
    part: View
    moving: BoolArray  # (H, W)
    static: BoolArray  # (H, W) rests, near the object


def spread_frames(q: FloatArray, count: int) -> list[int]:
    """At most `count` frames with states (T,) that are known, spread over these; growing.

    The first frame with a state is among them.
    """
    known = np.flatnonzero(np.isfinite(q))
    if not known.size:
        return []
    wanted = np.linspace(q[known].min(), q[known].max(), count)
    nearest = {int(known[np.argmin(np.abs(q[known] - w))]) for w in wanted}
    return sorted(nearest | {int(known[0])})


def part_views(
    recording: Recording,
    observed: ObservedMotion,
    joint: JointPosterior,
    q: FloatArray,
    closed_state: float,
    frames: Sequence[int],
    noise: DepthNoiseModel,
    config: PerceptionConfig,
) -> list[PartView]:
    """Judge every pixel of chosen frames by the fitted joint.

    Args:
        recording: T frames.
        observed: what was seen in it.
        joint: of the part.
        q: (T,) its states; NaN where not known.
        closed_state: at which the part's frame is the world's.
        frames: numbers of the frames; their states are known.
        noise: of the depth.
        config: of perception.
    """
    known = np.isfinite(q)
    R, t = joint.joint.motion(np.where(known, q, 0.0))
    shape = _shape(recording, observed, R, t, known, noise, config)
    motion = RigidMotion(R, t, shape, known, np.ones(len(shape), dtype=bool), 1.0)
    (R_closed,), (t_closed,) = joint.joint.motion(np.array([closed_state]))
    T_closed = gtsam.Pose3(gtsam.Rot3(R_closed), t_closed)
    views = []
    for mask in propagate_masks(recording, observed, frames, noise, config.surface.mask, motion):
        k = mask.frame
        T_world_part = gtsam.Pose3(gtsam.Rot3(R[k]), t[k]) * T_closed.inverse()
        view = View(recording.frames[k], T_world_part, k == 0)
        views.append(PartView(k, view, mask.moving, mask.static))
    return views


def _shape(
    recording: Recording,
    observed: ObservedMotion,
    R_world: FloatArray,
    t_world: FloatArray,
    known: BoolArray,
    noise: DepthNoiseModel,
    config: PerceptionConfig,
) -> FloatArray:
    """Points (N, 3) of the part at state zero: its tracks, or what depth shows to have moved."""
    tracks = observed.moving_tracks
    seen = tracks.observed & known[:, None]
    back = np.einsum("tji,tnj->tni", R_world, tracks.p_world - t_world[:, None])
    count = seen.sum(axis=0)
    shape = np.where(seen[..., None], back, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    if (count > 0).sum() >= MIN_POINTS:
        return np.asarray(shape[count > 0])
    change = to_end(depth_change(recording, observed.object_mask, noise, config.change.change))
    far = int(np.argmax(np.where(known, change.area_m2, -1.0)))
    points = surface_points(change, far, change.nearer[far])
    return np.asarray((points - t_world[far]) @ R_world[far])
