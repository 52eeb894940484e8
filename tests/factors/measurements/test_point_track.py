"""Point-track factor: its normal equations against a dense solve with explicit latent points."""

import gc
import weakref

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.joint import Joint
from factors.measurements.point_track import point_track_factor
from factors.measurements.track_cost import TrackObservations, track_cost
from factors.measurements.track_information import (
    state_information,
    state_step,
    track_normal_equations,
)
from factors.priors.gauge import gauge_factor
from factors.student_t import twice_negative_log_kernel, weight

GAUSSIAN, ROBUST = 1e9, 4.0
GAUGE = {"revolute": [2, 5], "helical": [2, 5], "prismatic": [2, 3, 4, 5]}
JOINT, PITCH = gtsam.symbol("j", 0), gtsam.symbol("h", 0)


def _state_keys(T):
    return [None, *(gtsam.symbol("q", t) for t in range(1, T))]


def _values(s, T_world_joint, q):
    values = gtsam.Values()
    if s.kind == "helical":
        values.insert(PITCH, s.pitch)
    values.insert(JOINT, gtsam.Pose3(T_world_joint))
    for key, state in zip(_state_keys(len(q))[1:], q[1:], strict=True):
        values.insert(key, float(state))
    return values


def _factor(s, dof, scale=1.0, tracks=None):
    return point_track_factor(
        s.kind,
        JOINT,
        _state_keys(s.q.size),
        s.tracks if tracks is None else tracks,
        dof,
        scale,
        pitch_key=PITCH if s.kind == "helical" else None,
    )


def _off(s, seed=1, size=5e-3):
    """A joint and states near but not at the truth."""
    rng = np.random.default_rng(seed)
    T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(rng.normal(0, size, 6)))
    return T.matrix(), s.q + np.r_[0, rng.normal(0, size, s.q.size - 1)]


def _latent_information(s, d2, dof, scale):
    """Weighted inverse covariances (T, N, 3, 3) in world, zero where not observed."""
    seen = np.isfinite(s.p_world).all(-1)
    cov = np.where(seen[..., None, None], s.cov_world, np.eye(3))
    return (weight(d2, dof, 3) * seen)[..., None, None] * np.linalg.inv(cov) / scale**2


def _dense(s, T_world_joint, q, cost, dof, place, scale=1.0):
    """Information and gradient over (xi, q) by stacking residuals over joint, states and points.

    Nothing is shared with the factor: motion by GTSAM's group, derivatives by differences, the
    latent points eliminated from the full matrix. Of a helical joint the pitch comes last.
    """
    T, N, _ = s.p_world.shape
    first = 6 + T + (s.kind == "helical")  # of the latent points
    roots = np.linalg.cholesky(_latent_information(s, cost.d2, dof, scale) + 1e-30 * np.eye(3))
    p = np.nan_to_num(s.p_world)

    def residual(delta):
        x = (cost.x_joint.T.ravel() + delta[first:]).reshape(N, 3)
        pose = gtsam.Pose3(T_world_joint).compose(gtsam.Pose3.Expmap(delta[:6])).matrix()
        pitch = s.pitch + (delta[6 + T] if s.kind == "helical" else 0.0)
        e = np.array([p[t] - place(s.kind, pose, q[t] + delta[6 + t], x, pitch) for t in range(T)])
        return np.einsum("tnij,tni->tnj", roots, e).ravel()

    zero = np.zeros(first + 3 * N)
    J, r = central_difference(residual, zero), residual(zero)
    H, g = J.T @ J, J.T @ r
    a, b = slice(0, first), slice(first, None)
    return H[a, a] - H[a, b] @ np.linalg.solve(H[b, b], H[b, a]), g[a] - H[a, b] @ np.linalg.solve(
        H[b, b], g[b]
    )


