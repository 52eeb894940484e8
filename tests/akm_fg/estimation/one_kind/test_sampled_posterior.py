"""Vague joints: their coordinates, the samples' moments, and whether these tell the truth."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.one_kind import sampled_posterior as sampling
from akm_fg.estimation.one_kind.joint_chart import JointChart
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.estimation.one_kind.sampled_posterior import sampled
from experiments.trials.openings import make_opening, score_opening

KINDS = ["prismatic", "revolute", "helical"]


def _fit(truth, kind, config=None):
    problem = problem_of_tracks("x", truth.tracks, True, 0, config or FitConfig())
    starts = {s.guess.kind: s.guess for s in starts_of_part(problem, problem.motions)}
    return fit_kind(starts[kind], problem), problem


def _sampling(problem, **settings):
    config = problem.config
    return replace(problem, config=replace(config, sampling=replace(config.sampling, **settings)))


@pytest.fixture(scope="module")
def solved(opening):
    """A well-seen door fitted as every kind."""
    truth = opening(0, "revolute")
    return {kind: _fit(truth, kind) for kind in KINDS}


@pytest.fixture(scope="module")
def vague():
    """A door of five degrees, noise of a centimetre."""
    truth = make_opening(3, "revolute", np.deg2rad(5), 40, noise_m=0.01, claimed_m=0.01)
    return truth, *_fit(truth, "revolute")


@pytest.mark.parametrize("kind", KINDS)
def test_origin_of_the_coordinates_is_the_solved_joint(kind, solved):
    fit, problem = solved[kind]
    chart = JointChart.at(fit.moving, problem.centroid_world)
    zero = np.zeros((1, chart.size))
    R, t = chart.joints(zero).motions(chart.distance * fit.q[None])
    R_joint, t_joint = fit.joint.motion(fit.q)
    assert_allclose(R[0], R_joint, atol=1e-9)
    assert_allclose(t[0], t_joint, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_unit_twists_are_the_derivative_of_the_motions(kind, solved):
    fit, problem = solved[kind]
    chart = JointChart.at(fit.moving, problem.centroid_world)
    joints = chart.joints(np.full((1, chart.size), 0.2))
    step = 1e-6
    R, t = joints.motions(np.array([[0.03, 0.03 + step]]))
    motion, on = (gtsam.Pose3(gtsam.Rot3(R[0, i]), t[0, i]) for i in (0, 1))
    numeric = gtsam.Pose3.Logmap(motion.inverse() * on) / step
    assert_allclose(joints.unit_twists()[0], numeric, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_frame_and_joints_agree_far_from_the_solved_joint(kind, solved):
    fit, problem = solved[kind]
    chart = JointChart.at(fit.moving, problem.centroid_world)
    u = np.array([0.3, -0.2, 0.4, 0.5, 0.01])[: chart.size]
    T, _ = chart.frame(u)
    joints = chart.joints(u[None])
    assert_allclose(T[:3, 2], joints.axis[0], atol=1e-12)
    assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    if kind != "prismatic":
        assert_allclose(T[:3, 3], joints.point[0], atol=1e-12)
        away = joints.point[0] - problem.centroid_world
        assert_allclose([np.linalg.norm(away), away @ T[:3, 2]], [joints.distance[0], 0], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_tangent_by_coordinates_is_the_derivative_of_the_axis_line(kind, solved):
    """Small steps of the coordinates move frame and line as the matrix says, gauge aside."""
    fit, problem = solved[kind]
    chart = JointChart.at(fit.moving, problem.centroid_world)
    u = np.array([0.2, -0.1, 0.3, 0.4, 0.01])[: chart.size]
    T, J = chart.frame(u)
    directions = [0, 1] if kind == "prismatic" else [0, 1, 3, 4]
    for i in range(len(directions)):
        step = np.zeros(chart.size)
        step[i] = 1e-6
        T_on, _ = chart.frame(u + step)
        axis = T[:3, :3].T @ T_on[:3, 2]
        numeric = np.array([-axis[1], axis[0]]) / 1e-6
        if kind != "prismatic":
            place = T[:3, :3].T @ (T_on[:3, 3] - T[:3, 3]) / 1e-6
            numeric = np.append(numeric, place[:2])
        if i >= 2 or np.allclose(u[:2], 0):
            assert_allclose(J[: len(directions), i], numeric, atol=1e-4)
        else:  # a tilt about another one turns about its own axis to second order
            assert_allclose(J[: len(directions), i], numeric, atol=0.05)


def test_a_joint_that_is_well_known_is_left_as_it_is(solved):
    for fit, problem in solved.values():
        assert sampled(fit, problem) is fit


@pytest.mark.parametrize("kind", ["revolute", "helical"])
def test_moments_of_a_well_known_joint_are_laplaces(kind, solved):
    fit, problem = solved[kind]
    better = sampled(fit, _sampling(problem, vague=0.0))
    assert better is not fit
    for block in ([0, 1], [3, 4]):
        square = np.ix_(block, block)
        areas = np.linalg.det(better.joint_cov[square]), np.linalg.det(fit.joint_cov[square])
        assert_allclose(*areas, rtol=0.3)
    assert_allclose(better.state_sd[1:], fit.state_sd[1:], rtol=0.1)
    assert_allclose(better.q, fit.q, atol=0.5 * fit.state_sd.max())


def test_moments_are_those_of_a_grid():
    """A drawer has two tilts and a spread: the integral can be done by brute force."""
    truth = make_opening(1, "prismatic", 0.05, 10, noise_m=0.01, claimed_m=0.01)
    fit, problem = _fit(truth, "prismatic")
    chart = JointChart.at(fit.moving, problem.centroid_world)
    data = sampling._data(fit, problem, chart)
    cov = chart.covariance(fit)
    samples = sampling._sample(chart, cov, data)
    mean, sd = samples.moments()[0], np.sqrt(np.diag(samples.moments()[1]))
    axes = [np.linspace(m - 5 * s, m + 5 * s, 21) for m, s in zip(mean, sd, strict=True)]
    u = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    log_weight = sampling._states(u, chart.joints(u[:, :-1]), data).log_weight
    weights = np.exp(log_weight - log_weight.max())
    weights /= weights.sum()
    by_grid = weights @ u
    sd_by_grid = np.sqrt(weights @ (u - by_grid) ** 2)
    assert (np.abs(mean - by_grid) < 0.1 * sd_by_grid).all()
    assert_allclose(sd, sd_by_grid, rtol=0.07)


def test_points_stay_where_they_are_when_the_joint_moves(vague):
    _, fit, problem = vague
    better = sampled(fit, problem)
    assert better is not fit
    old = fit.joint.T_world_joint[:3, :3] @ fit.tracks.x_joint + fit.joint.T_world_joint[:3, 3:]
    new = (
        better.joint.T_world_joint[:3, :3] @ better.tracks.x_joint
        + better.joint.T_world_joint[:3, 3:]
    )
    assert_allclose(new, old, atol=1e-12)


def test_a_vague_joint_is_wider_than_laplace_says_and_the_same_every_time(vague):
    truth, fit, problem = vague
    first, second = sampled(fit, problem), sampled(fit, problem)
    assert np.trace(first.joint_cov) > 1.05 * np.trace(fit.joint_cov)
    assert_allclose(first.cov, second.cov, rtol=0, atol=0)
    assert np.linalg.eigvalsh(first.cov)[0] > 0
    posterior = fit_tracks(truth.tracks)
    assert_allclose(
        posterior.alternatives["revolute"].joint.cov, first.joint_cov, rtol=1e-6, atol=1e-12
    )


def test_where_no_samples_match_the_posterior_the_answer_is_wider_not_laplaces():
    """Ten tracks of five degrees in a centimetre of noise: the axis is a radian off Laplace's."""
    truth = make_opening([74, 9], "revolute", np.deg2rad(5), 10, noise_m=0.01, claimed_m=0.01)
    fit, problem = _fit(truth, "revolute")
    better = sampled(fit, problem)
    assert better is not fit
    sd, sd_before = (np.sqrt(np.diag(x.joint_cov)[:2]) for x in (better, fit))
    assert np.linalg.norm(sd) > 2 * np.linalg.norm(sd_before)


