"""How the part moved, before any joint is assumed: one free rigid motion per frame.

Serves three ends that must not depend on the joint kind: which tracks belong to one rigid part,
how noisy they are, and where to start the joints from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import BoolArray, FloatArray, PointTracks

# Below this many common points, or on a line, a frame's rotation says nothing.
MIN_POINTS = 3
_LINE = 1e-12  # second over first singular value below which points lie on a line
_MIN_SPREAD = 0.3  # of the claimed noise: few points may agree by chance


@dataclass(frozen=True, slots=True)
class RigidMotionConfig:
    """Robust generalised Procrustes analysis."""

    samples: int = 64  # minimal sets tried; 20 % outliers: all fail with probability 1e-20
    iterations: int = 4  # the graph iterates further
    scale_tolerance: float = 0.005  # relative change of the noise scale that ends them
    inlier_sigmas: float = 4.0  # of a 3-d residual; 0.1 % of good observations lie beyond
    min_inlier_share: float = 0.6  # of a track's observations, else the whole track is rejected


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """Motion of the part from the reference frame to every frame."""

    R_world: FloatArray  # (T, 3, 3)
    t_world: FloatArray  # (T, 3); p_t = R_t p_ref + t_t
    shape_world: FloatArray  # (N, 3) the points in the reference frame
    known: BoolArray  # (T,) frames with enough points
    inlier: BoolArray  # (N,) tracks that move with the part
    scale: float  # noise of the inliers, in units of their given covariances

    def from_frame(self, first: int) -> tuple[FloatArray, FloatArray]:
        """Rotations (T, 3, 3) and translations (T, 3) from a frame instead of the reference."""
        R = self.R_world @ self.R_world[first].T
        return R, self.t_world - np.einsum("tij,j->ti", R, self.t_world[first])


def procrustes(a: FloatArray, b: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations (..., 3, 3) and translations (..., 3) that take a to b, weights w (..., N).

    Least squares over points (..., N, 3) (Arun, Huang, Blostein, 1987; sign after Umeyama, 1991).
    """
    total = np.maximum(w.sum(-1), 1e-300)[..., None]
    mean_a = (w[..., None, :] @ a)[..., 0, :] / total
    mean_b = (w[..., None, :] @ b)[..., 0, :] / total
    weighted = w[..., None] * (b - mean_b[..., None, :])
    cross = weighted.swapaxes(-1, -2) @ (a - mean_a[..., None, :])
    U, strength, Vt = np.linalg.svd(cross)
    on_line = strength[..., 1] < _LINE * strength[..., 0]
    if on_line.any():  # the turn about the line is open: of all, the least
        least = cross + np.sqrt(_LINE) * strength[..., :1, None] * np.eye(3)
        again_U, _, again_Vt = np.linalg.svd(least)
        U = np.where(on_line[..., None, None], again_U, U)
        Vt = np.where(on_line[..., None, None], again_Vt, Vt)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    R = U @ Vt
    return R, mean_b - (R @ mean_a[..., None])[..., 0]


def free_rigid_motion(
    tracks: PointTracks, rng: np.random.Generator, config: RigidMotionConfig | None = None
) -> RigidMotion:
    """Fit one rigid motion per frame to the tracks, robustly.

    Args:
        tracks: T frames, N points of what should be one part.
        rng: draws the minimal sets.
        config: tuning.
    """
    config = config or RigidMotionConfig()
    observed = tracks.observed
    p = np.where(observed[..., None], tracks.p_world, 0.0)
    variance = np.einsum("tnii->tn", tracks.cov_world) / 3
    sigma2 = np.where(observed, variance, 1.0)
    ref = int(np.argmax(observed.sum(axis=1)))
    member = _consensus(p, observed, sigma2, ref, rng, config)
    w = np.where(observed & member[None], 1 / sigma2, 0.0)
    shape, has_shape = p[ref], observed[ref].copy()
    R, t = np.tile(np.eye(3), (p.shape[0], 1, 1)), np.zeros((p.shape[0], 3))
    scale, d2 = 1.0, np.zeros_like(sigma2)
    for _ in range(config.iterations):
        R, t = procrustes(shape[None], p, w * has_shape[None])
        shape, has_shape = _mean_shape(p, R, t, w)
        e = p - shape @ R.transpose(0, 2, 1) - t[:, None]
        d2 = np.where(observed & has_shape[None], _squared(e) / sigma2, np.inf)
        previous, scale = scale, _robust_scale(d2, member)
        w = np.where(d2 < (config.inlier_sigmas * scale) ** 2, 1.0, 0.1) * member
        w = w / (sigma2 * (1 + d2 / (5 * scale**2)))  # zero where not observed
        if abs(scale - previous) < config.scale_tolerance * scale:
            break
    others = ~member  # two frames sent them off; all of them may call them back
    if others.any():
        shape[others], e2 = _median_shape(tracks.p_world[:, others], R, t)
        d2[:, others] = e2 / sigma2[:, others]
    good = d2 < (config.inlier_sigmas * scale) ** 2
    share = good.sum(axis=0) / np.maximum(observed.sum(axis=0), 1)
    return RigidMotion(
        R_world=R,
        t_world=t,
        shape_world=shape,
        known=(observed & member[None]).sum(axis=1) >= MIN_POINTS,
        inlier=share >= config.min_inlier_share,
        scale=scale,
    )


