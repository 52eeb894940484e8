"""The moving part's largest face as a plane in every keyframe, and the joints that allow them.

Planes are fitted to inverse depth, which is linear over the image and whose noise is the same
everywhere. A face is first fitted to nearer pixels, then to all where the fitted plane lies
clearly before what frame 0 shows: the noise of a reading must not decide whether it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.estimation.initial_guess import JointGuess, joint_frame
from akm_fg.perception.depth_change import DepthChange
from akm_fg.records import BoolArray, FloatArray
from factors.joint_motion import motion_jacobians, part_motion


@dataclass(frozen=True, slots=True)
class FaceConfig:
    """Planes of a face, and joints from them."""

    samples: int = 150  # planes tried; one with 30 % support is missed with probability 0.02
    points: int = 600  # they are judged by
    refits: int = 3
    gate_sigmas: float = 3.0  # of a reading, off the plane
    gate_m: float = 0.002  # on top: mouldings
    min_pixels: int = 30  # of a face, thinned
    first_frames: int = 3  # whose nearer pixels show the face in frame 0
    face_points: int = 40  # kept of each
    parallel_rad: float = 0.1  # between the faces of a drawer
    tilt_gate_rad: float = 0.06  # of a plane that does not hold the axis
    tilt_sigma_rad: float = 0.005  # of a plane's normal: surfaces and depth are warped
    offset_sigma_m: float = 0.0015  # of a plane at the hinge, likewise
    reweights: int = 5  # Cauchy weights: faces seen just beyond the noise are the worst
    least_turn_rad: float = 0.03  # of a hinge that can be told from a drawer by its face
    hinge_depth_m: float = 0.03  # how far a hinge lies off the plane of its face: 0 to 5 cm
    off_m: float = 0.03  # a plane that misses a hinge by more belongs to another face


@dataclass(frozen=True, slots=True)
class FacePlanes:
    """Planes normal . p = offset in K keyframes and in frame 0, normals towards the camera."""

    frames: tuple[int, ...]  # (K,)
    normal: FloatArray  # (K, 3)
    offset: FloatArray  # (K,)
    centre: FloatArray  # (K, 3) of the points on each
    p_world: tuple[FloatArray, ...]  # K times (n, 3), points on each
    normal_0: FloatArray  # (3,)
    offset_0: float


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
        twist = motion_jacobians(joint.kind, joint.T_world_joint, np.zeros(1))[1][0]
        velocity = np.cross(twist[:3], x) + twist[3:]
        return float(velocity @ self.normal_world.mean(axis=0))


def face_planes(
    change: DepthChange, keyframes: Sequence[int], config: FaceConfig
) -> FacePlanes | None:
    """The face in keyframes and in frame 0; None where it is not found in frame 0 or nowhere else.

    Args:
        change: its nearer pixels.
        keyframes: numbers of frames, ascending.
        config: tuning.
    """
    rng = np.random.default_rng(0)
    first = np.zeros(change.nearer.shape[1:], dtype=bool)
    for t in keyframes[: config.first_frames]:
        first |= change.nearer[t]
    w_0 = _inverse_depth(change, 0)
    at_rest = _largest_plane(change, w_0, first, rng, config)
    if at_rest is None:
        return None
    normal_0, offset_0 = _in_world(change, at_rest)
    frames, planes, points = [], [], []
    for t in keyframes:
        w = _inverse_depth(change, t)
        plane = _largest_plane(change, w, change.nearer[t], rng, config)
        if plane is None:
            continue
        plane, on = _unbiased(change, w, w_0, plane, config)
        if on.sum() < config.min_pixels:
            continue
        frames.append(t)
        planes.append(_in_world(change, plane))
        points.append(_points_on(change, planes[-1], on, config))
    if not frames:
        return None
    return FacePlanes(
        tuple(frames),
        np.array([n for n, _ in planes]),
        np.array([d for _, d in planes]),
        np.array([p.mean(axis=0) for p in points]),
        tuple(points),
        normal_0,
        offset_0,
    )


def starts_from_faces(faces: FacePlanes, count: int, config: FaceConfig) -> list[FaceStart]:
    """A drawer where the face stays parallel, and a hinge where it turns; at least one of them.

    Args:
        faces: K planes and that of frame 0.
        count: frames of the recording.
        config: tuning.
    """
    starts = []
    cosine = faces.normal @ faces.normal_0
    parallel = cosine > np.cos(config.parallel_rad)
    hinge = _hinge(faces, config)
    if hinge is not None:
        axis, pivot, used = hinge
        starts.append(_start("revolute", axis, pivot, _turns(faces, axis), used, faces, count))
    if hinge is None or parallel.any():
        used = parallel if parallel.any() else cosine == cosine.max()
        travel = faces.centre @ faces.normal_0 - faces.offset_0
        sign = 1.0 if travel[used].sum() >= 0 else -1.0
        centre = faces.centre[used].mean(axis=0)
        axis = sign * faces.normal_0
        starts.append(_start("prismatic", axis, centre, sign * travel, used, faces, count))
    return starts


def _start(
    kind: str,
    axis: FloatArray,
    origin: FloatArray,
    q: FloatArray,
    used: BoolArray,
    faces: FacePlanes,
    count: int,
) -> FaceStart:
    """A guess from states (K,) of the used planes, and the face's points in frame 0."""
    frames = np.concatenate([[0], np.array(faces.frames)[used]])
    T_world_joint = joint_frame(axis, origin)
    R, t = part_motion(kind, T_world_joint, q)
    x = [(faces.p_world[k] - t[k]) @ R[k] for k in np.flatnonzero(used)]
    n = [np.tile(faces.normal[k] @ R[k], (len(faces.p_world[k]), 1)) for k in np.flatnonzero(used)]
    every = np.interp(np.arange(count), frames, np.concatenate([[0.0], q[used]]))
    guess = JointGuess(kind, T_world_joint, every)
    return FaceStart(guess, np.concatenate(x), np.concatenate(n))