def _scaled(H):
    """Units of radians and metres brought together, so that one tolerance serves all entries."""
    return np.sqrt(np.maximum(np.diag(H), 1e-3 * np.diag(H).max()))


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
def test_normal_equations_are_the_schur_complement_of_the_dense_system(
    kind, case, dof, scene, world_points
):
    s = scene(kind, case)
    T_world_joint, q = _off(s)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, dof, 1.0)
    H, g = track_normal_equations(s.joint, q, cost)
    H_dense, g_dense = _dense(s, T_world_joint, q, cost, dof, world_points)
    d = _scaled(H_dense)
    assert_allclose(H / np.outer(d, d), H_dense / np.outer(d, d), atol=1e-7)
    assert_allclose(g / d, g_dense / d, atol=1e-6)


def test_normal_equations_with_gaps_are_those_of_what_was_seen(kind, scene, world_points):
    s = scene(kind, points=8)
    s.p_world[0, :3] = np.nan  # late starts
    s.p_world[2:, 4] = np.nan  # an early end
    s.cov_world[1, 6], s.p_world[1, 6] = np.nan, np.nan  # a gap without a covariance
    T_world_joint, q = _off(s)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, GAUSSIAN, 1.0)
    H, g = track_normal_equations(s.joint, q, cost)
    H_dense, g_dense = _dense(s, T_world_joint, q, cost, GAUSSIAN, world_points)
    d = _scaled(H_dense)
    assert_allclose(H / np.outer(d, d), H_dense / np.outer(d, d), atol=1e-7)
    assert_allclose(g / d, g_dense / d, atol=1e-6)


@pytest.mark.parametrize(("dof", "tolerance"), [(GAUSSIAN, 1e-5), (ROBUST, 2e-2)])
def test_gradient_is_that_of_the_cost(kind, case, dof, tolerance, scene):
    """The robust latent points stop 1e-3 of a squared deviation short: hence its tolerance."""
    s = scene(kind, case, isotropic=dof == ROBUST)
    T_world_joint, q = _off(s, size=1.5e-3)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, dof, 1.0)
    H, g = track_normal_equations(s.joint, q, cost)

    def half_cost(delta):
        pose = gtsam.Pose3(T_world_joint).compose(gtsam.Pose3.Expmap(delta[:6])).matrix()
        pitch = s.pitch + (delta[-1] if kind == "helical" else 0.0)
        states = q + delta[6 : 6 + q.size]
        return track_cost(Joint(kind, pose, pitch), states, s.tracks, dof, 1.0).twice_cost / 2

    numeric = central_difference(lambda d: np.array([half_cost(d)]), np.zeros(g.size), 3e-5)[0]
    d = _scaled(H)
    assert np.abs(numeric / d).max() > 0.5  # there is something to compare
    assert_allclose(g / d, numeric / d, atol=tolerance * np.abs(numeric / d).max())


def test_gradient_of_the_factor_in_gtsam_is_that_of_its_error(kind, case, scene):
    s = scene(kind, case)
    T_world_joint, q = _off(s)
    factor = _factor(s, GAUSSIAN)
    values = _values(s, T_world_joint, q)
    numeric = numeric_gradient(factor, values, [6] + [1] * (len(list(factor.keys())) - 1), 3e-5)
    assert_allclose(analytic_gradient(factor, values), numeric, atol=1e-5 * np.abs(numeric).max())


def test_factor_keeps_information_gradient_and_cost_of_the_free_variables(kind, scene):
    s = scene(kind)
    T_world_joint, q = _off(s)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, ROBUST, 1.3)
    H, g = track_normal_equations(s.joint, q, cost)
    factor = _factor(s, ROBUST, 1.3)
    values = _values(s, T_world_joint, q)
    A, b = factor.linearize(values).jacobian()
    free = [*range(6), *range(7, H.shape[0])]
    assert_allclose(A.T @ A, H[np.ix_(free, free)], atol=1e-9 * H.max())
    assert_allclose(-A.T @ b, g[free], atol=1e-9 * np.abs(g).max())
    assert_allclose(b @ b / 2, cost.twice_cost / 2)
    assert_allclose(factor.error(values), cost.twice_cost / 2)


