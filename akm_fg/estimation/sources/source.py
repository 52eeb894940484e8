"""What a source of information is, and the one record of what it contributes.

Every source (tracks, surface, orientations, gripper, static points, state knowledge) is one file.
It gives a `Term` for the graph of one kind; the estimator loops over the terms and knows none of
them by name:

    factors        for the GTSAM graph, over the joint's variables and the term's own;
    contribution   at a solution: log likelihood, information, and how its own covariance errs.

The kinds share their sources; a term belongs to one kind and one start, and may remember where its
last evaluation was.

**Covariances.** With H = sum of the contributions' informations H_s and that of the priors, and
true variances c_s times those that H_s claims, the covariance of the solution is
H^-1 (sum c_s H_s + H_prior) H^-1 (the sandwich; Huber and Ronchetti, Robust Statistics, 2009, sec.
3.2). Each c_s is found from the source's own residuals and multiplies its own information alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.joint_prior import metres_per_unit
from akm_fg.geometry.batches import solutions
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray
from akm_fg.steps import Steps
from factors.joint_variables import JointVariables

if TYPE_CHECKING:
    from akm_fg.estimation.given.problem import FitProblem


@dataclass(frozen=True, slots=True)
class Part:
    """What a term may know of the part beside its own data."""

    config: FitConfig
    centroid_world: FloatArray  # (3,) of the moving points at state zero
    lever_m: float  # root mean square size of the moving points about it
    keyframes: NDArray[np.int_]  # (T,) the graph's frames among those of the input

    def metres_per_unit(self, guess: JointGuess) -> float:
        """How far the part moves when its state grows by one: root mean square over its points."""
        return metres_per_unit(guess.joint, self.centroid_world, self.lever_m)


@dataclass(frozen=True, slots=True)
class At:
    """Values of one kind's variables, and the noise scales that hold there."""

    guess: JointGuess  # joint and states (T,)
    variables: JointVariables  # no state is free where nothing moved
    values: gtsam.Values  # the terms' own variables among them
    scales: Mapping[str, float]  # of each term: factor on its standard deviations

    @property
    def columns(self) -> NDArray[np.int_]:
        """Of (xi, q_0 .. q_T-1, [pitch]): the joint's observable directions, pitch, free states.

        Informations are over these; none where nothing moved.
        """
        kind, free = self.variables.kind, self.variables.free
        if not free:
            return np.zeros(0, dtype=int)
        pitch = [6 + len(self.variables.state_keys)] if kind.has_pitch else []
        return np.array([*kind.observable, *pitch, *(6 + t for t in free)])


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """How noisy a source is, known from elsewhere: a scaled inverse chi-square on the variance.

    As if `observations` numbers of this scale had been seen beside its own. The standard deviation
    of the scale's logarithm is (2 observations)^(-1/2).
    """

    scale: float  # on the given standard deviations
    observations: float

    def log_density(self, scale: float) -> float:
        """Of a scale, over that of the most probable one."""
        ratio2 = (self.scale / scale) ** 2
        return 0.5 * self.observations * (np.log(ratio2) - ratio2 + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """What one source says at the solution of one kind, counted as it is in the graph.

    `information` is over `At.columns`; the term's own variables are marginalised.
    """

    information: FloatArray  # (d, d)
    held: FloatArray  # (F,) on each free state, all else held
    log_likelihood: float = 0.0  # normalised, at the best latents
    # Share of `information` and `held` that the likelihood counts: less than one where it judges
    # by larger errors than the graph weighs by.
    judged_share: float = 1.0
    log_correlated: float = 0.0  # likewise, with what errs together counted as such already
    log_latents: float = 0.0  # log of the width that the data leave the latents; flat prior
    own_variables: int = 0  # numbers beside the joint's that are marginalised by Laplace's method
    own_log_det: float = 0.0  # of the information on them, all else held
    tied: FloatArray | None = None  # (F, F) on the states, where it ties them to one another
    log_states: float = 0.0  # prior density of the states, over the flat one
    log_noise: float = 0.0  # density of a noise level, over that of the most probable one
    # True variances over those that `information` claims: fixed + per_shared * (observations of
    # the tracks that err together and count as one).
    variance_fixed: float = 1.0
    variance_per_as_one: float = 0.0
    readings: float = 0.0  # independent numbers that it rests on
    explained: bool | None = None  # whether its residuals are noise; None where it cannot tell
    report: Mapping[str, Any] = field(default_factory=dict)  # fields of `FitReport`

    def variance_ratio(self, as_one: float) -> float:
        """True variances over those that `information` claims."""
        return self.variance_fixed + self.variance_per_as_one * as_one

    def reported(self, as_one: float) -> dict[str, Any]:
        """Fields of `FitReport`."""
        return dict(self.report)

    def turned(self, signs: FloatArray) -> Contribution:
        """The same with the joint frame turned about its x; signs (d,) of the columns."""
        if not self.information.size:
            return self
        return replace(self, information=self.information * np.outer(signs, signs))


class Term(ABC):
    """A source in the graph of one kind, from one start."""

    name: ClassVar[str]

    @property
    def own(self) -> Mapping[int, int]:
        """Keys of its own variables, and their tangent dimensions."""
        return {}

    @property
    def numbers(self) -> tuple[int, int]:
        """Observed numbers, and latent ones fitted to them, in the noise's degrees of freedom."""
        return 0, 0

    @property
    def levels(self) -> Mapping[str, NoiseLevel]:
        """What it knows of the noise of sources, by their names."""
        return {}

    def insert(self, values: gtsam.Values) -> None:
        """Its own variables where they start."""

    def start_scale(self, near: bool) -> float:
        """Its noise scale to begin with; `near`: the start was fitted to the data already."""
        return 1.0

    @abstractmethod
    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """For the graph."""

    def rescaled(self, at: At, freedom: float, level: NoiseLevel | None) -> float:
        """One step towards the scale of largest marginal likelihood (expectation maximisation).

        Args:
            at: a solution.
            freedom: share of the observed numbers that is left after the fit.
            level: what other sources know of its noise.
        """
        return at.scales[self.name]

    @abstractmethod
    def contribution(self, at: At, freedom: float) -> Contribution:
        """What it says at a solution; arguments as of `rescaled`."""


class Source(ABC):
    """Information on one part, shared by all kinds."""

    name: ClassVar[str]

    @abstractmethod
    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> Term | None:
        """The source in one kind's graph; None where it says nothing about that kind.

        Args:
            guess: where the graph starts.
            part: the part.
            previous: its contribution to an earlier fit of this kind near the guess.
        """

    @property
    def readings(self) -> float:
        """How many independent numbers were observed, as often as they count in the graph."""
        return 0.0

    def check(self, frames: int) -> None:
        """Refuse what is not over the input's frames (ValueError)."""

    @property
    def own_frames(self) -> NDArray[np.int_]:
        """(F,) the graph's frames that it tells of itself (indices, growing); none: of any."""
        return np.zeros(0, dtype=int)

    def restricted(self, frames: NDArray[np.int_]) -> Source | None:
        """Over some of the graph's frames (indices, growing); None where nothing is left."""
        return self

    def moved(self, places: NDArray[np.int_]) -> Source:
        """In another graph: `places` (T,) of this one's frames there; its own must have one."""
        return self

    def recounted(self, as_one: float) -> Source:
        """Weighed for tracks of which so many observations count as one."""
        return self

    def levelled(self, said: Sequence[Contribution]) -> list[Contribution]:
        """What it said of each kind, in the same order, at a noise level that all kinds share."""
        return list(said)

    def warnings(self, kind: str, q: FloatArray) -> list[str]:
        """What contradicts it in the states (T,) of a kind, counted as they grow."""
        return []


@dataclass(frozen=True, slots=True)
class FirstFit:
    """What a fit to the sources so far says of the part."""

    guess: JointGuess  # the likeliest joint and its states; nothing moved: a drawer that stays shut
    state_sd: FloatArray  # (T,)
    scales: Mapping[str, float]  # of the sources' noise
    as_one: float  # observations of the tracks that err together and count as one
    moved: bool = True  # False where rest is the likeliest


class LateSource(ABC):
    """Information that can only be read once a first fit says where the part was."""

    @abstractmethod
    def found(
        self, problem: FitProblem, first: FirstFit
    ) -> Steps[tuple[FitProblem, FirstFit] | None]:
        """The problem with what it tells beside a first fit, and that fit with it, in steps.

        None where it tells nothing.
        """

    def check(self, frames: int) -> None:
        """Refuse what is not over the input's frames (ValueError)."""


Given = Source | LateSource


def information_of(
    factors: Sequence[gtsam.NonlinearFactor], at: At, own: Mapping[int, int]
) -> tuple[FloatArray, FloatArray, float]:
    """What factors say at a solution, by linearising them.

    Args:
        factors: over the joint's variables and `own` ones.
        at: the solution.
        own: keys and tangent dimensions of the term's own variables.

    Returns:
        Information (d, d) over `At.columns`, own variables marginalised; its diagonal (F,) at the
        free states, all else held; log det of the information on the own variables.

    Raises:
        AxisUnobservable: the factors leave the own variables open, whatever the joint.
    """
    linear, ordering = _linearised(factors, at, own)
    H, _ = linear.hessian(ordering)
    size = H.shape[0] - sum(own.values())
    columns, kind, free = at.columns, at.variables.kind, at.variables.free
    here = [*kind.observable, *range(6, size)] if columns.size else []
    diagonal = np.diag(H)[size - len(free) : size].copy()
    if not own:
        return H[np.ix_(here, here)], diagonal, 0.0
    cross, of_own = H[:size, size:], H[size:, size:]
    marginal = H[:size, :size] - cross @ solutions(of_own, cross.T)
    log_det = float(np.linalg.slogdet(of_own)[1])
    if not (np.isfinite(marginal).all() and np.isfinite(log_det)):
        raise AxisUnobservable(
            f"{at.variables.kind} joint: the data leave a variable of one source open"
        )
    marginal = (marginal + marginal.T) / 2
    return marginal[np.ix_(here, here)], diagonal, log_det


def _linearised(
    factors: Sequence[gtsam.NonlinearFactor], at: At, own: Mapping[int, int]
) -> tuple[gtsam.GaussianFactorGraph, gtsam.Ordering]:
    """The factors at the solution, and the order: joint, pitch, free states, own variables."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    linear, ordering, variables = graph.linearize(at.values), gtsam.Ordering(), at.variables
    pitch = [] if variables.pitch_key is None else [variables.pitch_key]
    states = [key for key in variables.state_keys if key is not None]
    dims = {variables.joint_key: 6, **dict.fromkeys([*pitch, *states], 1), **own}
    unit = gtsam.noiseModel.Unit.Create(1)
    for key, dim in dims.items():
        ordering.push_back(key)
        # What no factor touches keeps its place in the order by a row of zeros.
        linear.push_back(gtsam.JacobianFactor(key, np.zeros((1, dim)), np.zeros(1), unit))
    return linear, ordering
