"""What the estimator returns: every number with its uncertainty.

Conventions: docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, optimize, special

from akm_fg.records import Doubt, FloatArray
from factors.joint import Joint, JointKind, Unit

if TYPE_CHECKING:
    import pandas

    from akm_fg.prediction import PointPrediction

NamedKind = Literal["rigid", "prismatic", "revolute", "helical", "undecided"]


@dataclass(frozen=True, slots=True)
class JointPosterior:
    """A Gaussian on the tangent space of the joint frame, for one joint kind.

    The true frame is T_world_joint * Exp(xi), xi ~ N(0, cov), xi in GTSAM order
    (wx, wy, wz [rad], vx, vy, vz [m]); z is the joint axis. `gauge` names the directions that
    no measurement can fix; they are held where they are and have zero covariance.
    """

    joint: Joint
    cov: FloatArray  # (6, 6)
    pitch_sd_m_per_rad: float | None = None  # of a joint with a pitch

    @property
    def kind(self) -> JointKind:
        """Of the joint."""
        return self.joint.kind

    @property
    def T_world_joint(self) -> FloatArray:
        """(4, 4)."""
        return self.joint.T_world_joint

    @property
    def gauge(self) -> tuple[str, ...]:
        """Directions of the tangent that no measurement can fix."""
        return self.joint.kind.gauge

    @property
    def pitch_m_per_rad(self) -> float | None:
        """Of a joint with a pitch."""
        return self.joint.pitch if self.joint.kind.has_pitch else None

    @property
    def turns(self) -> bool:
        """Whether the part turns about an axis line."""
        return self.joint.kind.turns

    @property
    def axis(self) -> FloatArray:
        """(3,) unit vector; the state grows along it (right-hand rule)."""
        return self.T_world_joint[:3, 2]

    @property
    def pivot(self) -> FloatArray | None:
        """(3,) the point of the axis nearest to the moving points; None for prismatic."""
        return self.T_world_joint[:3, 3] if self.turns else None

    @property
    def axis_sd_rad(self) -> float:
        """Root mean square of the axis' standard deviations in its two directions."""
        return float(np.sqrt(np.trace(self.cov[:2, :2]) / 2))

    @property
    def pivot_sd_m(self) -> float | None:
        """Root mean square of the pivot's deviations across the axis; None for prismatic."""
        if not self.turns:
            return None
        return float(np.sqrt(np.trace(self.cov[3:5, 3:5]) / 2))

    def axis_bound_rad(self, level: float = 0.95) -> float:
        """Angle between true and estimated axis that is not exceeded with this probability."""
        return radius_quantile(self.cov[:2, :2], level)

    def pivot_bound_m(self, level: float = 0.95) -> float | None:
        """Distance of the true axis line from the pivot, not exceeded with this probability."""
        return radius_quantile(self.cov[3:5, 3:5], level) if self.turns else None


@dataclass(frozen=True, slots=True)
class StatePosterior:
    """Joint states per frame, relative to frame 0, where the state is zero by definition."""

    unit: Unit
    mean: FloatArray  # (T,); NaN where the part was not seen
    sd: FloatArray  # (T,)
    from_closed: bool = False  # counted from where the part is closed instead

    @property
    def last_seen(self) -> int | None:
        """The last frame with a state; None where the part was never seen."""
        seen = np.flatnonzero(np.isfinite(self.mean))
        return int(seen[-1]) if seen.size else None


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why a kind is likely or not: the terms of its Laplace evidence, nats.

    Repeated observations that err together count once in all of them.
    """

    log_likelihood: float  # of the observations at the best joint and states, latents marginal
    log_states: float  # prior density of the states times the width the data leave them
    log_joint_prior: float  # prior density of the joint's frame and pitch
    log_joint_volume: float  # width that the data leave the joint
    log_nested: float = 0.0  # what systematic errors take from a screw's lead over its hinge
    log_noise: float = 0.0  # density of the noise level that this kind needs, where it is known

    @property
    def total(self) -> float:
        """Log evidence."""
        joint = self.log_joint_prior + self.log_joint_volume + self.log_nested
        return self.log_likelihood + self.log_states + joint + self.log_noise


@dataclass(frozen=True, slots=True)
class KindPosterior:
    """One kind's own fit."""

    joint: JointPosterior | None  # None for rigid
    states: StatePosterior | None
    evidence: Evidence

    @property
    def log_evidence(self) -> float:
        """Sum of the terms."""
        return self.evidence.total


@dataclass(frozen=True, slots=True)
class FitReport:
    """How the fit went."""

    log_evidence: float
    tracks_used: int
    tracks_rejected: int
    rms_m: float  # of the inliers' residuals; of the surface's where there are no tracks
    noise_scale: float  # estimated over assumed noise; metres where no noise was given
    correlation_frames: float  # integrated autocorrelation time of the residuals
    correlation_points: float  # neighbouring points that err together
    parametric: bool  # False when no kind explains the data
    warnings: tuple[str, ...] = ()
    keyframes_registered: tuple[int, ...] = ()  # frames whose surfaces are in the graph
    patches_used: int = 0  # of the part's surface
    patches_rms_m: float | None = None  # of their readings, along the normals
    patches_as_one: float | None = None  # neighbouring readings that err together
    rows_left_out: int = 0  # of a pose log, because they jump
    holds: tuple[tuple[int, int], ...] = ()  # first and last frames of the grasps in the graph


