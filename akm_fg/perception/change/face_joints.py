"""The joints that allow the planes in which a part's face was seen.

The planes of a drawer's face are parallel: it slides along their normal (within its own plane a
face tells nothing), by their distance from the plane of frame 0. Those of a hinged face all hold
the direction of its axis; the hinge lies at the same small height e above all of them,

    n_t . c = d_t + e,

which is nearly where each of them meets the plane of frame 0. How far e is from zero shows in the
second order of the angle only, so it is held by a prior.

What is seen of a part that turns far is not always the face of frame 0: a thin part that has passed
edge-on shows its back, half a turn on, and a box another side, a quarter turn on. Which it is, the
states tell: they are continuous in the order of frames. A side has a height of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.geometry.joint_guess import JointGuess, joint_frame
from akm_fg.perception.change.face_planes import FacePlanes
from akm_fg.records import BoolArray, FloatArray
from factors.joint import Joint, JointKind

_SIDES = (2, 4)  # that a part may show: its face, the back of a thin one, the sides of a box


@dataclass(frozen=True, slots=True)
class FaceJointConfig:
    """Joints from the planes of a face."""

    parallel_rad: float = 0.1  # between the faces of a drawer
    tilt_gate_rad: float = 0.06  # of a plane that does not hold the axis
    tilt_sigma_rad: float = 0.005  # of a plane's normal: surfaces and depth are warped
    offset_sigma_m: float = 0.0015  # of a plane at the hinge
    reweights: int = 5  # Cauchy weights: faces seen just beyond the noise are the worst
    least_turn_rad: float = 0.03  # of a hinge that can be told from a drawer by its face
    hinge_depth_m: float = 0.03  # how far a hinge lies off the plane of its face: 0 to 5 cm
    side_depth_m: float = 0.3  # off the plane of another side of a box
    off_m: float = 0.03  # a plane that misses a hinge by more belongs to another face


@dataclass(frozen=True, slots=True)
class FaceStart:
    """A joint that the faces allow, and the face itself at state zero."""

    guess: JointGuess  # states over all frames, interpolated between keyframes
    p_world: FloatArray  # (S, 3)
    normal_world: FloatArray  # (S, 3)

    @property
    def metres_per_state(self) -> float:
        """How far the face's middle moves along its normal with the state."""
        joint, x = self.guess, self.p_world.mean(axis=0)
        twist = joint.joint.motion_jacobians(np.zeros(1))[1][0]
        velocity = np.cross(twist[:3], x) + twist[3:]
        return float(velocity @ self.normal_world.mean(axis=0))


def starts_from_faces(faces: FacePlanes, count: int, config: FaceJointConfig) -> list[FaceStart]:
    """A drawer where the face stays parallel, and hinges where it turns; at least one of them.

    Args:
        faces: K planes and that of frame 0.
        count: frames of the recording.
        config: tuning.
    """
    starts: list[FaceStart] = []
    cosine = faces.normal @ faces.normal_0
    parallel = cosine > np.cos(config.parallel_rad)
    hinges: list[_Hinge] = []
    for sides in _SIDES:
        found = _hinge(faces, sides, config)
        if found is not None and not any(_alike(found, other) for other in hinges):
            hinges.append(found)
    for hinge in hinges:
        pose = hinge.axis, hinge.pivot, hinge.turns, hinge.used
        starts.append(_start(JointKind.REVOLUTE, *pose, faces, count))
    if not hinges or parallel.any():
        used = parallel if parallel.any() else cosine == cosine.max()
        travel = faces.centre @ faces.normal_0 - faces.offset_0
        sign = 1.0 if travel[used].sum() >= 0 else -1.0
        centre = faces.centre[used].mean(axis=0)
        axis = sign * faces.normal_0
        starts.append(_start(JointKind.PRISMATIC, axis, centre, sign * travel, used, faces, count))
    return starts


def _start(
    kind: JointKind,
    axis: FloatArray,
    origin: FloatArray,
    q: FloatArray,
    used: BoolArray,
    faces: FacePlanes,
    count: int,
) -> FaceStart:
    """A guess from states (K,) of the used planes, and the face's points in frame 0."""
    frames = np.concatenate([[0], np.array(faces.frames)[used]])
    joint = Joint(kind, joint_frame(axis, origin), 0.0)
    R, t = joint.motion(q)
    x = [(faces.p_world[k] - t[k]) @ R[k] for k in np.flatnonzero(used)]
    n = [np.tile(faces.normal[k] @ R[k], (len(faces.p_world[k]), 1)) for k in np.flatnonzero(used)]
    every = np.interp(np.arange(count), frames, np.concatenate([[0.0], q[used]]))
    guess = JointGuess(joint, every)
    return FaceStart(guess, np.concatenate(x), np.concatenate(n))


