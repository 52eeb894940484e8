"""What any method says about a joint, in one form: the graph, the paper's method, the peer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import FloatArray
from experiments.baselines.estimate import JointEstimate


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What a posterior says of its own error; baselines and peers have none."""

    T_world_joint: FloatArray  # (4, 4)
    cov: FloatArray  # (6, 6), tangent of T_world_joint
    axis_bound_rad: float  # radius that holds 95 %
    pivot_bound_m: float | None  # 95 % bound of the axis line from the pivot; None for prismatic
    state_sd: FloatArray  # (T,)


@dataclass(frozen=True, slots=True)
class JointFit:
    """The joint of one kind that explains the data best."""

    axis: FloatArray  # (3,) unit, world
    pivot: FloatArray | None  # (3,) world; None for prismatic
    states: FloatArray  # (T,), zero in frame 0; NaN where not known
    uncertainty: Uncertainty | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """One method's answer to one opening."""

    kind: str | None  # as named: undecided is an answer; None where the method failed
    fits: Mapping[str, JointFit]  # by kind, as far as the method has them
    kind_probability: Mapping[str, float] | None = None
    parametric: bool | None = None
    tracks_rejected: int | None = None
    time_s: Mapping[str, float] = field(default_factory=dict)
    failure: str | None = None


def answer_of_posterior(posterior: ArticulationPosterior) -> Answer:
    """The graph's answer: a fit of every kind that moves."""
    fits = {}
    for kind, alternative in posterior.alternatives.items():
        joint, states = alternative.joint, alternative.states
        if joint is not None and states is not None:
            bounds = joint.axis_bound_rad(), joint.pivot_bound_m()
            uncertainty = Uncertainty(joint.T_world_joint, joint.cov, *bounds, states.sd)
            fits[kind] = JointFit(joint.axis, joint.pivot, states.mean, uncertainty)
    return Answer(
        kind=posterior.kind,
        fits=fits,
        kind_probability=posterior.kind_probability,
        parametric=posterior.fit.parametric,
        tracks_rejected=posterior.fit.tracks_rejected,
        time_s=posterior.time_s,
    )


def answer_of_estimates(
    named: JointEstimate, others: Mapping[str, JointEstimate] | None = None
) -> Answer:
    """A point estimate, and what the method found for other kinds.

    Args:
        named: the method's answer.
        others: by kind.
    """
    estimates = {**(others or {}), named.kind: named}
    fits = {kind: JointFit(e.axis, e.pivot, e.states) for kind, e in estimates.items()}
    return Answer(named.kind, fits, time_s=named.time_s)


def failed(problem: Exception) -> Answer:
    """A trial without an answer is a result too."""
    return Answer(None, {}, failure=f"{type(problem).__name__}: {problem}")