@dataclass(frozen=True, slots=True)
class ArticulationPosterior:
    """The answer: a probability for each kind, and for each kind joint and states."""

    name: str
    kind: NamedKind
    kind_probability: dict[str, float]
    alternatives: dict[str, KindPosterior]  # every kind that could be fitted
    fit: FitReport
    time_s: dict[str, float] = field(default_factory=dict)
    other_parts: tuple[ArticulationPosterior, ...] = ()  # of tracks: others that move as well

    @property
    def best(self) -> KindPosterior:
        """The most probable kind's fit, also where the kind is undecided."""
        return self.alternatives[max(self.kind_probability, key=self.kind_probability.__getitem__)]

    def predict(self, q: float, p_world: FloatArray, q_sd: float = 0.0) -> PointPrediction:
        """Where points of the part are at a state, by the most probable kind's joint.

        The pose of a frame on the part: `akm_fg.prediction.predict_pose`.

        Args:
            q: the state, from the one in which the points were seen; radians or metres.
            p_world: (N, 3), or (3,), the points where they were seen (at state 0: in frame 0).
            q_sd: standard deviation of the state.

        Raises:
            ValueError: nothing moves in the most probable kind, or a shape or state is wrong.
        """
        from akm_fg.prediction import predict_points

        joint = self.best.joint
        if joint is None:
            raise ValueError(f"{self.name}: the most probable kind is rigid; expected a joint")
        return predict_points(joint, q, p_world, q_sd)

    def states_frame(self, stamps_s: Sequence[float] | None = None) -> pandas.DataFrame:
        """The states as a pandas frame, one row a frame of the input.

        Columns `state`, `sd`, and `low` and `high`, which hold 95 %; NaN where the part was not
        seen. `attrs["unit"]` is rad or m, `attrs["kind"]` whose states they are.

        Args:
            stamps_s: times of the frames, as the index; their numbers if not given.

        Raises:
            MissingDependency: pandas is not installed.
            ValueError: another number of stamps than of frames, or nothing moves.
        """
        from akm_fg.posterior_views import states_as_frame

        return states_as_frame(self, stamps_s)

    def with_states(self, mean: FloatArray, sd: FloatArray) -> ArticulationPosterior:
        """With other states (T,) of the most probable kind, which moves, and their deviations."""
        best = self.best
        assert best.joint is not None and best.states is not None
        kind = replace(best, states=replace(best.states, mean=mean, sd=sd))
        return replace(self, alternatives={**self.alternatives, str(best.joint.kind): kind})

    def __repr__(self) -> str:
        words = "; ".join(self.summary().splitlines())
        return f"<{type(self).__name__} {words}>"

    def summary(self) -> str:
        """Kind, axis, pivot, states and warnings in lines for a person; bounds hold 95 %."""
        from akm_fg.posterior_views import posterior_in_words

        return "\n".join(posterior_in_words(self))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and strings: the posterior's JSON (docs/conventions.md)."""
        from akm_fg.posterior_views import posterior_as_dict

        return posterior_as_dict(self)

    def over_frames(self, numbers: NDArray[np.int_], frames: int) -> ArticulationPosterior:
        """The answer over all frames of an input, of which it has the states of some.

        Args:
            numbers: of those frames.
            frames: of the input; in the others no state is known.
        """
        alternatives = {}
        for name, kind in self.alternatives.items():
            states = kind.states
            if states is not None:
                mean, sd = np.full(frames, np.nan), np.full(frames, np.nan)
                mean[numbers], sd[numbers] = states.mean, states.sd
                states = replace(states, mean=mean, sd=sd)
            alternatives[name] = replace(kind, states=states)
        fit = replace(
            self.fit,
            keyframes_registered=tuple(numbers[list(self.fit.keyframes_registered)].tolist()),
            holds=tuple((int(numbers[a]), int(numbers[b])) for a, b in self.fit.holds),
        )
        return replace(self, alternatives=alternatives, fit=fit)


def doubted(posterior: ArticulationPosterior, doubts: Sequence[Doubt]) -> ArticulationPosterior:
    """The answer with warnings; undecided where one of them takes its ground away."""
    if not doubts:
        return posterior
    warnings = (*posterior.fit.warnings, *(doubt.text for doubt in doubts))
    kind: NamedKind = "undecided" if any(d.decides for d in doubts) else posterior.kind
    return replace(posterior, kind=kind, fit=replace(posterior.fit, warnings=warnings))


def radius_quantile(cov: FloatArray, level: float) -> float:
    """Radius r with P(|x| <= r) = level for x ~ N(0, cov), cov (2, 2).

    The radial distribution of a bivariate normal is Hoyt's (1947): integrate the chi-square of
    each bearing, P(|x| <= r) = 1/(2 pi) int [1 - exp(-r^2 / (2 v(phi)))] dphi over the
    whitened bearing phi with v(phi) = a cos^2 + b sin^2 and a, b the principal variances.
    """
    small, large = np.maximum(np.linalg.eigvalsh(cov), 0.0)
    if large <= 0:
        return 0.0

    def miss(r: float) -> float:
        def density(phi: float) -> float:
            v = large * np.cos(phi) ** 2 + small * np.sin(phi) ** 2
            return float(np.exp(-0.5 * r**2 / max(v, 1e-12 * large)))

        return integrate.quad(density, 0, np.pi / 2)[0] / (np.pi / 2) - (1 - level)

    high = 1.01 * np.sqrt(2 * large * -np.log(1 - level))
    return float(optimize.brentq(miss, 0.0, high))  # the circular case bounds it


def normal_bound(level: float = 0.95) -> float:
    """Standard deviations on either side of a mean that hold this probability."""
    return float(special.ndtri(0.5 + level / 2))