def test_factor_gives_the_same_error_after_moving_away_and_back(kind, scene):
    s = scene(kind, isotropic=True)
    factor = _factor(s, ROBUST)
    near, far = _values(s, s.T_world_joint, s.q), _values(s, *_off(s))
    first, other = factor.error(near), factor.error(far)
    assert abs(first - other) > 1
    assert_allclose(factor.error(near), first, atol=1e-2)


def test_gauge_directions_carry_no_information(kind, case, scene):
    s = scene(kind, case)
    T_world_joint, q = _off(s)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, ROBUST, 1.0)
    H, g = track_normal_equations(s.joint, q, cost)
    rounding = 1e-12 * H.max()
    assert_allclose(H[GAUGE[kind]], 0.0, atol=rounding)
    assert_allclose(g[GAUGE[kind]], 0.0, atol=rounding)


def test_every_other_direction_carries_information(kind, scene):
    s = scene(kind)
    cost = track_cost(s.joint, s.q, s.tracks, ROBUST, 1.0)
    H, _ = track_normal_equations(s.joint, s.q, cost)
    kept = [i for i in range(H.shape[0]) if i not in GAUGE[kind] and i != 6]
    d = _scaled(H)[kept]
    assert np.linalg.eigvalsh(H[np.ix_(kept, kept)] / np.outer(d, d))[0] > 1e-6


def test_error_and_gradient_vanish_at_the_truth(kind, case, scene):
    s = scene(kind, case, sigma=0)
    cost = track_cost(s.joint, s.q, s.tracks, ROBUST, 1.0)
    assert_allclose(cost.twice_cost, 0.0, atol=1e-18)
    assert_allclose(cost.x_joint, s.x_joint.T, atol=1e-12)
    _, g = track_normal_equations(s.joint, s.q, cost)
    assert_allclose(g, 0.0, atol=1e-6)


def test_point_seen_twice_four_sigmas_apart_costs_four():
    """By hand: the latent point lies midway, two sigmas from each; half of 2 * 2^2 is 4."""
    p = np.array([[[0.0, 0.0, 0.0]], [[0.04, 0.0, 0.0]]])
    tracks = TrackObservations.from_points(p, np.tile(1e-4 * np.eye(3), (2, 1, 1, 1)))
    cost = track_cost(Joint("prismatic", np.eye(4), 0.0), np.zeros(2), tracks, GAUSSIAN, 1.0)
    assert_allclose(cost.x_joint[:, 0], [0.02, 0, 0])
    assert_allclose(cost.d2[:, 0], [4.0, 4.0], rtol=1e-9)
    assert_allclose(cost.twice_cost / 2, 4.0, rtol=1e-7)


def test_latent_point_lies_nearer_to_the_more_certain_observation():
    """By hand: variances 1 and 3 weigh 3/4 and 1/4."""
    p = np.array([[[0.0, 0.0, 0.0]], [[0.04, 0.0, 0.0]]])
    cov = np.array([1.0, 3.0])[:, None, None, None] * 1e-4 * np.eye(3)
    tracks = TrackObservations.from_points(p, cov)
    cost = track_cost(Joint("prismatic", np.eye(4), 0.0), np.zeros(2), tracks, GAUSSIAN, 1.0)
    assert_allclose(cost.x_joint[:, 0], [0.01, 0, 0])


def test_doubled_scale_quarters_squared_errors_and_information(kind, scene):
    s = scene(kind)
    T_world_joint, q = _off(s)
    costs = [
        track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, GAUSSIAN, k)
        for k in (1.0, 2.0)
    ]
    assert_allclose(costs[1].d2, costs[0].d2 / 4, rtol=1e-6)
    H1, H2 = (track_normal_equations(s.joint, q, cost)[0] for cost in costs)
    assert_allclose(H2, H1 / 4, atol=1e-6 * H1.max())


def test_log_determinants_are_those_of_the_covariances(scene):
    s = scene(sigma=0, isotropic=True)
    s.p_world[1, 2] = np.nan
    cost = track_cost(Joint("revolute", s.T_world_joint, s.pitch), s.q, s.tracks, GAUSSIAN, 2.0)
    seen = np.isfinite(s.p_world[..., 0]).sum(axis=0)
    assert_allclose(s.tracks.log_det_cov, seen.sum() * 3 * np.log(0.003**2))
    assert_allclose(cost.log_det_latent, 3 * np.log(seen / 0.006**2).sum(), rtol=1e-8)