def _robust_scale(d2: FloatArray, member: BoolArray) -> float:
    """Noise scale from the median squared residual (T, N) (chi-square, 3 degrees, median 2.366).

    Of 3 N T numbers, 6 T went into the motions and 3 N into the shape. Those not seen are infinite.
    """
    T, N = d2.shape[0], int(np.count_nonzero(member))
    freedom = max((1 - 2 / max(N, 3)) * (1 - 1 / T), 0.1)
    seen = d2[np.isfinite(d2) & member]
    return float(np.sqrt(max(float(np.median(seen)), 1e-24) / (2.366 * freedom)))


def _squared(v: FloatArray) -> FloatArray:
    """Squared lengths of vectors (..., 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.asarray(x * x + y * y + z * z)


def _row_medians_of_roots(squares: FloatArray) -> FloatArray:
    """Medians (M,) of the square roots of rows (M, N)."""
    n = squares.shape[1]
    middle = np.sort(squares, axis=1)[:, [(n - 1) // 2, n // 2]]
    return np.asarray(np.sqrt(middle).mean(axis=1))


def _mean_shape(
    p: FloatArray, R: FloatArray, t: FloatArray, w: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Weighted mean of the points taken back to the reference frame, and where it exists."""
    back = (p - t[:, None]) @ R
    total = w.sum(axis=0)
    mean = np.einsum("tn,tni->ni", w, back) / np.maximum(total, 1e-300)[:, None]
    return mean, total > 0


def _median_shape(p: FloatArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Median (N, 3) of points (T, N, 3) taken back, NaN where lost, and squared errors (T, N)."""
    back = (p - t[:, None]) @ R
    shape = np.nanmedian(back, axis=0)
    return shape, ((back - shape) ** 2).sum(-1)


def _consensus(
    p: FloatArray,
    observed: BoolArray,
    sigma2: FloatArray,
    ref: int,
    rng: np.random.Generator,
    config: RigidMotionConfig,
) -> BoolArray:
    """(N,) tracks that agree on one rigid motion to the frame where most of them moved most.

    Tracks not seen in both frames are given the benefit of the doubt.
    """
    N = p.shape[1]
    member = np.ones(N, dtype=bool)
    common = observed & observed[ref][None]
    enough = common.sum(axis=1) >= max(MIN_POINTS + 1, common.sum(axis=1).max() // 2)
    distance2 = _squared(p - p[ref])
    if common.all():
        moved = _row_medians_of_roots(distance2)
    else:
        distance = np.sqrt(distance2)
        seen = np.where(enough[:, None], np.where(common, distance, np.nan), -1.0)
        moved = np.nanmedian(seen, axis=1)
    far = int(np.argmax(moved))
    index = np.flatnonzero(common[far])
    if far == ref or index.size <= MIN_POINTS:
        return member
    a, b = p[ref, index], p[far, index]
    triples = rng.random((config.samples, index.size)).argpartition(2, axis=1)[:, :3]
    R, t = procrustes(a[triples], b[triples], np.ones(triples.shape))
    noise2 = sigma2[ref, index] + sigma2[far, index]
    e = R @ a.T + t[:, :, None] - b.T  # (samples, 3, M)
    whitened2 = (e * e).sum(axis=1) / noise2
    # The noise level may be off by a factor: judge by the agreeing points' own spread.
    medians = _row_medians_of_roots(whitened2)
    best = int(np.argmin(medians))
    agreeing = whitened2[best] <= (2 * max(float(medians[best]), 1e-12)) ** 2
    R, t = procrustes(a, b, agreeing.astype(float))
    refined = np.sqrt(_squared(b - a @ R.T - t) / noise2)
    freedom = max(1 - 2 / int(agreeing.sum()), 0.3)
    spread = float(np.median(refined)) / np.sqrt(2.366 * freedom)
    member[index] = refined < config.inlier_sigmas * max(spread, _MIN_SPREAD)
    return member
