"""Keyframes of a stream: at most so many, spread along the motion, the others pooled into them.

A frame near a keyframe is moved there by the joint's motion between the two states and averaged
with it, track by track. What it says across the joint's path, and on the points, is kept; along
the path it says nothing new, because the move used its own state. A pooled keyframe's covariance
is too small in that one direction, which its free state takes up whole: for information W and
a direction v that is marginalised, W - W v v^T W / (v^T W v) is the same whatever the variance
along v. Joint and points come out right; the state of a pooled keyframe is known as well as that
of its first frame alone. The first keyframe has no free state and is never pooled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.stream.stream_records import IncrementalConfig
from akm_fg.geometry.batches import inverses
from akm_fg.geometry.rigid_motion import MIN_POINTS, procrustes
from akm_fg.records import BoolArray, FloatArray, PointTracks

# Takes points from where the part is in one frame (number) to where it is in another: R, t.
Motion = Callable[[int, int], tuple[FloatArray, FloatArray]]
_POSE_FREEDOM = 6  # of a rigid motion between two frames


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """What one frame of the stream sees of N tracks."""

    number: int  # of the frame, from 0
    p_world: FloatArray  # (N, 3) metres; NaN where not seen
    cov_world: FloatArray  # (N, 3, 3) m^2; NaN where not seen
    variance: FloatArray = field(init=False)  # (N,) of a coordinate; NaN where not seen

    def __post_init__(self) -> None:
        variance = np.trace(self.cov_world, axis1=1, axis2=2) / 3
        object.__setattr__(self, "variance", variance)

    @property
    def observed(self) -> BoolArray:
        """(N,) where the track is seen."""
        return np.asarray(np.isfinite(self.p_world[:, 0]))

    def moved(self, R_world: FloatArray, t_world: FloatArray) -> StreamFrame:
        """The frame after a rigid motion (3, 3), (3,)."""
        p = self.p_world @ R_world.T + t_world
        return StreamFrame(self.number, p, R_world @ self.cov_world @ R_world.T)


class Keyframes:
    """The keyframes and how far they are apart.

    Args:
        most: keyframes kept.
        most_pooled: frames that one keyframe may stand for.
        gate_sigmas: an observation farther from the keyframe's is not pooled.
    """

    def __init__(self, most: int, most_pooled: int, gate_sigmas: float) -> None:
        self.most, self.most_pooled, self._gate2 = most, most_pooled, gate_sigmas**2
        self.frames: list[StreamFrame] = []
        self.counts: list[int] = []  # frames in each
        self._distance_m = np.full((0, 0), np.inf)

    @property
    def numbers(self) -> NDArray[np.int_]:
        """(K,) growing."""
        return np.array([frame.number for frame in self.frames], dtype=int)

    @property
    def total(self) -> int:
        """Frames that are in any keyframe."""
        return sum(self.counts)

    def tracks(self) -> PointTracks:
        """The keyframes as (K, N) tracks."""
        return PointTracks(
            np.array([frame.p_world for frame in self.frames]),
            np.array([frame.cov_world for frame in self.frames]),
        )

    def select_columns(self, columns: NDArray[np.int_], size: int) -> None:
        """Rearrange tracks: `columns` go to the first places of `size`, the others are new."""
        self.frames = [_rearranged(frame, columns, size) for frame in self.frames]

    def distances(
        self, frame: StreamFrame, members: BoolArray, scale: float
    ) -> tuple[FloatArray, FloatArray]:
        """How far the part is in a frame from where it is in each keyframe.

        Root mean square displacement of its points by a free rigid motion: no joint is assumed.

        Args:
            frame: of N tracks.
            members: (N,) tracks known to be the part's.
            scale: noise over its claimed standard deviation.

        Returns:
            Distances (K,) in metres, and the standard deviation (K,) that noise alone gives
            them; infinite and zero where too few tracks are common.
        """
        a = np.array([keyframe.p_world for keyframe in self.frames])
        variance = np.array([keyframe.variance for keyframe in self.frames]) + frame.variance
        common = np.isfinite(variance) & members
        w = np.where(common, 1 / np.where(common, variance, 1.0), 0.0)
        a, b = np.where(common[..., None], a, 0.0), np.where(common[..., None], frame.p_world, 0.0)
        R, t = procrustes(a, b, w)
        step = a @ (R - np.eye(3)).swapaxes(1, 2) + t[:, None]
        count = common.sum(axis=1)
        total = np.maximum(w.sum(axis=1), 1e-300)
        power = (w * (step * step).sum(axis=2)).sum(axis=1) / total
        noise2 = _POSE_FREEDOM * scale**2 / total
        known = count >= MIN_POINTS
        distance = np.where(known, np.sqrt(np.maximum(power - noise2, 0.0)), np.inf)
        return distance, np.where(known, np.sqrt(noise2), 0.0)

    def add(self, frame: StreamFrame, distance_m: FloatArray, motion: Motion, scale: float) -> None:
        """Take a frame in as a keyframe; at the limit, the two closest others become one.

        Args:
            frame: of N tracks.
            distance_m: (K,) from the keyframes.
            motion: of the part between keyframes.
            scale: noise over its claimed standard deviation.
        """
        if len(self.frames) >= self.most:
            distance_m = np.delete(distance_m, self._merge_closest(motion, scale))
        grown = np.full((len(self.frames) + 1,) * 2, np.inf)
        grown[:-1, :-1] = self._distance_m
        grown[-1, :-1] = grown[:-1, -1] = distance_m
        self._distance_m = grown
        self.frames.append(frame)
        self.counts.append(1)

    def place_of(
        self, distance_m: FloatArray, noise_m: FloatArray, moves: bool, config: IncrementalConfig
    ) -> int | None:
        """The keyframe that a frame is pooled into; None where it becomes one itself.

        Args:
            distance_m: (K,) from the keyframes.
            noise_m: (K,) their standard deviations.
            moves: whether states tell places apart; else the frames of a place are shared out.
            config: how far apart places are, and how many frames one may have.
        """
        if distance_m.size == 1:
            return None
        counts = np.array(self.counts[1:])
        near = distance_m[1:] <= config.noise_floor * noise_m[1:]
        full = distance_m.size == self.most
        if not moves and near.any():
            if near.sum() < config.resting_keyframes and not full:
                return None
            return 1 + int(np.argmin(np.where(near, counts, counts.max() + 1)))
        nearest = 1 + int(np.argmin(distance_m[1:]))
        closer = full and distance_m[nearest] <= self.least_distance_m()
        return nearest if near[nearest - 1] or closer else None

    def least_distance_m(self) -> float:
        """Between any two keyframes that may be merged."""
        return float(self._distance_m[1:, 1:].min()) if len(self.frames) > 2 else np.inf

    def pool(self, index: int, frame: StreamFrame, scale: float, count: int = 1) -> None:
        """Average a frame that was moved to where keyframe `index` is with it.

        It counts as `count` frames, and a keyframe stands for no more than it may: frames at
        rest repeat the same systematic errors.
        """
        if self.counts[index] + count <= self.most_pooled:
            gate2 = self._gate2 * scale**2
            self.frames[index] = _averaged(self.frames[index], frame, gate2)
            self.counts[index] += count

    def _merge_closest(self, motion: Motion, scale: float) -> int:
        """Pool the later of the two closest keyframes into the earlier; the place it had."""
        apart = self._distance_m[1:, 1:]
        i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
        kept, gone = 1 + min(int(i), int(j)), 1 + max(int(i), int(j))
        later, keeper = self.frames[gone], self.frames[kept]
        there = later.moved(*motion(later.number, keeper.number))
        self.pool(kept, there, scale, self.counts[gone])
        del self.frames[gone], self.counts[gone]
        self._distance_m = np.delete(np.delete(self._distance_m, gone, 0), gone, 1)
        return gone


def _rearranged(frame: StreamFrame, columns: NDArray[np.int_], size: int) -> StreamFrame:
    p, cov = np.full((size, 3), np.nan), np.full((size, 3, 3), np.nan)
    p[: columns.size], cov[: columns.size] = frame.p_world[columns], frame.cov_world[columns]
    return StreamFrame(frame.number, p, cov)


def _averaged(keyframe: StreamFrame, frame: StreamFrame, gate2: float) -> StreamFrame:
    """The keyframe with each track's observations fused; those that disagree stay as they were."""
    p, cov = keyframe.p_world.copy(), keyframe.cov_world.copy()
    new = frame.observed & ~keyframe.observed
    p[new], cov[new] = frame.p_world[new], frame.cov_world[new]
    both = np.flatnonzero(frame.observed & keyframe.observed)
    e, C = frame.p_world[both] - p[both], cov[both]
    inverse = inverses(C + frame.cov_world[both])
    agree = np.einsum("ni,nij,nj->n", e, inverse, e) < gate2
    both, e, C = both[agree], e[agree], C[agree]
    gain = C @ inverse[agree]
    p[both] += np.einsum("nij,nj->ni", gain, e)
    fused = C - gain @ C
    cov[both] = (fused + fused.transpose(0, 2, 1)) / 2
    return StreamFrame(keyframe.number, p, cov)