def test_covariance_of_a_drawer_is_the_one_worked_on_paper(scene):
    """N points, T frames, noise sigma: var q_t = 2 sigma^2/N, cov(q_s, q_t) = sigma^2/N and
    var w = sigma^2 / (N sum (q_t - mean q)^2): a straight line fitted to the mean points.
    """
    q, N, sigma = np.array([0.0, 0.05, 0.1, 0.25, 0.3]), 12, 0.003
    s = scene("prismatic", sigma=0, isotropic=True, points=N, q=q)
    cost = track_cost(Joint("prismatic", s.T_world_joint, 0.0), q, s.tracks, GAUSSIAN, 1.0)
    H, _ = track_normal_equations(Joint("prismatic", np.eye(4), 0.0), q, cost)
    kept = [0, 1, *range(7, 11)]
    cov = np.linalg.inv(H[np.ix_(kept, kept)])
    want = np.zeros((6, 6))
    want[:2, :2] = np.eye(2) * sigma**2 / (N * ((q - q.mean()) ** 2).sum())
    want[2:, 2:] = (np.eye(4) + np.ones((4, 4))) * sigma**2 / N
    assert_allclose(cov, want, atol=1e-6 * sigma**2, rtol=1e-6)


def test_state_information_is_that_with_joint_and_points_held(kind, case, scene, world_points):
    s = scene(kind, case)
    T_world_joint, q = _off(s)
    cost = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, ROBUST, 1.0)
    information = _latent_information(s, cost.d2, ROBUST, 1.0)
    x, h = cost.x_joint.T, 1e-6
    for t, state in enumerate(q):
        ends = [world_points(kind, T_world_joint, state + d, x) for d in (h, -h)]
        step = (ends[0] - ends[1]) / (2 * h)
        want = np.einsum("ni,nij,nj->", step, information[t], step)
        assert_allclose(state_information(s.joint, cost)[t], want, rtol=1e-6)


def test_states_alone_step_back_to_the_truth_from_exact_points(kind, case, scene):
    s = scene(kind, case, sigma=0)
    q = s.q + np.array([0.1, -0.05, 0.02, 0.08])
    for _ in range(30):
        step, _ = state_step(s.joint, q, s.x_joint.T, s.tracks, ROBUST, 1.0)
        q = q + step
    assert_allclose(q, s.q, atol=1e-9)


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
def test_state_step_is_gradient_over_information(kind, dof, scene, world_points):
    s = scene(kind)
    s.p_world[2, 1] = np.nan
    x, q = s.x_joint, s.q + 1e-3
    step, information = state_step(s.joint, q, x.T, s.tracks, dof, 1.3)
    seen = np.isfinite(s.p_world).all(-1)
    inverse = np.linalg.inv(s.cov_world) / 1.3**2

    def half_cost(q):
        placed = np.array([world_points(kind, s.T_world_joint, state, x) for state in q])
        e = np.where(seen[..., None], s.p_world - placed, 0.0)
        d2 = np.einsum("tni,tnij,tnj->tn", e, inverse, e)
        return twice_negative_log_kernel(d2, dof, 3).sum(axis=1) / 2

    numeric = np.diag(central_difference(half_cost, q, 1e-5))
    assert_allclose(step * information, -numeric, rtol=1e-5, atol=1e-3)
    assert (information > 0).all()


def test_a_point_that_is_lost_does_not_count(kind, scene):
    s, without = scene(kind, points=7), scene(kind, points=7)
    s.p_world[1:, 3] = np.nan  # seen once: its own latent point takes all of it up
    keep = [0, 1, 2, 4, 5, 6]
    tracks = TrackObservations.from_points(without.p_world[:, keep], without.cov_world[:, keep])
    costs = [track_cost(s.joint, s.q, t, ROBUST, 1.0) for t in (s.tracks, tracks)]
    assert_allclose(costs[0].twice_cost, costs[1].twice_cost, atol=1e-9)
    assert_allclose(costs[0].d2[1:, 3], 0.0)
    (H0, g0), (H1, g1) = (track_normal_equations(s.joint, s.q, cost) for cost in costs)
    assert_allclose(H0, H1, atol=1e-9 * H1.max())
    assert_allclose(g0, g1, atol=1e-9 * np.abs(g1).max())


