"""A joint fitted to free rigid motions: its fixed point, its reach, and the graph it starts."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig, PriorConfig
from akm_fg.estimation.given.motion_fit import bent_drawer, evaluate, fit_to_motions, log_se3
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.geometry.joint_guess import JointGuess, joint_frame
from factors.joint import Joint
from factors.measurements.track_cost import TrackObservations
from factors.motion_information import motion_information

SIGMA_M = 0.003
Q = np.array([0.0, 0.1, 0.35, 0.2, 0.5, 0.6])
PIVOT = np.array([0.4, -0.2, 0.7])


@pytest.fixture(params=["prismatic", "revolute", "helical"])
def moving_kind(request):
    return request.param


def _exact(kind, q=Q, pitch=0.06, rho=0.3):
    """A joint, its motions as the free ones, with exact tracks of 30 points; priors at the truth.

    The hinge lies rho metres from the points' middle.
    """
    rng = np.random.default_rng(0)
    axis = np.array([0.48, 0.6, 0.64])
    side = np.cross(axis, [1.0, 0, 0]) / np.linalg.norm(np.cross(axis, [1.0, 0, 0]))
    points = rng.uniform(-0.2, 0.2, (30, 3))
    points += PIVOT + rho * side - points.mean(axis=0)
    joint = Joint(kind, joint_frame(axis, PIVOT), pitch if kind == "helical" else 0.0)
    truth = JointGuess(joint, q)
    R, t = truth.motion()
    p = points @ R.transpose(0, 2, 1) + t[:, None]
    tracks = TrackObservations.from_points(p, np.tile(SIGMA_M**2 * np.eye(3), (*p.shape[:2], 1, 1)))
    prior = replace(PriorConfig(), hinge_distance_m=rho, pitch_sigma_m_per_rad=1e3)
    return truth, motion_information(R, t, tracks, 6.0, 1.0), points.mean(axis=0), prior


def _off(guess, size, seed=1):
    rng = np.random.default_rng(seed)
    T = gtsam.Pose3(guess.joint.T_world_joint).compose(gtsam.Pose3.Expmap(rng.normal(0, size, 6)))
    q = guess.q + np.r_[0, rng.normal(0, size, guess.q.size - 1)]
    pitch = guess.joint.pitch + (size / 3 if guess.kind == "helical" else 0.0)
    return JointGuess(Joint(guess.kind, T.matrix(), pitch), q)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.99e-4, 1.01e-4, 0.01, 0.7, 2.0, 3.0])
def test_logarithm_of_motions_is_gtsams(angle):
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(5, 3))
    w = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    xi = np.concatenate([w, rng.normal(size=(5, 3))], axis=1)
    poses = [gtsam.Pose3.Expmap(x) for x in xi]
    want = np.array([gtsam.Pose3.Logmap(pose) for pose in poses])
    M = np.array([pose.matrix() for pose in poses])
    assert_allclose(log_se3(M[:, :3, :3], M[:, :3, 3]), want, atol=1e-8)
    assert_allclose(want, xi, atol=1e-8)


def test_the_true_joint_costs_nothing_and_stays_where_it_is(moving_kind):
    truth, motions, centroid, prior = _exact(moving_kind)
    fit = fit_to_motions(truth, motions, centroid, prior)
    assert_allclose(fit.twice_cost, 0.0, atol=1e-6)
    assert_allclose(fit.corrections, 0.0, atol=1e-9)
    assert_allclose(fit.guess.q, truth.q, atol=1e-8)
    assert_allclose(fit.guess.joint.pitch, truth.joint.pitch, atol=1e-8)
    assert_allclose(
        fit.guess.joint.T_world_joint[:3, 2], truth.joint.T_world_joint[:3, 2], atol=1e-8
    )


def test_a_start_far_off_comes_back_to_the_truth(moving_kind):
    truth, motions, centroid, prior = _exact(moving_kind)
    start = _off(truth, 0.15)
    assert evaluate(start, motions, centroid, prior).twice_cost > 1e4
    fit = fit_to_motions(start, motions, centroid, prior)
    assert fit.twice_cost < 0.1  # less than a twentieth of a nat left
    R, t = fit.guess.motion()
    R0, t0 = truth.motion()
    assert_allclose(R @ centroid + t, R0 @ centroid + t0, atol=SIGMA_M / 10)
    assert fit.guess.q[0] == 0.0


def test_cost_is_the_quadratic_form_at_the_corrections_plus_the_priors(moving_kind):
    """By hand: hinge at e^0.6 times its median and pitch at two sigmas cost 1 and 4."""
    truth, motions, centroid, prior = _exact(moving_kind)
    off = _off(truth, 0.01)
    plain = evaluate(off, motions, centroid, replace(prior, hinge_distance_sigma_log=1e6))
    d = plain.corrections
    assert_allclose(plain.twice_cost, d @ (2 * motions.gradient + motions.information @ d))
    prior = replace(prior, hinge_distance_m=0.3 * np.exp(-0.6), pitch_sigma_m_per_rad=0.03)
    want = {"prismatic": 0.0, "revolute": 1.0, "helical": 5.0}[moving_kind]
    assert_allclose(evaluate(truth, motions, centroid, prior).twice_cost, want, atol=1e-6)


def test_the_origin_comes_to_the_point_of_the_axis_nearest_to_the_part(moving_kind):
    truth, motions, centroid, prior = _exact(moving_kind)
    T = truth.joint.T_world_joint.copy()
    T[:3, 3] += 5.0 * T[:3, 2]
    fit = evaluate(
        replace(truth, joint=replace(truth.joint, T_world_joint=T)), motions, centroid, prior
    )
    assert_allclose(fit.twice_cost, 0.0, atol=1e-6)
    offset = fit.guess.joint.T_world_joint[:3, 3] - centroid
    if moving_kind == "prismatic":
        assert_allclose(offset, 0.0, atol=1e-12)
    else:
        assert_allclose(offset @ T[:3, 2], 0.0, atol=1e-12)
        assert_allclose(np.linalg.norm(offset), 0.3)
        assert_allclose(fit.rho, 0.3)


def test_the_end_is_stationary_in_every_direction(moving_kind, opening):
    """Noisy data; a step of a tenth of a deviation either way gains nothing."""
    problem = _problem(opening(2, "prismatic" if moving_kind == "prismatic" else "revolute"))
    guess = next(
        s.guess for s in starts_of_part(problem, problem.motions) if s.guess.kind == moving_kind
    )
    prior, centroid = problem.config.prior, problem.centroid_world
    least = evaluate(guess, problem.motions, centroid, prior).twice_cost
    for k in range(6 + guess.q.size - 1 + (moving_kind == "helical")):
        for sign in (1e-4, -1e-4):
            T, q, pitch = gtsam.Pose3(guess.joint.T_world_joint), guess.q.copy(), guess.joint.pitch
            if k < 6:
                T = T.compose(gtsam.Pose3.Expmap(sign * np.eye(6)[k]))
            elif k < 5 + q.size:
                q[k - 5] += sign
            else:
                pitch += sign
            near = JointGuess(Joint(moving_kind, T.matrix(), pitch), q)
            assert evaluate(near, problem.motions, centroid, prior).twice_cost > least - 0.05, k


def _problem(truth):
    return problem_of_tracks("test", truth.tracks, True, 0, FitConfig())


def test_the_graph_finds_the_same_optimum(kind, opening):
    """The joint fitted to the motions is the graph's, to a third of its own deviations."""
    for seed in range(3):
        problem = _problem(opening(seed, kind))
        start = next(
            s.guess for s in starts_of_part(problem, problem.motions) if s.guess.kind == kind
        )
        start = start if start.q.mean() >= 0 else start.turned()  # states grow
        fit = fit_kind(start, problem)
        xi = gtsam.Pose3.Logmap(
            gtsam.Pose3(fit.joint.T_world_joint).between(gtsam.Pose3(start.joint.T_world_joint))
        )
        k = list(fit.joint.kind.observable)
        sd = np.sqrt(np.diag(fit.joint_cov)[k])
        assert np.abs(xi[k] / sd).max() < 0.33
        assert np.abs((start.q - fit.q)[1:] / fit.state_sd[1:]).max() < 0.33


