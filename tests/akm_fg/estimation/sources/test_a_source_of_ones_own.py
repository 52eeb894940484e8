"""A source that the estimator has never heard of plugs in: no file of it is touched.

A wire from a fixed place to a point of the part, whose length is read in every frame (a string
potentiometer). Everything that the estimator needs of it is in the two classes below.
"""

from dataclasses import dataclass
from typing import ClassVar

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.estimation.sources.source import Contribution, Source, Term, information_of
from akm_fg.records import FloatArray
from factors.adapter import make_factor
from factors.finite_differences import central_difference
from factors.joint import Joint


@dataclass(frozen=True, slots=True)
class Wire(Source):
    """Lengths (T,) from `fixed_world` to the part's point that is at `point_world` in frame 0."""

    length_m: FloatArray
    fixed_world: FloatArray
    point_world: FloatArray
    sigma_m: float
    name: ClassVar[str] = "wire"

    def term(self, guess, part, previous):
        return WireTerm(self, self.length_m[part.keyframes])

    def check(self, frames):
        if self.length_m.size != frames:
            raise ValueError(f"{self.length_m.size} lengths, {frames} frames")


class WireTerm(Term):
    name = "wire"

    def __init__(self, wire, length_m):
        self._wire, self._length_m = wire, length_m

    def _lengths(self, joint, q):
        R, t = joint.motion(q)
        return np.linalg.norm(R @ self._wire.point_world + t - self._wire.fixed_world, axis=1)

    def factors(self, variables, scale):
        length_m, lengths = self._length_m, self._lengths

        def residual(values, want_jacobians):
            joint, q = variables.read(values)
            e = lengths(joint, q) - length_m
            if not want_jacobians:
                return e, None

            def moved(d):
                T = gtsam.Pose3(joint.T_world_joint).retract(d[:6]).matrix()
                pitch = joint.pitch + d[6] if joint.kind.has_pitch else 0.0
                return lengths(Joint(joint.kind, T, pitch), q + d[7])

            J = central_difference(moved, np.zeros(8))
            states = [np.eye(q.size)[:, t : t + 1] * J[:, 7:] for t in variables.free]
            pitch = [] if variables.pitch_key is None else [J[:, 6:7]]
            return e, [J[:, :6], *states, *pitch]

        noise = gtsam.noiseModel.Isotropic.Sigma(self._length_m.size, self._wire.sigma_m)
        return [make_factor(residual, variables.dims, noise)]

    def contribution(self, at, freedom):
        factors = self.factors(at.variables, 1.0)
        information, held, _ = information_of(factors, at, self.own)
        n, sigma = self._length_m.size, self._wire.sigma_m
        return Contribution(
            information=information,
            held=held,
            log_likelihood=-n * np.log(sigma * np.sqrt(2 * np.pi)) - factors[0].error(at.values),
        )


def _wire(truth, seed, sigma_m):
    """The wire of an opening, from beside the panel to its far edge."""
    point = truth.rest_world.mean(axis=0)
    fixed = point + np.array([0.3, -0.2, 0.4])
    R, t = truth.joint.motion(truth.q)
    length = np.linalg.norm(R @ point + t - fixed, axis=1)
    noise = sigma_m * np.random.default_rng([seed, 5]).normal(size=length.size)
    return Wire(length + noise, fixed, point, sigma_m)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_wire_sharpens_states_and_evidence_and_stays_true(kind, opening, score):
    for seed in range(3):
        truth = opening(seed, kind, points=4, noise_m=0.006, claimed_m=0.006)
        without = fit_tracks(truth.tracks)
        given = fit_tracks(truth.tracks, sources=[_wire(truth, seed, 0.0005)])
        assert given.kind == kind
        before, after = (p.alternatives[kind].states.sd[1:] for p in (without, given))
        assert np.median(after / before) < 0.95
        error = score(given, truth).state_error[1:]
        assert np.abs(error / after).max() < 4.5
        gained = given.alternatives[kind].evidence.log_likelihood
        assert gained > without.alternatives[kind].evidence.log_likelihood  # sixty sharp numbers


def test_a_wire_that_says_next_to_nothing_changes_next_to_nothing(opening):
    truth = opening(0, "revolute")
    without = fit_tracks(truth.tracks)
    given = fit_tracks(truth.tracks, sources=[_wire(truth, 0, 100.0)])
    one, other = without.best.joint, given.best.joint
    assert_allclose(other.cov, one.cov, rtol=1e-3, atol=1e-9)
    assert_allclose(other.axis, one.axis, atol=1e-4)


def test_the_correction_of_the_tracks_leaves_the_wires_information_alone(opening):
    """The sandwich by hand: seven observations of the tracks count as one, the wire's are sound."""
    truth = opening(1, "prismatic", points=4, noise_m=0.006, claimed_m=0.006)
    problem = problem_of_tracks("x", truth.tracks, True, 0, FitConfig())
    problem = problem.knowing([_wire(truth, 1, 0.0005)])
    start = next(
        s.guess for s in starts_of_part(problem, problem.motions) if s.guess.kind == "prismatic"
    )
    fit = fit_kind(start, problem)
    tracks, wire = fit.said["tracks"], fit.said["wire"]
    known = fit.prior_information.copy()
    known[:2, :2] += fit.widest  # an axis is somewhere on its half sphere
    H = tracks.information + wire.information + known
    true = 7 * tracks.variance_per_as_one * tracks.information
    true += wire.information + known
    want = np.linalg.inv(H) @ true @ np.linalg.inv(H)
    assert_allclose(fit.tempered(7.0).cov, want, rtol=1e-6, atol=1e-12)
    assert 0.7 < tracks.variance_per_as_one < 1.4


def test_a_wire_of_other_frames_is_refused(opening):
    wire = Wire(np.ones(7), np.zeros(3), np.ones(3), 0.001)
    with pytest.raises(ValueError, match="7 lengths, 20 frames"):
        fit_tracks(opening(0, "prismatic").tracks, sources=[wire])
