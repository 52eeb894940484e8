"""What is known of a part besides its tracks and its surface; see docs/decisions/0006.

The records are over all T frames of the input. What a graph needs of them depends on the kind (a
door's state is an angle, a drawer's a length) and on the graph's frames: `state_priors`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig, GraspConfig
from akm_fg.records import FloatArray, PointTracks
from factors.measurements.static_part import static_scale
from factors.measurements.track_cost import TrackObservations
from factors.priors.joint_limits import joint_limits_factor, joint_limits_residual
from factors.priors.state_motion import (
    StateMotionPrior,
    random_walk_prior,
    state_motion_factor,
    state_motion_residual,
    white_noise_acceleration_prior,
)

_STATIC_TRACKS = 20  # tell the level to three percent, in 8 ms
_STATIC_FRAMES = 20
# Beyond a limit. Noise of z standard deviations s takes a state that is at its stop z s w / (w^2 +
# s^2) widths w past it, at most z / 2: this is three standard deviations.
_PASSED_WIDTHS = 1.5


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """How noisy the tracks are, known from elsewhere: a scaled inverse chi-square on the variance.

    As if `observations` numbers of this scale had been seen beside the tracks. The standard
    deviation of the scale's logarithm is (2 observations)^(-1/2).
    """

    scale: float  # on the given standard deviations
    observations: float

    def log_density(self, scale: float) -> float:
        """Of a scale, over that of the most probable one."""
        ratio2 = (self.scale / scale) ** 2
        return 0.5 * self.observations * (math.log(ratio2) - ratio2 + 1)


@dataclass(frozen=True, slots=True)
class GripperPoses:
    """Where the gripper was while it held the part, by the robot's own joints."""

    T_world_gripper: FloatArray  # (T, 4, 4); frames outside the hold are not looked at
    grasp_frames: tuple[int, int]  # first and last frame in which it holds
    noise: GraspConfig = field(default_factory=GraspConfig)

    def __post_init__(self) -> None:
        T, (first, last) = len(self.T_world_gripper), self.grasp_frames
        if self.T_world_gripper.shape != (T, 4, 4):
            raise ValueError(f"gripper poses {self.T_world_gripper.shape}, expected (T, 4, 4)")
        if not 0 <= first <= last < T:
            raise ValueError(f"grasp_frames {self.grasp_frames} outside 0..{T - 1}")


@dataclass(frozen=True, slots=True)
class StateLimits:
    """Stops of a joint in the unit of its state, relative to the first frame (state zero).

    States are counted as the posterior does: their mean is positive.
    """

    lower: float | None  # None: not known
    upper: float | None
    width: float  # how soft they are: standard deviation of what lies beyond

    def __post_init__(self) -> None:
        known = [limit for limit in (self.lower, self.upper) if limit is not None]
        if not known or not all(math.isfinite(limit) for limit in known):
            raise ValueError(f"limits {self.lower} and {self.upper}, expected one or two numbers")
        if not 0 < self.width < math.inf:
            raise ValueError(f"width is {self.width}, expected > 0 and finite")
        lower = -math.inf if self.lower is None else self.lower
        upper = math.inf if self.upper is None else self.upper
        if not (lower < upper and lower <= self.width and upper >= -self.width):
            raise ValueError(
                f"limits {self.lower} and {self.upper}, expected lower < upper and the first "
                "frame's state, zero, between them"
            )

    def passed(self, q: FloatArray) -> bool:
        """Whether states (T,) lie beyond a limit by more than noise explains."""
        e, _ = joint_limits_residual(q, self.lower, self.upper, self.width)
        return bool((np.abs(e) > _PASSED_WIDTHS).any())


@dataclass(frozen=True, slots=True)
class StateKnowledge:
    """How the states move, and between which limits.

    The motion is in metres that the part moves (root mean square over its points) whatever the
    kind, so that it favours none; at most one of the two sigmas is given.
    """

    stamps_s: FloatArray | None = None  # (T,) of all frames
    sigma_m_per_sqrt_s: float | None = None  # random walk: sd of the change over one second
    sigma_m_per_s_three_halves: float | None = None  # white noise on acceleration: sd of velocity's
    limits_m: StateLimits | None = None  # of a drawer
    limits_rad: StateLimits | None = None  # of a door or a screw

    def __post_init__(self) -> None:
        walk, acceleration = self.sigma_m_per_sqrt_s, self.sigma_m_per_s_three_halves
        if walk is not None and acceleration is not None:
            raise ValueError(f"sigmas {walk} and {acceleration}, expected one motion prior")
        for sigma in (walk, acceleration):
            if sigma is not None and not 0 < sigma < math.inf:
                raise ValueError(f"sigma of the motion is {sigma}, expected > 0 and finite")
        moves = walk is not None or acceleration is not None
        if moves and self.stamps_s is None:
            raise ValueError("a motion prior needs the stamps of the frames")
        if self.stamps_s is not None and not (np.diff(self.stamps_s) > 0).all():
            raise ValueError("stamps_s must grow strictly")

    def limits(self, kind: str) -> StateLimits | None:
        """Those in the unit of a kind's state."""
        return self.limits_m if kind == "prismatic" else self.limits_rad