def test_what_stands_beside_a_lost_point_is_never_read(kind, scene):
    s = scene(kind)
    s.p_world[2, 1] = [np.nan, 1e3, -1e3]
    before = track_cost(s.joint, s.q, s.tracks, ROBUST, 1.0)
    s.p_world[2, 1], s.cov_world[2, 1] = np.nan, 7.0
    after = track_cost(s.joint, s.q, s.tracks, ROBUST, 1.0)
    assert before.twice_cost == after.twice_cost


def test_the_order_of_the_tracks_does_not_matter(kind, scene):
    s = scene(kind, points=9)
    order = np.random.default_rng(0).permutation(9)
    shuffled = TrackObservations.from_points(s.p_world[:, order], s.cov_world[:, order])
    costs = [track_cost(s.joint, s.q, t, ROBUST, 1.0) for t in (s.tracks, shuffled)]
    assert_allclose(costs[1].twice_cost, costs[0].twice_cost)
    assert_allclose(costs[1].d2, costs[0].d2[:, order], atol=1e-9)
    (H0, g0), (H1, g1) = (track_normal_equations(s.joint, s.q, cost) for cost in costs)
    assert_allclose(H1, H0, atol=1e-10 * H0.max())
    assert_allclose(g1, g0, atol=1e-9 * np.abs(g0).max())


def test_a_turned_world_changes_nothing(kind, scene):
    s = scene(kind)
    T_world_joint, q = _off(s)
    W = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([1.0, -2.0, 0.5])), np.array([3.0, -1.0, 2.0]))
    R = W.rotation().matrix()
    turned = TrackObservations.from_points(s.p_world @ R.T + W.translation(), R @ s.cov_world @ R.T)
    here = track_cost(Joint(kind, T_world_joint, s.pitch), q, s.tracks, ROBUST, 1.0)
    there = track_cost(Joint(kind, W.matrix() @ T_world_joint, s.pitch), q, turned, ROBUST, 1.0)
    assert_allclose(there.twice_cost, here.twice_cost, rtol=1e-9)
    H0, H1 = (track_normal_equations(s.joint, q, cost)[0] for cost in (here, there))
    assert_allclose(H1, H0, atol=1e-8 * H0.max())


def _solve(s, tracks, dof):
    values = _values(s, s.T_world_joint, s.q)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(_factor(s, dof, tracks=tracks))
    R, centroid = values.atPose3(JOINT).rotation(), s.p_world[0].mean(axis=0)
    graph.push_back(gauge_factor(s.kind, JOINT, R, centroid))
    return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose3(JOINT)


def _axis_angle_between(a, b):
    return np.arccos(np.clip(a.rotation().matrix()[:, 2] @ b.rotation().matrix()[:, 2], -1, 1))


def test_one_wild_track_hardly_moves_the_axis(kind, scene):
    q = np.linspace(0, 0.5, 8)
    s = scene(kind, points=20, isotropic=True, q=q)
    wild = s.p_world.copy()
    wild[:, 0] += 0.05 * np.arange(8)[:, None] * np.array([0.6, 0.0, 0.8])
    tracks = TrackObservations.from_points(wild, s.cov_world)
    robust_shift = _axis_angle_between(_solve(s, s.tracks, ROBUST), _solve(s, tracks, ROBUST))
    gaussian_shift = _axis_angle_between(_solve(s, s.tracks, GAUSSIAN), _solve(s, tracks, GAUSSIAN))
    assert np.degrees(robust_shift) < 0.15
    assert gaussian_shift > 5 * robust_shift