@dataclass(frozen=True, slots=True)
class _Hinge:
    """A hinge that the planes allow."""

    axis: FloatArray  # (3,)
    pivot: FloatArray  # (3,)
    turns: FloatArray  # (K,) of the part, from frame 0
    used: BoolArray  # (K,) planes that agree with it


def _alike(first: _Hinge, second: _Hinge) -> bool:
    """Whether two hinges tell the same states."""
    return bool(np.array_equal(first.used, second.used)) and bool(
        np.abs(first.turns - second.turns)[first.used].max() < np.pi / 4
    )


def _hinge(faces: FacePlanes, sides: int, config: FaceJointConfig) -> _Hinge | None:
    """The hinge that most planes agree with; None where nothing turns.

    Every plane and that of frame 0 meet in a line: the hinge that most other planes agree with is
    refined by least squares on all of these.

    Args:
        faces: K planes and that of frame 0.
        sides: of a full turn, that the part may show: with 1 the face, 2 its back too, 4 a box.
        config: tuning.
    """
    K, best = len(faces.frames), np.zeros(len(faces.frames), dtype=bool)
    for k in range(K):
        axis = np.cross(faces.normal_0, faces.normal[k])
        length = float(np.linalg.norm(axis))
        if length < config.least_turn_rad:
            continue
        axis /= length
        tilt = np.abs(faces.normal @ axis) < config.tilt_gate_rad
        side = _turned(faces, axis, tilt, sides)[1]
        pivot = _pivot(faces, axis, np.arange(K) == k, side, config)
        off = np.abs(faces.normal @ pivot - faces.offset)
        agrees = tilt & ((off < config.off_m) | (side % 2 == 1))
        if agrees.sum() > best.sum():
            best = agrees
    if 2 * best.sum() < K:  # a drawer's side that is the largest plane in a few frames
        return None
    axis = _axis(faces, best, config)
    turns, side = _turned(faces, axis, best, sides)
    if turns[best].sum() < 0:
        axis, turns = -axis, -turns
    return _Hinge(axis, _pivot(faces, axis, best, side, config), turns, best)


def _turned(
    faces: FacePlanes, axis: FloatArray, used: BoolArray, sides: int
) -> tuple[FloatArray, NDArray[np.int_]]:
    """Turns (K,) of the part about the axis from frame 0, and which side each plane is.

    Sides count in quarter turns from the face of frame 0. Of the turns by which a plane may have
    come about, the one that is nearest to the turn of the last used frame.
    """
    K = len(faces.frames)
    turns, side, last = np.zeros(K), np.zeros(K, dtype=int), 0.0
    across = np.cross(axis, faces.normal_0)
    seen = np.arctan2(faces.normal @ across, faces.normal @ faces.normal_0)
    step = 2 * np.pi / sides
    for k in range(K):
        on = round((last - seen[k]) / step)
        turns[k], side[k] = seen[k] + on * step, (-on * 4 // sides) % 4
        if used[k]:
            last = turns[k]
    return turns, side


def _axis(faces: FacePlanes, used: BoolArray, config: FaceJointConfig) -> FloatArray:
    """The direction most nearly in all used planes and frame 0's, robustly."""
    n = np.vstack([faces.normal[used], faces.normal_0])
    w, axis = np.ones(len(n)), np.zeros(3)
    for _ in range(config.reweights):
        axis = np.linalg.svd(n * np.sqrt(w)[:, None])[2][2]
        w = 1 / (1 + (n @ axis / config.tilt_sigma_rad) ** 2)
    return axis


def _pivot(
    faces: FacePlanes,
    axis: FloatArray,
    used: BoolArray,
    side: NDArray[np.int_],
    config: FaceJointConfig,
) -> FloatArray:
    """Point c with n_t . c = d_t + e for the used planes and frame 0's, robustly.

    Each of the four sides has an e of its own: small of the face and its back, not of the others.
    """
    n = np.vstack([faces.normal[used], faces.normal_0])
    d = np.append(faces.offset[used], faces.offset_0)
    centre = faces.centre[used].mean(axis=0)
    heights = np.eye(4)[np.append(side[used], 0)]
    rows = np.column_stack([n, -heights]) / config.offset_sigma_m
    values = (d - n @ centre) / config.offset_sigma_m
    depths_m = (config.hinge_depth_m, config.side_depth_m) * 2
    held_e = np.column_stack([np.zeros((4, 3)), np.diag(1 / np.array(depths_m))])
    held_c = np.append(axis, np.zeros(4))  # where on the axis is free: next to the face's centre
    w, solution = np.ones(len(n)), np.zeros(7)
    for _ in range(config.reweights):
        root = np.sqrt(w)
        A = np.vstack([rows * root[:, None], held_e, held_c])
        solution = np.linalg.lstsq(A, np.concatenate([values * root, np.zeros(5)]))[0]
        w = 1 / (1 + (rows @ solution - values) ** 2)
    return np.asarray(centre + solution[:3])
