"""Which tracks moved with the part, which rested, and whether anything moved at all.

The paper clusters displacement features (Eq. 3) in two by spectral clustering, which always
finds two clusters and puts the points near a hinge on the wrong side. Here the noise is known:

1. a chi-square test finds tracks that moved more than their noise; too few: nothing moved;
2. a seed cluster moved together: where a gripper holds the part, the tracks that keep their
   distance to it, as points of one rigid body do however it turns; else, or if these are too
   few, one found by spectral clustering of displacement differences in units of their noise;
3. one rigid motion per frame is fitted to the seed, robustly;
4. each track is judged by how well rest and that motion explain it. What neither explains
   (drift, shadows) is dropped; what both explain (near the hinge, or too short) stays open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from scipy.stats import chi2

from akm_fg.errors import NoMotionObserved, TracksLost
from akm_fg.geometry.batches import inverses, solutions
from akm_fg.geometry.rigid_motion import MIN_POINTS, RigidMotion, free_rigid_motion
from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.motion_seeds import held_tracks, spectral_clusters, with_hand
from akm_fg.records import BoolArray, FloatArray, PointTracks
from akm_fg.steps import Steps


@dataclass(frozen=True, slots=True)
class MotionSegmentation:
    """What moved. Tracks that are neither moving nor static are open or outliers."""

    moving: BoolArray  # (N,) with the part
    static: BoolArray  # (N,)
    rejected: BoolArray  # (N,) explained neither by rest nor by the part's motion
    p_nothing_moved: float  # from the approximate (BIC) evidence of rest and of one rigid motion
    motion_m: float  # rms displacement of the moving tracks from their mean; 0 if none
    noise_scale: float  # standard deviations found, in units of those claimed; at least 1
    enough_tracks: bool = True  # seen often enough to tell motion from rest; else all are open

    def require_motion(self) -> None:
        """Go on only if something moved.

        Raises:
            TracksLost: fewer than three tracks were seen often enough to say.
            NoMotionObserved: nothing moved beyond the noise.
        """
        if not self.enough_tracks:
            raise TracksLost(
                f"fewer than {MIN_POINTS} of {self.moving.size} tracks are seen often enough to "
                "tell motion from rest"
            )
        if not self.moving.any():
            n = int(self.static.sum())
            raise NoMotionObserved(
                f"nothing moved beyond the noise ({n} of {len(self.static)} tracks rest, "
                f"probability that nothing moved {self.p_nothing_moved:.3f})"
            )


@dataclass(frozen=True, slots=True)
class _Fit:
    """How well one motion explains N tracks."""

    cost: FloatArray  # (N,) chi-square with capped residuals
    freedom: FloatArray  # (N,) degrees of freedom; 0 where there is nothing to judge

    def per_freedom(self) -> FloatArray:
        """(N,) cost per degree of freedom; infinite where there is nothing to judge."""
        return np.where(self.freedom > 0, self.cost / np.maximum(self.freedom, 1), np.inf)


@dataclass(frozen=True, slots=True)
class _Observations:
    """What is judged: points, the inverse of their covariances, and which of them count."""

    p: FloatArray  # (T, N, 3), 0 where not seen
    info: FloatArray  # (T, N, 3, 3)
    use: BoolArray  # (T, N)
    cap: float  # standard deviations

    def judge(self, R: FloatArray, t: FloatArray, known: BoolArray) -> _Fit:
        """How well the motion R (T, 3, 3), t (T, 3) of a latent shape explains each track.

        The shape is the mean of the points taken back, re-weighted twice against outliers; only
        frames in which the motion is `known` (T,) count.
        """
        back = (self.p - t[:, None]) @ R
        return self._spread(back, R.transpose(0, 2, 1)[:, None] @ self.info @ R[:, None], known)

    def judge_rest(self, known: BoolArray) -> _Fit:
        """How well rest explains each track in these frames."""
        return self._spread(self.p, self.info, known)

    def _spread(self, p: FloatArray, info: FloatArray, known: BoolArray) -> _Fit:
        use = self.use & known[:, None]
        w = use.astype(float)
        d2 = np.zeros(w.shape)
        for _ in range(3):
            weighted = w[..., None, None] * info
            total = weighted.sum(axis=0) + 1e-9 * np.eye(3)
            pull = (weighted @ p[..., None])[..., 0].sum(axis=0)
            e = p - solutions(total, pull[..., None])[..., 0]
            d2 = ((info @ e[..., None])[..., 0] * e).sum(axis=-1)
            w = use * np.minimum(1.0, self.cap / np.maximum(np.sqrt(d2), 1e-12))
        cost = np.where(use, np.minimum(d2, self.cap**2), 0.0).sum(axis=0)
        return _Fit(cost, np.maximum(3.0 * (use.sum(axis=0) - 1), 0.0))


def segment_motion(
    tracks: PointTracks,
    config: MotionSegmentationConfig | None = None,
    rng: np.random.Generator | None = None,
    hand_world: FloatArray | None = None,
) -> Steps[MotionSegmentation]:
    """Tell the moving part's tracks from those at rest, with a pause after every piece of work.

    Args:
        tracks: T frames, N points with their covariances; gaps and late starts are fine.
        config: tuning.
        rng: draws subsets and minimal sets; a fixed one if not given.
        hand_world: (T, 3) of the gripper that holds the part, metres; NaN where it does not.
    """
    config = config or MotionSegmentationConfig()
    rng = rng or np.random.default_rng(0)
    observed = tracks.observed
    judged = observed.sum(axis=0) >= config.min_observations
    if judged.sum() < MIN_POINTS:
        none = np.zeros_like(judged)
        return MotionSegmentation(none, none, none, 0.5, 0.0, 1.0, enough_tracks=False)
    p = np.where(observed[..., None], tracks.p_world, 0.0)
    cov = np.where(observed[..., None, None], tracks.cov_world, np.eye(3))
    info = inverses(cov + config.systematic_m**2 * np.eye(3))
    seen = _Observations(p, info, observed & judged, config.outlier_sigmas)
    rest = seen.judge_rest(np.ones(len(p), dtype=bool))
    significant = judged & (rest.cost > chi2.isf(config.false_alarm, np.maximum(rest.freedom, 1)))
    for hand in (hand_world, None) if hand_world is not None else (None,):
        enough = config.min_moving if hand is None else config.min_with_hand
        if significant.sum() < enough:
            continue
        yield
        if hand is None:
            seeds = spectral_clusters(tracks, seen.p, significant, config, rng)
        else:
            seeds = [held_tracks(tracks, significant, hand, config)]
        yield
        found = []
        for seed in seeds:
            motion = yield from _fit_motion(tracks, seen, rest, seed, hand, config, rng)
            if motion is not None:
                found.append(_decide(tracks, seen, rest, motion, judged, enough, config))
            yield
        decided, _ = max(found, key=lambda candidate: candidate[1], default=(None, 0.0))
        if decided is not None and (decided.moving.any() or hand is None):
            return decided
    return _nothing_moved(rest, judged, 1.0, config)


def _noise_scale(per_freedom: FloatArray, judged: BoolArray, limit: float) -> float:
    middle = float(np.median(per_freedom[judged & np.isfinite(per_freedom)]))
    return float(np.sqrt(np.clip(middle, 1.0, limit**2)))


def _nothing_moved(
    rest: _Fit, judged: BoolArray, p: float, config: MotionSegmentationConfig
) -> MotionSegmentation:
    per_freedom = rest.per_freedom()
    scale = _noise_scale(per_freedom, judged, config.max_noise_scale)
    static = judged & (per_freedom < config.max_per_freedom * scale**2)
    none = np.zeros(len(judged), dtype=bool)
    return MotionSegmentation(none, static, judged & ~static, p, 0.0, scale)


def _decide(
    tracks: PointTracks,
    seen: _Observations,
    rest: _Fit,
    motion: RigidMotion,
    judged: BoolArray,
    min_moving: int,
    config: MotionSegmentationConfig,
) -> tuple[MotionSegmentation, float]:
    """Assign each track, and weigh motion against rest; with the nats by which motion is ahead."""
    moved = seen.judge(motion.R_world, motion.t_world, motion.known)
    rest_known = rest if motion.known.all() else seen.judge_rest(motion.known)
    best = np.minimum(rest_known.per_freedom(), moved.per_freedom())
    scale = _noise_scale(best, judged, config.max_noise_scale)
    limit = config.max_per_freedom * scale**2
    log_ratio = (rest_known.cost - moved.cost) / (2 * scale**2)
    explained_moving = judged & (moved.per_freedom() < limit)
    explained_static = judged & (rest.per_freedom() < limit)
    moving = explained_moving & (log_ratio > config.min_log_ratio)
    static = explained_static & (log_ratio < -config.min_log_ratio) & ~moving
    observations = 3 * float((tracks.observed & judged).sum())
    frames_known = int(motion.known.sum())
    penalty = 0.5 * 6 * max(frames_known - 1, 1) * np.log(max(observations, 2.0))
    ahead = float(log_ratio[moving].sum()) - penalty
    p_rest = float(expit(-ahead))
    motion_m = _rms_displacement(tracks.select(moving))
    if moving.sum() < min_moving or motion_m < config.min_motion_m or p_rest > 0.5:
        return _nothing_moved(rest, judged, max(p_rest, 0.5), config), -np.inf
    rejected = judged & ~explained_moving & ~explained_static
    return MotionSegmentation(moving, static, rejected, p_rest, motion_m, scale), ahead


def _rms_displacement(tracks: PointTracks) -> float:
    observed = tracks.observed
    if not observed.any():
        return 0.0
    p = np.where(observed[..., None], tracks.p_world, 0.0)
    n = np.maximum(observed.sum(axis=0), 1)
    e = np.where(observed[..., None], p - p.sum(axis=0) / n[:, None], 0.0)
    return float(np.sqrt((e**2).sum() / observed.sum()))


def _fit_motion(
    tracks: PointTracks,
    seen: _Observations,
    rest: _Fit,
    seed: NDArray[np.int_],
    hand_world: FloatArray | None,
    config: MotionSegmentationConfig,
    rng: np.random.Generator,
) -> Steps[RigidMotion | None]:
    """The rigid motion of some tracks (and of the hand), refitted to all that it explains."""
    enough = config.min_moving if hand_world is None else config.min_with_hand
    limit = config.max_per_freedom * config.max_noise_scale**2
    motion = None
    for _ in range(config.refits):
        if len(seed) < enough:
            return None
        body = tracks.select(seed)
        if hand_world is not None:
            body = with_hand(body, hand_world, config)
        motion = free_rigid_motion(body, rng, config.rigid_motion)
        if motion.known.sum() < 2:
            return None
        moved = seen.judge(motion.R_world, motion.t_world, motion.known)
        rest_known = rest if motion.known.all() else seen.judge_rest(motion.known)
        better = rest_known.cost - moved.cost > 2 * config.min_log_ratio
        last, seed = seed, np.flatnonzero((moved.per_freedom() < limit) & better)
        yield
        if np.array_equal(last, seed):
            break
    return motion if len(seed) >= enough else None