def _hinge(
    faces: FacePlanes, config: FaceConfig
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Axis, pivot, and which (K,) planes agree with them; None where nothing turns.

    Every plane and that of frame 0 meet in a line: the hinge that most other planes agree with is
    refined by least squares on all of these.
    """
    K, best = len(faces.frames), np.zeros(len(faces.frames), dtype=bool)
    for k in range(K):
        axis = np.cross(faces.normal_0, faces.normal[k])
        turn = float(np.linalg.norm(axis))
        if turn < config.least_turn_rad:
            continue
        axis /= turn
        tilt = np.abs(faces.normal @ axis)
        pivot = _pivot(faces, axis, np.arange(K) == k, config)
        off = np.abs(faces.normal @ pivot - faces.offset)
        agrees = (tilt < config.tilt_gate_rad) & (off < config.off_m)
        if agrees.sum() > best.sum():
            best = agrees
    if 2 * best.sum() < K:  # a drawer's side that is the largest plane in a few frames
        return None
    axis = _axis(faces, best, config)
    if _turns(faces, axis)[best].sum() < 0:
        axis = -axis
    return axis, _pivot(faces, axis, best, config), best


def _turns(faces: FacePlanes, axis: FloatArray) -> FloatArray:
    """Angles (K,) of the normals about the axis, from frame 0's."""
    side = np.cross(axis, faces.normal_0)
    return np.asarray(np.arctan2(faces.normal @ side, faces.normal @ faces.normal_0))


def _axis(faces: FacePlanes, used: BoolArray, config: FaceConfig) -> FloatArray:
    """The direction most nearly in all used planes and frame 0's, robustly."""
    n = np.vstack([faces.normal[used], faces.normal_0])
    w, axis = np.ones(len(n)), np.zeros(3)
    for _ in range(config.reweights):
        axis = np.linalg.svd(n * np.sqrt(w)[:, None])[2][2]
        w = 1 / (1 + (n @ axis / config.tilt_sigma_rad) ** 2)
    return axis


def _pivot(faces: FacePlanes, axis: FloatArray, used: BoolArray, config: FaceConfig) -> FloatArray:
    """Point c with n_t . c = d_t + e for the used planes and frame 0's, e small, robustly."""
    n = np.vstack([faces.normal[used], faces.normal_0])
    d = np.append(faces.offset[used], faces.offset_0)
    centre = faces.centre[used].mean(axis=0)
    rows = np.column_stack([n, -np.ones(len(n))]) / config.offset_sigma_m
    values = (d - n @ centre) / config.offset_sigma_m
    held_e = np.array([0, 0, 0, 1 / config.hinge_depth_m])
    held_c = np.append(axis, 0.0)  # where on the axis is free: next to the face's centre
    w, solution = np.ones(len(n)), np.zeros(4)
    for _ in range(config.reweights):
        root = np.sqrt(w)
        A = np.vstack([rows * root[:, None], held_e, held_c])
        solution = np.linalg.lstsq(A, np.concatenate([values * root, [0.0, 0.0]]))[0]
        w = 1 / (1 + (rows @ solution - values) ** 2)
    return np.asarray(centre + solution[:3])


def _inverse_depth(change: DepthChange, frame: int) -> FloatArray:
    """(h, w), NaN where unknown."""
    return np.asarray(1 / change.frames[frame].depth_m, dtype=np.float64)


def _gate(change: DepthChange, w: FloatArray, config: FaceConfig) -> FloatArray:
    """How far inverse depths may be off a plane."""
    z = 1 / w
    sigma = change.noise.sigma_m(z, change.camera.fx * change.stride)
    return np.asarray((config.gate_sigmas * sigma + config.gate_m) / z**2)


def _largest_plane(
    change: DepthChange,
    w: FloatArray,
    mask: BoolArray,
    rng: np.random.Generator,
    config: FaceConfig,
) -> FloatArray | None:
    """Plane a + b u + c v of inverse depth (3,) with most of the masked pixels on it (RANSAC)."""
    v, u = np.nonzero(mask & np.isfinite(w))
    if v.size < config.min_pixels:
        return None
    some = rng.choice(v.size, min(v.size, config.points), replace=False)
    A = np.column_stack([np.ones(some.size), u[some], v[some]])
    values = w[v[some], u[some]]
    gate = _gate(change, values, config)
    corners = rng.integers(0, some.size, (config.samples, 3))
    M = A[corners]
    good = np.abs(np.linalg.det(M)) > 30.0  # pixels squared: thin triangles tell no plane
    if not good.any():
        return None
    tried = np.linalg.solve(M[good], values[corners[good]][:, :, None])[:, :, 0]
    on = np.abs(values - tried @ A.T) < gate
    on = on[int(on.sum(axis=1).argmax())]
    plane = np.zeros(3)
    for _ in range(config.refits):
        if on.sum() < 3:
            return None
        plane = np.linalg.lstsq(A[on], values[on])[0]
        on = np.abs(values - A @ plane) < gate
    return plane


def _unbiased(
    change: DepthChange, w: FloatArray, w_0: FloatArray, plane: FloatArray, config: FaceConfig
) -> tuple[FloatArray, BoolArray]:
    """The plane refitted to all pixels where it lies clearly before frame 0, and these (h, w)."""
    v, u = np.mgrid[: w.shape[0], : w.shape[1]]
    on = np.zeros(w.shape, dtype=bool)
    gate, gate_0 = _gate(change, w, config), _gate(change, w_0, config)
    for _ in range(config.refits):
        expected = plane[0] + plane[1] * u + plane[2] * v
        on = (np.abs(w - expected) < gate) & (expected - w_0 > gate_0)
        if on.sum() < config.min_pixels:
            break
        A = np.column_stack([np.ones(int(on.sum())), u[on], v[on]])
        plane = np.linalg.lstsq(A, w[on])[0]
    return plane, on


def _in_world(change: DepthChange, plane: FloatArray) -> tuple[FloatArray, float]:
    """Unit normal towards the camera and offset of a plane of inverse depth."""
    camera, T = change.camera, change.frames[0].T_world_cam
    a, b, c = plane
    n_cam = np.array([camera.fx * b, camera.fy * c, a + b * camera.cx + c * camera.cy])
    length = float(np.linalg.norm(n_cam))
    n_world = -(T.rotation().matrix() @ n_cam) / length
    return n_world, float(n_world @ T.translation()) - 1 / length


def _points_on(
    change: DepthChange, plane: tuple[FloatArray, float], on: BoolArray, config: FaceConfig
) -> FloatArray:
    """Points (n, 3) of a plane in the world where the rays of some pixels meet it."""
    v, u = np.nonzero(on)
    step = max(1, -(-v.size // config.face_points))
    T = change.frames[0].T_world_cam
    uv = np.stack([u, v], axis=-1)[::step].astype(float)
    rays = change.camera.back_project(uv, np.ones(len(uv))) @ T.rotation().matrix().T
    normal, offset = plane
    eye = T.translation()
    return np.asarray(eye + rays * ((offset - normal @ eye) / (rays @ normal))[:, None])
