"""Laplace approximation: covariance and evidence of one kind at its solution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.sources.source import Contribution
from akm_fg.estimation.sources.tracks import TRACKS, TrackContribution
from akm_fg.geometry.joint_guess import TURN_ABOUT_X, JointGuess, still
from akm_fg.posterior import Evidence
from akm_fg.records import FloatArray
from factors.joint import TANGENT, Joint, JointKind


@dataclass(frozen=True, slots=True)
class KindFit:
    """The solved graph of one kind.

    Matrices (d, d) are over the joint's observable directions, a helical joint's pitch, and the
    free states.
    """

    joint: Joint | None  # None: nothing moved
    q: FloatArray  # (T,)
    cov: FloatArray  # (d, d)
    information: FloatArray  # (d, d) the graph's
    prior_information: FloatArray  # (d, d) that of the joint's priors in it
    widest: FloatArray  # (k, k) on the joint's coordinates, of the widest that its prior allows
    said: Mapping[str, Contribution]  # by the sources, by their names
    scales: Mapping[str, float]  # of the sources' noise
    log_prior: float  # density of the joint alone, at the solution
    log_flat: float  # prior density of all free states, where nothing is known of them
    judged: FloatArray  # (d, d) the information that the likelihoods count
    log_held: float  # log det of that on the states, all else held
    as_one: float = 1.0  # observations of the tracks that err together (in time and space)
    disagreement: float = 1.0  # of its sources, on all variances: see `agreement`
    log_beyond: float = 0.0  # of the evidence, what Laplace's method misses of a vague joint
    log_nested: float = 0.0  # see `akm_fg.estimation.between_kinds.evidence.nested_screw`

    @property
    def kind(self) -> str:
        """Its name; rigid where nothing moved."""
        return "rigid" if self.joint is None else str(self.joint.kind)

    @property
    def moving(self) -> Joint:
        """The joint, of a kind that moves."""
        assert self.joint is not None
        return self.joint

    @property
    def tracks(self) -> TrackContribution:
        """What the tracks say."""
        said = self.said[TRACKS]
        assert isinstance(said, TrackContribution)
        return said

    @property
    def track_variance_ratio(self) -> float:
        """True variances of the tracks' information over those that it claims."""
        return self.tracks.variance_ratio(self.as_one)

    @property
    def log_likelihood(self) -> float:
        """Of all observations at the best latents, normalised."""
        return sum(said.log_likelihood + said.log_correlated for said in self.said.values())

    @property
    def guess(self) -> JointGuess:
        """Where the fit ended; rigid as a prismatic joint that stays at zero."""
        return still(self.q.size) if self.joint is None else JointGuess(self.joint, self.q)

    @property
    def log_evidence(self) -> float:
        """See `evidence`."""
        return self.evidence.total

    @property
    def evidence(self) -> Evidence:
        """Laplace evidence, one in as_one observations counted.

        The marginal likelihood of joint and the sources' own variables (latent points integrated
        out, states frame by frame) to the power 1 / as_one, times their prior, integrated by
        Laplace's method; the joint's width there is at most that of its prior (`_log_width`).
        """
        said = self.said.values()
        own = sum(each.own_variables for each in said)
        own_log_det = sum(each.own_log_det for each in said)
        width = 0.5 * (self.q.size - 1) * math.log(2 * math.pi) - 0.5 * self.log_held
        log_states = self.log_flat + sum(each.log_states for each in said) + width
        log_latents = sum(each.log_latents for each in said)
        return Evidence(
            log_likelihood=(sum(each.log_likelihood for each in said) + log_latents) / self.as_one
            + sum(each.log_correlated for each in said),
            log_states=0.0 if self.joint is None else log_states / self.as_one,
            log_joint_prior=self.log_prior,
            log_joint_volume=self._log_width()
            + self.log_beyond
            + 0.5 * own * math.log(2 * math.pi * self.as_one)
            - 0.5 * own_log_det,
            log_nested=self.log_nested,
            log_noise=sum(each.log_noise for each in said),
        )

    def _log_width(self) -> float:
        """Of the joint's posterior: log of the integral of its Gaussian over its coordinates.

        Coordinates that the data leave open are as wide as their prior, and not wider: an axis
        anywhere on its half sphere, a hinge anywhere around the part. Without that a vague joint
        gains by its volume what no prior gives.
        """
        if self.joint is None:
            return 0.0
        k = self.joint.kind.coordinates
        H = self.judged
        on_states = np.linalg.slogdet(H[k:, k:])[1]
        # The priors count once however many observations count as one.
        left = H[:k, :k] - H[:k, k:] @ np.linalg.solve(H[k:, k:], H[k:, :k])
        known = self.prior_information[:k, :k]
        counted = (left - known) / self.as_one + known + self.widest
        log_det = np.linalg.slogdet(counted)[1] + on_states - self.log_held
        return float(0.5 * k * math.log(2 * math.pi) - 0.5 * log_det)

    @property
    def joint_cov(self) -> FloatArray:
        """(6, 6) in the tangent of T_world_joint, zero along the gauge directions."""
        cov, directions = np.zeros((6, 6)), self.moving.kind.observable
        k = len(directions)
        cov[np.ix_(directions, directions)] = self.cov[:k, :k]
        return cov

    @property
    def pitch_sd(self) -> float:
        """Standard deviation of the pitch of a joint that has one, metres per radian."""
        k = len(self.moving.kind.observable)
        return math.sqrt(float(self.cov[k, k]))

    @property
    def state_sd(self) -> FloatArray:
        """(T,) standard deviations of the states; zero in frame 0, where the state is zero."""
        if self.joint is None:
            return np.zeros(self.q.size)
        return np.concatenate([[0.0], np.sqrt(np.diag(self.cov)[-(self.q.size - 1) :])])

    def tempered(self, as_one: float) -> KindFit:
        """With one in `as_one` observations of the tracks counted, and the true covariance.

        The solution stays. Systematic errors widen the covariance alone: errors of that size bend
        what is seen a little, but do not make a door of a drawer, as counting fewer observations
        in the evidence would. See `akm_fg.estimation.sources.source`, "Covariances".
        """
        if self.joint is None:
            return replace(self, as_one=as_one)
        k = len(self.widest)
        true, information = self.prior_information.copy(), self.information.copy()
        for each in (true, information):
            each[:k, :k] += self.widest
        for said in self.said.values():
            true += said.variance_ratio(as_one) * said.information
        inverse = inverted(self.joint.kind, information)
        cov = self.disagreement * (inverse @ true @ inverse)
        return replace(self, cov=(cov + cov.T) / 2, as_one=as_one)

    def pointing_forward(self) -> KindFit:
        """The same joint with its axis along growing states."""
        if self.joint is None or self.q.mean() >= 0:
            return self
        kind, free = self.joint.kind, self.q.size - 1
        turned = np.tile(TURN_ABOUT_X, 2)[list(kind.observable)]
        signs = np.concatenate([turned, np.ones(int(kind.has_pitch)), -np.ones(free)])
        there = self.guess.turned()
        both = np.outer(signs, signs)
        return replace(
            self,
            joint=there.joint,
            q=there.q,
            cov=self.cov * both,
            information=self.information * both,
            judged=self.judged * both,
            prior_information=self.prior_information * both,
            widest=self.widest * both[: len(self.widest), : len(self.widest)],
            said={name: each.turned(signs) for name, each in self.said.items()},
        )


def inverted(kind: JointKind, information: FloatArray) -> FloatArray:
    """Covariance of an information matrix over (joint, ...).

    Raises:
        AxisUnobservable: it is singular; names the direction that is open.
    """
    diagonal = np.diag(information)
    known = (diagonal > 0) & np.isfinite(information).all(axis=0)
    if not known.all():  # NumPy's decomposition may not end on such a matrix
        raise _open(kind, int(np.argmin(known)))
    scale = 1 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if not eigenvalues[0] > 1e-12:
        raise _open(kind, int(np.argmax(np.abs(vectors[:, 0]))))
    root = vectors / np.sqrt(eigenvalues) * scale[:, None]
    return np.asarray(root @ root.T)


def _open(kind: JointKind, worst: int) -> AxisUnobservable:
    """Names the coordinate of (joint, ...) that is open."""
    names = [f"{TANGENT[i]} of T_world_joint" for i in kind.observable]
    names += ["the pitch"] if kind.has_pitch else []
    name = names[worst] if worst < len(names) else "a state"
    return AxisUnobservable(f"{kind} joint: the data leave {name} open")
