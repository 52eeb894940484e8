"""Screws: named where the part climbs as it turns, and only there."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.records import PointTracks

SIGMA_M = 0.003


@dataclass(frozen=True)
class Screw:
    """A panel that climbs along its hinge as it turns about it."""

    T_world_joint: np.ndarray  # (4, 4)
    q: np.ndarray  # (T,)
    pitch: float  # metres per radian
    tracks: PointTracks


def screw(seed: int, pitch: float, travel: float = 0.7, noise_m: float = SIGMA_M) -> Screw:
    """Forty points on a panel of 0.4 m beside its axis, twenty frames, by GTSAM's own group."""
    rng = np.random.default_rng(seed)
    joint = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3), rng.normal(size=3) / 2]))
    x = rng.uniform([0.0, -0.01, -0.2], [0.4, 0.01, 0.2], (40, 3))
    q = np.r_[0.0, rng.uniform(0.0, travel, 19)]
    S = np.array([0, 0, 1, 0, 0, pitch], dtype=float)
    moved = [joint * gtsam.Pose3.Expmap(state * S) for state in q]
    p = np.array([[T.transformFrom(point) for point in x] for T in moved])
    p += noise_m * rng.normal(size=p.shape)
    cov = np.tile(SIGMA_M**2 * np.eye(3), (20, 40, 1, 1))
    return Screw(joint.matrix(), q, pitch, PointTracks(p, cov))


def _problem(tracks):
    return problem_of_tracks("test", tracks, True, 0, FitConfig())


@pytest.mark.parametrize("pitch", [0.02, 0.05, -0.05, 0.1])
def test_a_screw_is_named_and_its_pitch_lies_within_three_deviations(pitch):
    for seed in range(2):
        truth = screw(seed, pitch)
        posterior = fit_tracks(truth.tracks)
        assert posterior.kind == "helical"
        assert posterior.fit.parametric
        joint = posterior.best.joint
        # Handedness does not turn around with the axis.
        assert abs(joint.pitch_m_per_rad - pitch) < 3 * joint.pitch_sd_m_per_rad
        assert joint.pitch_sd_m_per_rad < 0.1 * abs(pitch)
        assert np.degrees(np.arccos(joint.axis @ truth.T_world_joint[:3, 2])) < 0.6
        assert (
            np.abs((posterior.best.states.mean - truth.q)[1:] / posterior.best.states.sd[1:]).max()
            < 4
        )


def test_noise_free_screw_gives_its_pitch_back():
    truth = screw(0, 0.04, noise_m=0.0)
    joint = fit_tracks(truth.tracks).alternatives["helical"].joint
    assert_allclose(joint.pitch_m_per_rad, 0.04, atol=1e-5)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_doors_and_drawers_are_no_screws(kind, opening):
    for seed in range(4):
        posterior = fit_tracks(opening(seed, kind).tracks)
        assert posterior.kind == kind
        assert posterior.kind_probability["helical"] < 0.05


def test_json_gives_the_pitch_of_a_screw_and_of_nothing_else():
    fields = posterior_as_dict(fit_tracks(screw(1, 0.05).tracks))
    assert fields["joint"]["kind"] == "helical"
    assert_allclose(fields["joint"]["pitch_m_per_rad"], 0.05, atol=0.01)
    assert fields["joint"]["pitch_sd_m_per_rad"] > 0
    hinge = fields["alternatives"]["revolute"]["joint"]
    assert hinge["pitch_m_per_rad"] is None and hinge["pitch_sd_m_per_rad"] is None


def test_starts_tell_a_screw_from_the_hinge_it_contains(opening):
    for tracks, worth in ((screw(0, 0.05).tracks, True), (opening(0, "revolute").tracks, False)):
        problem = _problem(tracks)
        starts = {s.guess.kind: s for s in starts_of_part(problem, problem.motions)}
        assert set(starts) == {"prismatic", "revolute", "helical"}
        assert starts["helical"].worth_it is worth
        assert starts["revolute"].worth_it and starts["prismatic"].worth_it
        assert starts["prismatic"].nats_behind > 50  # half a radian is no straight line
        # The hinge is a screw of pitch zero: never better.
        assert starts["helical"].nats_behind <= starts["revolute"].nats_behind + 0.1


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "helical"])
def test_without_effort_a_fit_stays_at_its_start_and_finds_its_noise_alone(kind, opening):
    problem = _problem(opening(0, "revolute").tracks)
    start = next(s.guess for s in starts_of_part(problem, problem.motions) if s.guess.kind == kind)
    still = fit_kind(start, problem, effort="none")
    full = fit_kind(start, problem, effort="full")
    if start.q.mean() < 0:  # states are counted as they grow
        start = start.turned()
    assert_allclose(still.joint.T_world_joint, start.joint.T_world_joint, atol=1e-12)
    assert_allclose(still.q, start.q, atol=1e-12)
    assert still.joint.pitch == start.joint.pitch
    assert_allclose(still.tracks.scale, full.tracks.scale, rtol=0.15)
    assert still.log_evidence < full.log_evidence + 0.5
    if kind != "prismatic":  # a kind that fits starts at its end
        assert_allclose(still.log_evidence, full.log_evidence, atol=1.0)


def test_a_full_fit_moves_to_the_optimum_from_where_no_effort_stays():
    problem = _problem(screw(3, 0.05).tracks)
    start = next(
        s.guess for s in starts_of_part(problem, problem.motions) if s.guess.kind == "helical"
    )
    pitch = start.joint.pitch
    off = replace(start, joint=replace(start.joint, pitch=pitch + 0.01))
    still, full = (fit_kind(off, problem, effort=effort) for effort in ("none", "full"))
    assert still.joint.pitch == off.joint.pitch
    assert_allclose(full.joint.pitch, pitch, atol=full.pitch_sd / 3)
    assert full.log_evidence > still.log_evidence + 10


@pytest.mark.slow
def test_over_two_hundred_screws_the_pitch_is_as_far_off_as_it_says():
    nees, named = [], []
    for seed in range(200):
        pitch = np.random.default_rng([seed, 1]).uniform(0.02, 0.1)
        posterior = fit_tracks(screw(seed, pitch).tracks)
        joint = posterior.alternatives["helical"].joint
        nees.append(((joint.pitch_m_per_rad - pitch) / joint.pitch_sd_m_per_rad) ** 2)
        named.append(posterior.kind == "helical")
    low, high = stats.chi2.interval(0.99, 200)
    assert low <= sum(nees) <= high
    assert np.mean(named) > 0.98