def test_hinges_near_and_far_fitted_to_a_drawer_end_at_the_same_cost(opening):
    problem = _problem(opening(0, "prismatic"))
    prior, centroid = problem.config.prior, problem.centroid_world
    drawer = fit_to_motions(
        next(g for g in problem.guesses if g.kind == "prismatic"), problem.motions, centroid, prior
    )
    bent = bent_drawer(drawer, problem.motions, centroid)
    ends = [fit_to_motions(bent, problem.motions, centroid, prior)]
    T = ends[0].guess.joint.T_world_joint
    away = (T[:3, 3] - centroid) / ends[0].rho
    for rho in (1.0, 3.0, 30.0):
        start = JointGuess(
            Joint("revolute", joint_frame(T[:3, 2], centroid + rho * away), 0.0), bent.q
        )
        start = replace(start, q=ends[0].rho / rho * ends[0].guess.q)
        ends.append(fit_to_motions(start, problem.motions, centroid, prior))
    assert all(1.0 < end.rho < 30.0 for end in ends)  # far off, held by the prior alone
    costs = [end.twice_cost for end in ends]
    assert_allclose(costs, costs[0], atol=0.2)
    assert_allclose([end.rho for end in ends], ends[0].rho, rtol=0.1)


@pytest.mark.parametrize("rho", [0.3, 1.0, 4.0])
def test_a_bent_drawer_is_the_hinge_of_a_small_arc(rho):
    """A twentieth of a radian: the arc's curvature says how far off and on which side."""
    q = np.linspace(0, 0.05, 6)
    truth, motions, centroid, prior = _exact("revolute", q, rho=rho)
    drawer = fit_to_motions(
        JointGuess(
            Joint("prismatic", joint_frame(_tangent(truth, centroid), centroid), 0.0), rho * q
        ),
        motions,
        centroid,
        prior,
    )
    hinge = bent_drawer(drawer, motions, centroid)
    fit = evaluate(hinge, motions, centroid, prior)
    assert_allclose(fit.rho, rho, rtol=0.05)
    side, axis = (
        fit.guess.joint.T_world_joint[:3, 3] - centroid,
        fit.guess.joint.T_world_joint[:3, 2],
    )
    assert side @ (PIVOT - centroid) > 0.99 * rho**2
    assert axis @ truth.joint.T_world_joint[:3, 2] * np.sign(fit.guess.q[-1]) > 0.999


def _tangent(truth, centroid):
    T = truth.joint.T_world_joint
    return np.cross(T[:3, 2], centroid - T[:3, 3])
