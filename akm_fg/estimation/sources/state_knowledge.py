"""State knowledge: how the states move, and between which limits; see docs/decisions/0006.

What a graph needs of it depends on the kind (a door's state is an angle, a drawer's a length) and
on the graph's frames: `state_priors`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.joint_prior import log_state_prior
from akm_fg.estimation.sources.source import At, Contribution, Part, Source, Term
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray
from factors.joint import JointKind
from factors.joint_variables import JointVariables
from factors.priors.joint_limits import joint_limits_factor, joint_limits_residual
from factors.priors.state_motion import (
    StateMotionPrior,
    random_walk_prior,
    state_motion_factor,
    state_motion_residual,
    white_noise_acceleration_prior,
)

STATES = "state knowledge"
# Beyond a limit. Noise of z standard deviations s takes a state that is at its stop z s w / (w^2 +
# s^2) widths w past it, at most z / 2: this is three standard deviations.
_PASSED_WIDTHS = 1.5


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
class StateKnowledge(Source):
    """How the states move, and between which limits.

    The motion is in metres that the part moves (root mean square over its points) whatever the
    kind, so that it favours none; at most one of the two sigmas is given.
    """

    stamps_s: FloatArray | None = None  # (T,) of all frames
    sigma_m_per_sqrt_s: float | None = None  # random walk: sd of the change over one second
    sigma_m_per_s_three_halves: float | None = None  # white noise on acceleration: sd of velocity's
    limits_m: StateLimits | None = None  # of a drawer
    limits_rad: StateLimits | None = None  # of a door or a screw
    name: ClassVar[str] = STATES

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

    def limits(self, kind: JointKind) -> StateLimits | None:
        """Those in the unit of a kind's state."""
        return self.limits_rad if kind.turns else self.limits_m

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> Term | None:
        """The priors of one kind's states; what a state is in metres is taken at the guess."""
        metres = part.metres_per_unit(guess)
        priors = state_priors(self, guess.kind, part.keyframes, metres)
        return None if priors is None else StateTerm(priors, part)

    def check(self, frames: int) -> None:
        """Refuse stamps of another number of frames.

        Raises:
            ValueError: they are.
        """
        if self.stamps_s is not None and self.stamps_s.shape != (frames,):
            raise ValueError(f"stamps {self.stamps_s.shape}, expected ({frames},)")

    def warnings(self, kind: str, q: FloatArray) -> list[str]:
        """One where the states contradict the limits."""
        limits = None if kind == "rigid" else self.limits(JointKind(kind))
        if limits is None or not limits.passed(q):
            return []
        return [
            f"{kind} joint: states from {q.min():.3g} to {q.max():.3g} pass the given limits "
            f"{limits.lower} to {limits.upper}"
        ]


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
        """Log prior density of the T - 1 states that are free, over the flat one.

        The motion's density where there is one, the flat one in the directions it leaves open;
        limits only take away: what lies between them has the density it had.

        Args:
            q: (T,) states.
            log_flat: log density of one state, see `laplace.log_state_prior`.
        """
        total = 0.0
        if self.motion is not None:
            e, A = state_motion_residual(self.motion, q)
            A, rows = A[:, 1:], A.shape[0]
            open_states = np.eye(q.size - 1)[rows:]
            log_volume = float(np.linalg.slogdet(np.vstack([A, open_states]))[1])
            total = log_volume - rows * log_flat
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
    states: StateKnowledge, kind: JointKind, keyframes: NDArray[np.int_], metres_per_unit: float
) -> StatePriors | None:
    """The priors of one kind's states; None where nothing is known of them.

    Args:
        states: what is known.
        kind: moving joint kind.
        keyframes: (K,) frames in the graph.
        metres_per_unit: how far the part moves when the state grows by one.
    """
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


class StateTerm(Term):
    """The priors of one kind's states in its graph."""

    name = STATES

    def __init__(self, priors: StatePriors, part: Part) -> None:
        self._priors, self._part = priors, part

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """None where nothing moved: there are no states."""
        return self._priors.factors(variables.state_keys) if variables.free else []

    def contribution(self, at: At, freedom: float) -> Contribution:
        """Information on the states, and their density over the flat one."""
        free, q = at.variables.free, at.guess.q
        if not free:
            return Contribution(information=np.zeros((0, 0)), held=np.zeros(0))
        tied = self._priors.information(q)
        size = at.columns.size
        information = np.zeros((size, size))
        information[-len(free) :, -len(free) :] = tied
        metres = self._part.metres_per_unit(at.guess)
        log_flat = log_state_prior(q, metres, self._part.config.prior)
        return Contribution(
            information=information,
            held=np.zeros(len(free)),
            tied=tied,
            log_states=self._priors.log_density(q, log_flat),
        )
