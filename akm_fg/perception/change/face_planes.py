"""The moving part's largest face as a plane in every keyframe and in frame 0.

Planes are fitted to inverse depth, which is linear over the image and whose noise is the same
everywhere. A face is first fitted to nearer pixels, then to all where the fitted plane lies
clearly before what frame 0 shows: the noise of a reading must not decide whether it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.perception.change.depth_change import DepthChange
from akm_fg.records import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class FaceConfig:
    """Planes of a face in depth images."""

    samples: int = 150  # planes tried; one with 30 % support is missed with probability 0.02
    points: int = 600  # they are judged by
    refits: int = 3
    gate_sigmas: float = 3.0  # of a reading, off the plane
    gate_m: float = 0.002  # on top: mouldings
    min_pixels: int = 30  # of a face, thinned
    first_frames: int = 3  # whose nearer pixels show the face in frame 0
    kept_points: int = 40  # kept of each


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
    before_0 = w_0 + _gate(change, w_0, config)
    on_object = first & change.on_object  # beside it, frame 0 shows what is behind the part
    at_rest = _largest_plane(change, w_0, on_object, rng, config)
    if at_rest is None:
        return None
    normal_0, offset_0 = _in_world(change, at_rest)
    frames, planes, points = [], [], []
    for t in keyframes:
        w = _inverse_depth(change, t)
        plane = _largest_plane(change, w, change.nearer[t], rng, config)
        if plane is None:
            continue
        plane, on = _unbiased(change, w, before_0, plane, config)
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
    change: DepthChange, w: FloatArray, before_0: FloatArray, plane: FloatArray, config: FaceConfig
) -> tuple[FloatArray, BoolArray]:
    """The plane refitted to all pixels where it lies clearly before frame 0, and these (h, w).

    Args:
        change: of the recording.
        w: (h, w) inverse depth of a frame.
        before_0: (h, w) from which on it is clearly before that of frame 0.
        plane: of inverse depth (3,).
        config: tuning.
    """
    on = np.zeros(w.shape, dtype=bool)
    gate = _gate(change, w, config)
    rows, columns = (np.arange(n, dtype=np.float64) for n in w.shape)
    for _ in range(config.refits):
        expected = (plane[0] + plane[2] * rows)[:, None] + plane[1] * columns
        on = (np.abs(w - expected) < gate) & (expected > before_0)
        v, u = np.nonzero(on)
        if u.size < config.min_pixels:
            break
        A = np.column_stack([np.ones(u.size), u, v])
        plane = np.asarray(np.linalg.solve(A.T @ A, A.T @ w[on]), dtype=np.float64)
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
    step = max(1, -(-v.size // config.kept_points))
    T = change.frames[0].T_world_cam
    uv = np.stack([u, v], axis=-1)[::step].astype(float)
    rays = change.camera.back_project(uv, np.ones(len(uv))) @ T.rotation().matrix().T
    normal, offset = plane
    eye = T.translation()
    return np.asarray(eye + rays * ((offset - normal @ eye) / (rays @ normal))[:, None])
