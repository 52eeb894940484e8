"""The moving part's joint and states from depth alone: a start where nothing can be tracked.

The camera stands still. In every keyframe the part's largest face is the plane that explains most
of the nearer pixels (`depth_change`); in frame 0 the same face is where those pixels were. Of a
drawer these planes are parallel: its axis starts along their normal, its states are their
distances. Of a hinge they all hold its axis: each plane and that of frame 0 meet near it
(`face_planes`, `face_joints`). The states of all frames follow from the face, one by one, also
where the change is below the noise of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.perception.change.change_config import DepthChangeConfig
from akm_fg.perception.change.depth_change import (
    DepthChange,
    change_frames,
    depth_change,
    explained_share,
    nearest_pixels,
)
from akm_fg.perception.change.face_joints import FaceJointConfig, FaceStart, starts_from_faces
from akm_fg.perception.change.face_planes import FaceConfig, face_planes
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, FloatArray, Recording
from akm_fg.steps import Steps
from factors.joint import skew
from factors.student_t import weight

_SEARCHED_A_PIECE = 8  # frames in which the face is looked for without a pause: 20 ms


@dataclass(frozen=True, slots=True)
class DepthMotionConfig:
    """Tuning of the way from depth to a joint."""

    change: DepthChangeConfig = field(default_factory=DepthChangeConfig)
    face: FaceConfig = field(default_factory=FaceConfig)
    joint: FaceJointConfig = field(default_factory=FaceJointConfig)
    keyframes: int = 8  # beside frame 0
    gates_m: tuple[float, ...] = (0.03, 0.03, 0.02, 0.01, 0.01)  # of points off the face, a step
    gate_sigmas: float = 3.0  # of a reading, on top
    dof: float = 4.0  # of the Student-t weights of points: other surfaces are common
    search_m: tuple[float, ...] = (0.0, 0.03, -0.03, 0.06, -0.06, 0.09, -0.09)  # from a neighbour
    # How far the guess may be off that says where the part was in frame 0: a centimetre is seen.
    first_off_m: tuple[float, ...] = tuple(0.01 * i for i in range(-6, 7))
    surely_seen: float = 0.5  # of the most points of the face seen in any frame
    min_seen: float = 0.1  # of the face, in a frame whose state is known
    least_cosine: float = 0.2  # between ray and normal: 78 deg
    # Share of the changed surface by which depth must explain more than tracks do, to take their
    # place: less is chance, and tracks see sideways too.
    clearly_more: float = 0.1


@dataclass(frozen=True, slots=True)
class DepthMotion:
    """What depth alone says of the motion."""

    guesses: tuple[JointGuess, ...]  # best first, over all T frames; zero in frame 0
    explained: tuple[float, ...]  # share of the changed surface that each explains
    known: tuple[BoolArray, ...]  # (T,) of each, frames that show the face; others interpolated
    change: DepthChange  # for `explained_share` of other motions, and for masks


def depth_motion(
    recording: Recording,
    object_mask: BoolArray,
    noise: DepthNoiseModel,
    config: DepthMotionConfig | None = None,
) -> Steps[DepthMotion | None]:
    """Joint and states of the part that moved, with a pause after every piece of work.

    Args:
        recording: T frames of one camera that stands still.
        object_mask: (H, W) the object in frame 0.
        noise: of the depth.
        config: tuning.

    Returns:
        None where nothing changed beyond the noise, or no face is seen to move.

    Raises:
        ValueError: the mask has another size than the image.
    """
    config = config or DepthMotionConfig()
    change = yield from depth_change(recording, object_mask, noise, config.change)
    yield
    every = np.ones(len(recording.frames), dtype=bool)
    keyframes = change_frames(change, every, config.keyframes)
    faces = face_planes(change, keyframes, config.face) if keyframes else None
    if faces is None:
        return None
    yield
    found = []
    for start in starts_from_faces(faces, len(change.frames), config.joint):
        guess, known = yield from _with_states(start, change, config)
        yield
        R, t = guess.joint.motion(guess.q)
        found.append((explained_share(change, R, t, every), guess, known))
        yield
    found.sort(key=lambda f: -np.nan_to_num(f[0], nan=-1.0))
    shares, guesses, known_frames = zip(*found, strict=True)
    return DepthMotion(guesses, shares, known_frames, change)


def _with_states(
    start: FaceStart, change: DepthChange, config: DepthMotionConfig
) -> Steps[tuple[JointGuess, BoolArray]]:
    """The guess with the states of all frames, and where the face is seen."""
    depth_m = np.stack([f.depth_m for f in change.frames])
    q, seen = _states(start, start.guess.q, depth_m, change, config)
    sure = seen >= config.surely_seen * seen.max()
    sure[0], q[0] = True, 0.0
    yield
    yield from _search_from_neighbours(start, q, seen, sure, depth_m, change, config)
    known = sure | (seen >= config.min_seen * len(start.p_world))
    q = np.interp(np.arange(q.size), np.flatnonzero(known), q[known])
    return replace(start.guess, q=q), known


def _search_from_neighbours(
    start: FaceStart,
    q: FloatArray,
    seen: NDArray[np.int_],
    sure: BoolArray,
    depth_m: NDArray[np.float32],
    change: DepthChange,
    config: DepthMotionConfig,
) -> Steps[None]:
    """Look for the face in frames that show little of it, from the state of the nearest other.

    Interpolated states are far off beyond the last keyframe that shows the face: the robot may
    have stood there in frame 0, so that nothing tells it from what was there. Changes q and seen.
    """
    done = np.flatnonzero(sure)
    lost = np.flatnonzero(~sure)
    far = np.abs(lost[:, None] - done).min(axis=1) if lost.size else lost
    for t in lost[np.argsort(far, kind="stable")]:
        nearest = done[int(np.abs(done - t).argmin())]
        starts = q[nearest] + np.array(config.search_m) / start.metres_per_state
        there = np.broadcast_to(depth_m[t], (starts.size, *depth_m.shape[1:]))
        states, counts = _states(start, starts, there, change, config)
        best = int(counts.argmax())
        if counts[best] > seen[t]:
            q[t], seen[t] = states[best], counts[best]
        done = np.append(done, t)
        if done.size % _SEARCHED_A_PIECE == 0:
            yield


def _states(
    start: FaceStart,
    q: FloatArray,
    depth_m: NDArray[np.float32],
    change: DepthChange,
    config: DepthMotionConfig,
) -> tuple[FloatArray, NDArray[np.int_]]:
    """States (T,) in which depth images (T, h, w) show the face, and the points (T,) that do.

    Gauss-Newton from q on the distances of single readings from the face.
    """
    joint, seen = start.guess, np.zeros(q.size, dtype=int)
    for gate_m in config.gates_m:
        R, t = joint.joint.motion(q)
        twist = joint.joint.motion_jacobians(q)[1]
        Rt = R.transpose(0, 2, 1)
        x, n = start.p_world @ Rt + t[:, None], start.normal_world @ Rt
        e, sigma = _off_face(x, n, depth_m, change, config)
        good = np.abs(e) < gate_m + config.gate_sigmas * sigma
        e = np.where(good, e, 0.0)
        moment = skew(x) @ n[..., None]
        J = np.einsum("tsi,ti->ts", n, twist[:, 3:])
        J += np.einsum("tsi,ti->ts", moment[..., 0], twist[:, :3])
        w = np.where(good, weight((e / sigma) ** 2, config.dof, 1) / sigma**2, 0.0)
        information = (w * J * J).sum(axis=1)
        q = q + (w * J * e).sum(axis=1) / np.maximum(information, 1e-9)
        seen = good.sum(axis=1)
    return q, seen


def _off_face(
    x_world: FloatArray,
    normal_world: FloatArray,
    depth_m: NDArray[np.float32],
    change: DepthChange,
    config: DepthMotionConfig,
) -> tuple[FloatArray, FloatArray]:
    """How far the depth seen at points (T, S, 3) lies off the face, along its normal, and the sd.

    NaN where the face is turned away, out of the image or without depth.
    """
    view = change.frames[0]
    R, eye = view.T_world_cam.rotation().matrix(), view.T_world_cam.translation()
    rays = x_world - eye
    p_cam = rays @ R
    u, v, inside = nearest_pixels(view.camera, p_cam)
    cosine = -(normal_world * rays).sum(axis=-1) / np.linalg.norm(rays, axis=-1)
    z = depth_m[np.arange(len(depth_m))[:, None], v, u].astype(float)
    z = np.where(inside & (cosine > config.least_cosine), z, np.nan)
    seen = view.camera.back_project(np.stack([u, v], axis=-1).astype(float), z) @ R.T + eye
    sigma = change.noise.sigma_m(p_cam[..., 2], view.camera.fx * change.stride)
    e = ((seen - x_world) * normal_world).sum(axis=-1)
    return np.asarray(e), np.asarray(sigma * np.maximum(cosine, config.least_cosine))