def test_covariances_grow_by_their_samples_heavy_tails(vague):
    """More is asked of the ellipsoid farther out: the whole covariance grows by one factor."""
    _, fit, problem = vague
    covs = [sampled(fit, _sampling(problem, region=region)).cov for region in (0.5, 0.999)]
    factor = covs[1][0, 0] / covs[0][0, 0]
    assert factor > 1.1
    assert_allclose(covs[1], factor * covs[0], rtol=1e-12)


@pytest.mark.parametrize("dof", [4, np.inf])
def test_an_ellipsoid_holds_the_share_of_the_samples_that_it_says(dof):
    rng, n, k = np.random.default_rng(0), 20_000, 4
    stretch = np.array([[2.0, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0.1, 0], [0, 3, 0, 1]])
    scale = np.ones(n) if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, n))
    off = rng.normal(size=(n, k)) * scale[:, None] @ stretch
    weights = rng.uniform(0.5, 1.5, n)
    weights /= weights.sum()
    cov = off.T @ (weights[:, None] * off)
    factor = sampling._heavier_tails(off, cov, weights, 0.95)
    squared = np.einsum("si,ij,sj->s", off, np.linalg.inv(factor * cov), off)
    held = weights @ (squared <= stats.chi2.ppf(0.95, k))
    assert factor == pytest.approx(1.0, abs=0.03) if np.isinf(dof) else factor > 1.0
    assert held == pytest.approx(0.95, abs=0.01)
    assert sampling._heavier_tails(0.5 * off, cov, weights, 0.95) == 1.0  # never less


@pytest.mark.slow
@pytest.mark.parametrize(("points", "noise_m"), [(10, 0.01), (40, 0.01), (10, 0.003)])
def test_regions_of_short_noisy_openings_hold_the_truth(points, noise_m):
    """Doors of five degrees; 95 % regions, 100 openings."""
    inside = []
    for seed in range(100):
        truth = make_opening(
            [seed, 9], "revolute", np.deg2rad(5), points, noise_m=noise_m, claimed_m=noise_m
        )
        score = score_opening(fit_tracks(truth.tracks), truth)
        inside.append(score.nees <= stats.chi2.ppf(0.95, score.dimensions))
    assert np.mean(inside) >= 0.88