@dataclass(frozen=True, slots=True)
class Knowledge:
    """All of it; each field may be missing, and then changes nothing."""

    noise_level: NoiseLevel | None = None
    gripper: GripperPoses | None = None
    states: StateKnowledge | None = None

    def check(self, frames: int) -> None:
        """Refuse what is not over the input's frames.

        Raises:
            ValueError: gripper poses or stamps of another number of frames.
        """
        if self.gripper is not None and len(self.gripper.T_world_gripper) != frames:
            raise ValueError(f"{len(self.gripper.T_world_gripper)} gripper poses, {frames} frames")
        stamps = None if self.states is None else self.states.stamps_s
        if stamps is not None and stamps.shape != (frames,):
            raise ValueError(f"stamps {stamps.shape}, expected ({frames},)")


@dataclass(frozen=True, slots=True)
class StatePriors:
    """What `StateKnowledge` says of one kind's states in a graph's T frames, the first at zero."""

    motion: StateMotionPrior | None
    limits: StateLimits | None

    def factors(self, keys: Sequence[int | None]) -> list[gtsam.NonlinearFactor]:
        """For the graph; `keys` of the states."""
        factors: list[gtsam.NonlinearFactor] = []
        if self.motion is not None:
            factors.append(state_motion_factor(keys, self.motion))
        if self.limits is not None:
            ends = (self.limits.lower, self.limits.upper)
            factors.append(joint_limits_factor(keys, *ends, self.limits.width))
        return factors

    def log_density(self, q: FloatArray, log_flat: float) -> float:
        """Log prior density of the T - 1 states that are free.

        The motion's density where there is one, the flat one in the directions it leaves open;
        limits only take away: what lies between them has the density it had.

        Args:
            q: (T,) states.
            log_flat: log density of one state, see `laplace.log_state_prior`.
        """
        total = (q.size - 1) * log_flat
        if self.motion is not None:
            e, A = state_motion_residual(self.motion, q)
            A, rows = A[:, 1:], A.shape[0]
            open_states = np.eye(q.size - 1)[rows:]
            log_volume = float(np.linalg.slogdet(np.vstack([A, open_states]))[1])
            total = len(open_states) * log_flat + log_volume
            total -= 0.5 * (rows * math.log(2 * math.pi) + float(e @ e))
        if self.limits is not None:
            ends = (self.limits.lower, self.limits.upper)
            e, _ = joint_limits_residual(q[1:], *ends, self.limits.width)
            total -= 0.5 * float(e @ e)
        return total

    def information(self, q: FloatArray) -> FloatArray:
        """(T - 1, T - 1) on the free states."""
        information = np.zeros((q.size - 1, q.size - 1))
        if self.motion is not None:
            information += self.motion.A[:, 1:].T @ self.motion.A[:, 1:]
        if self.limits is not None:
            ends = (self.limits.lower, self.limits.upper)
            _, slope = joint_limits_residual(q[1:], *ends, self.limits.width)
            information += np.diag(slope**2)
        return information


def state_priors(
    states: StateKnowledge | None, kind: str, keyframes: NDArray[np.int_], metres_per_unit: float
) -> StatePriors | None:
    """The priors of one kind's states; None where nothing is known of them.

    Args:
        states: what is known.
        kind: moving joint kind.
        keyframes: (K,) frames in the graph.
        metres_per_unit: how far the part moves when the state grows by one.
    """
    if states is None:
        return None
    motion = None
    walk, acceleration = states.sigma_m_per_sqrt_s, states.sigma_m_per_s_three_halves
    if states.stamps_s is not None:
        stamps_s = states.stamps_s[keyframes]
        if walk is not None:
            motion = random_walk_prior(stamps_s, walk / metres_per_unit)
        elif acceleration is not None and keyframes.size > 2:
            motion = white_noise_acceleration_prior(stamps_s, acceleration / metres_per_unit)
    limits = states.limits(kind)
    return None if motion is None and limits is None else StatePriors(motion, limits)


def passed_limits(states: StateKnowledge | None, kind: str, q: FloatArray) -> list[str]:
    """A warning where the states (T,) of a kind contradict its limits."""
    limits = None if states is None or kind == "rigid" else states.limits(kind)
    if limits is None or not limits.passed(q):
        return []
    return [
        f"{kind} joint: states from {q.min():.3g} to {q.max():.3g} pass the given limits "
        f"{limits.lower} to {limits.upper}"
    ]


def noise_level_of_static(static: PointTracks, config: FitConfig) -> NoiseLevel | None:
    """The level at which the points that rest are seen; None where they do not tell one.

    Args:
        static: T frames of tracks of what does not move.
        config: tuning.
    """
    T = static.observed.shape[0]
    frames = np.unique(np.linspace(0, T - 1, min(T, _STATIC_FRAMES)).astype(int))
    seen = np.flatnonzero(static.observed[frames].sum(axis=0) >= 2)
    if seen.size == 0:
        return None
    some = seen[
        np.unique(np.linspace(0, seen.size - 1, min(seen.size, _STATIC_TRACKS)).astype(int))
    ]
    tracks = TrackObservations.from_points(
        static.p_world[frames][:, some], static.cov_world[frames][:, some]
    )
    try:
        found = static_scale(tracks, config.dof)
    except ValueError:  # points that do not jitter at all: their noise is not that of the part
        return None
    variance = found.log_scale_sd**2 + config.moving_noise_sd_log**2
    return NoiseLevel(config.moving_noise * math.exp(found.log_scale), 0.5 / variance)