def test_the_kernel_acts_per_observation_not_per_track(scene):
    s = scene(points=10, isotropic=True)
    s.p_world[2, 4] += [0.3, 0.0, 0.0]  # one jump of one point
    cost = track_cost(Joint("revolute", s.T_world_joint, s.pitch), s.q, s.tracks, ROBUST, 1.0)
    w = weight(cost.d2, ROBUST, 3)
    assert w[2, 4] < 1e-3
    others = np.delete(w.ravel(), 2 * 10 + 4)
    assert others.min() > 0.2


def test_fifty_factors_are_freed_with_their_observations(scene):
    alive = []
    for seed in range(50):
        s = scene(seed=seed)
        tracks = s.tracks
        alive.append(weakref.ref(tracks.p_world))
        factor = point_track_factor("revolute", JOINT, _state_keys(4), tracks, ROBUST, 1.0)
        factor.linearize(_values(s, s.T_world_joint, s.q))
        del factor, tracks, s
    gc.collect()
    assert sum(ref() is not None for ref in alive) == 0


def test_unit_twist_moves_a_point_of_the_factor_as_the_joint_does(kind, scene, world_points):
    """One frame: opening the joint and turning its frame by the same twist are the same."""
    s = scene(kind, sigma=0)
    T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(0.2 * s.joint.unit_twist)).matrix()
    assert_allclose(
        world_points(kind, T, 0.1, s.x_joint),
        world_points(kind, s.T_world_joint, 0.3, s.x_joint),
        atol=1e-12,
    )


def test_a_number_of_keys_other_than_that_of_the_frames_is_refused(scene):
    with pytest.raises(ValueError, match="3 state keys, 4 frames"):
        point_track_factor("revolute", JOINT, _state_keys(3), scene().tracks, ROBUST, 1.0)


def test_an_unknown_kind_is_refused(scene):
    with pytest.raises(ValueError, match="joint kind 'screw'"):
        point_track_factor("screw", JOINT, _state_keys(4), scene().tracks, ROBUST, 1.0)


@pytest.mark.parametrize(
    ("points", "cov"),
    [
        ((4, 6), (4, 6, 3, 3)),
        ((4, 6, 2), (4, 6, 2, 3)),
        ((4, 6, 3), (4, 5, 3, 3)),
        ((4, 6, 3), (6, 3)),
    ],
)
def test_shapes_that_do_not_match_are_refused(points, cov):
    with pytest.raises(ValueError, match=r"expected \(T, N, 3\) and \(T, N, 3, 3\)"):
        TrackObservations.from_points(np.zeros(points), np.zeros(cov))


def test_a_covariance_that_is_not_positive_definite_is_refused(scene):
    s = scene()
    s.cov_world[1, 2] = np.diag([1e-5, 0.0, 1e-5])
    with pytest.raises(ValueError, match="not positive definite"):
        _ = s.tracks


def test_an_observed_point_without_a_covariance_is_refused(scene):
    s = scene()
    s.cov_world[1, 2] = np.nan
    with pytest.raises(ValueError, match="covariance of an observed point is not finite"):
        _ = s.tracks


@pytest.mark.parametrize(("kind", "pitch_key"), [("helical", None), ("revolute", PITCH)])
def test_a_pitch_missing_or_out_of_place_is_refused(kind, pitch_key, scene):
    with pytest.raises(ValueError, match=f"a {kind} joint with pitch key"):
        point_track_factor(
            kind, JOINT, _state_keys(4), scene().tracks, ROBUST, 1.0, pitch_key=pitch_key
        )


def test_pitch_of_a_screw_is_fitted_from_exact_points(scene):
    s = scene("helical", sigma=0, q=np.linspace(0, 0.8, 5))
    values = _values(s, s.T_world_joint, s.q)
    values.update(PITCH, s.pitch + 0.02)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(_factor(s, ROBUST))
    R, centroid = values.atPose3(JOINT).rotation(), s.p_world[0].mean(axis=0)
    graph.push_back(gauge_factor(s.kind, JOINT, R, centroid))
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert_allclose(solved.atDouble(PITCH), s.pitch, atol=1e-6)
