"""Dense registration factor: its normal equations against a dense solve with explicit places."""

import gc
import weakref
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.joint import Joint
from factors.measurements.dense_registration import (
    PatchCosts,
    PatchObservations,
    dense_cost,
    dense_information,
    dense_normal_equations,
    dense_registration_factor,
)
from factors.student_t import twice_negative_log_kernel, weight

GAUSSIAN, ROBUST = 1e9, 4.0
GAUGE = {"revolute": [2, 5], "helical": [2, 5], "prismatic": [2, 3, 4, 5]}
JOINT, PITCH = gtsam.symbol("j", 0), gtsam.symbol("h", 0)
SIGMA_M = 1e-3


@dataclass(frozen=True)
class Surface:
    """Patches of a part whose joint and states are those of a scene."""

    kind: str
    T_world_joint: np.ndarray  # (4, 4)
    q: np.ndarray  # (K,)
    pitch: float
    patches: PatchObservations

    def cost(self, T_world_joint, q, dof, scale=1.0, pitch=None):
        pitch = self.pitch if pitch is None else pitch
        R, t = Joint(self.kind, T_world_joint, pitch).motion(q)
        return dense_cost(R, t, self.patches, dof, scale)

    def normal_equations(self, T_world_joint, q, cost):
        return dense_normal_equations(
            Joint(self.kind, T_world_joint, self.pitch), q, cost, self.patches
        )


@pytest.fixture
def surface(scene):
    """Factory: patches seen where they are, plus noise along the normal and a slide across."""

    def build(kind="revolute", case="generic", sigma=1.0, slide_m=0.0, patches=14, gaps=True):
        s, rng = scene(kind, case, points=patches), np.random.default_rng(0)
        n = rng.normal(size=(3, patches))
        n /= np.linalg.norm(n, axis=0)
        x = s.p_world[0].T  # in the reference pose
        across = slide_m * rng.normal(size=(4, 3, patches))
        across -= n * np.einsum("as,kas->ks", n, across)[:, None]
        noise = sigma * SIGMA_M * rng.normal(size=(4, 1, patches)) * n
        R, t = s.joint.motion(s.q)
        p = R @ (x + across + noise) + t[:, :, None]
        precision = rng.uniform(0.5, 2.0, (4, patches)) / SIGMA_M**2
        if gaps:
            precision[1, :2] = precision[2:, 3] = precision[0, 5] = 0
        seen = PatchObservations(np.where(precision[:, None] > 0, p, 0.0), precision, n)
        return Surface(kind, s.T_world_joint, s.q, s.pitch, seen)

    return build


def _off(s, size=2e-3, seed=1):
    rng = np.random.default_rng(seed)
    T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(rng.normal(0, size, 6)))
    return T.matrix(), s.q + np.r_[0, rng.normal(0, size, s.q.size - 1)]


def _scaled(H):
    return np.sqrt(np.maximum(np.diag(H), 1e-3 * np.diag(H).max()))


def _keys(K):
    return [None, *(gtsam.symbol("q", t) for t in range(1, K))]


def _factor(s, dof=ROBUST, scale=1.0, count=1.0):
    pitch_key = PITCH if s.kind == "helical" else None
    return dense_registration_factor(
        s.kind, JOINT, _keys(s.q.size), s.patches, dof, scale, count, pitch_key
    )


def _values(s, T_world_joint, q):
    values = gtsam.Values()
    values.insert(JOINT, gtsam.Pose3(T_world_joint))
    if s.kind == "helical":
        values.insert(PITCH, s.pitch)
    for key, state in zip(_keys(q.size)[1:], q[1:], strict=True):
        values.insert(key, float(state))
    return values


def _dense(s, T_world_joint, q, m, weights):
    """Information and gradient over (xi, q[, pitch]) with the places as explicit variables.

    Nothing is shared with the factor: motions by GTSAM's group, derivatives by differences.
    """
    K, S = q.size, m.size
    helical = s.kind == "helical"
    first = 6 + K + helical

    def residual(delta):
        joint = gtsam.Pose3(T_world_joint).compose(gtsam.Pose3.Expmap(delta[:6]))
        twist = Joint(s.kind, np.eye(4), s.pitch + (delta[6 + K] if helical else 0.0)).unit_twist
        e = np.zeros((K, S))
        for k in range(K):
            move = joint * gtsam.Pose3.Expmap((q[k] + delta[6 + k]) * twist) * joint.inverse()
            for i in range(S):
                back = move.transformTo(s.patches.p_world[k, :, i])
                e[k, i] = s.patches.normal_world[:, i] @ back - m[i] - delta[first + i]
        return (np.sqrt(weights) * e).ravel()

    zero = np.zeros(first + S)
    J, r = central_difference(residual, zero, 1e-5), residual(zero)
    H, g = J.T @ J + np.diag(np.r_[np.zeros(first), 1e-12 * np.ones(S)]), J.T @ r
    a, b = slice(0, first), slice(first, None)
    held = np.linalg.solve(H[b, b], np.c_[H[b, a], g[b]])
    return H[a, a] - H[a, b] @ held[:, :-1], g[a] - H[a, b] @ held[:, -1]


def _places(s, T_world_joint, q, dof, scale):
    """Robust places (S,) along the normals and weights (K, S), iterated to the end."""
    R, t = Joint(s.kind, T_world_joint, s.pitch).motion(q)
    back = np.einsum("kji,kjs->kis", R, s.patches.p_world - t[:, :, None])
    along = np.einsum("as,kas->ks", s.patches.normal_world, back)
    precision = s.patches.precision / scale**2
    m = np.nanmedian(np.where(precision > 0, along, np.nan), axis=0)
    for _ in range(200):
        w = precision * weight(precision * (along - m) ** 2, dof, 1)
        m = (w * along).sum(axis=0) / w.sum(axis=0)
    return m, w


@pytest.mark.parametrize(("dof", "tolerance"), [(GAUSSIAN, 1e-6), (ROBUST, 1e-2)])
def test_normal_equations_are_the_schur_complement_of_the_dense_system(
    kind, case, dof, tolerance, surface
):
    """Where patches do not slide: the derivative is taken at each one's reference point.

    The robust places stop short of their best: hence the second tolerance.
    """
    s = surface(kind, case)
    T_world_joint, q = s.T_world_joint, s.q
    cost = s.cost(T_world_joint, q, dof, 1.2)
    H, g = s.normal_equations(T_world_joint, q, cost)
    H_dense, g_dense = _dense(s, T_world_joint, q, *_places(s, T_world_joint, q, dof, 1.2))
    d = _scaled(H_dense)
    assert np.abs(g_dense / d).max() > 1
    assert_allclose(H / np.outer(d, d), H_dense / np.outer(d, d), atol=tolerance)
    assert_allclose(g / d, g_dense / d, atol=tolerance * np.abs(g_dense / d).max())


@pytest.mark.parametrize(("dof", "tolerance"), [(GAUSSIAN, 1e-5), (ROBUST, 3e-2)])
def test_gradient_is_that_of_the_cost(kind, case, dof, tolerance, surface):
    s = surface(kind, case)
    T_world_joint, q = s.T_world_joint, s.q
    _, g = s.normal_equations(T_world_joint, q, s.cost(T_world_joint, q, dof))

    def half_cost(delta):
        pose = gtsam.Pose3(T_world_joint).compose(gtsam.Pose3.Expmap(delta[:6])).matrix()
        pitch = s.pitch + (delta[-1] if kind == "helical" else 0.0)
        return np.array([s.cost(pose, q + delta[6:10], dof, pitch=pitch).twice_cost / 2])

    numeric = central_difference(half_cost, np.zeros(g.size), 3e-6)[0]
    largest = np.abs(numeric).max()
    assert_allclose(g, numeric, atol=tolerance * largest)


def test_gradient_of_patches_that_slid_by_millimetres_is_nearly_that_of_the_cost(surface):
    """Their reference point stands for where they were read: of lever arms of decimetres."""
    s = surface(slide_m=2e-3)
    _, g = s.normal_equations(s.T_world_joint, s.q, s.cost(s.T_world_joint, s.q, GAUSSIAN))
    values, factor = _values(s, s.T_world_joint, s.q), _factor(s, GAUSSIAN)
    numeric = numeric_gradient(factor, values, [6, 1, 1, 1], 3e-6)
    d = _scaled(s.normal_equations(s.T_world_joint, s.q, s.cost(s.T_world_joint, s.q, GAUSSIAN))[0])
    free = [*range(6), *range(7, 10)]
    assert_allclose(g[free] / d[free], numeric / d[free], atol=0.05)


def test_information_of_the_motions_chained_to_the_joint_is_the_factors(surface):
    """The patches' form adds to that of `motion_information`: same variables, same gauge."""
    s = surface(gaps=False)
    H, g = dense_information(s.cost(s.T_world_joint, s.q, ROBUST), s.patches)
    assert H.shape == (24, 24) and g.shape == (24,)
    common = np.tile(np.eye(6), (4, 1))
    assert_allclose(H @ common, 0.0, atol=1e-10 * H.max())
    assert_allclose(g @ common, 0.0, atol=1e-9 * np.abs(g).max())
    assert np.linalg.eigvalsh(H)[6] > 1e-6 * H.max()


def test_surface_a_millimetre_off_between_two_keyframes_costs_a_quarter():
    """By hand: places half a sigma from each reading; half of 2 * (1/2)^2 is 1/4.

    Moving the second keyframe back along the normal by d = 1 mm takes all of it away: the slope
    is 1/2 a sigma, the curvature 1/2 a squared sigma.
    """
    patches = PatchObservations(
        np.array([[[0.3], [0.1], [0.0]], [[0.3], [0.1], [SIGMA_M]]]),
        np.full((2, 1), SIGMA_M**-2),
        np.array([[0.0], [0.0], [1.0]]),
    )
    cost = dense_cost(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), patches, GAUSSIAN, 1.0)
    assert_allclose(cost.twice_cost / 2, 0.25, rtol=1e-6)
    assert_allclose(cost.e[:, 0], [-SIGMA_M / 2, SIGMA_M / 2])
    assert_allclose(cost.x_world[:, 0], [0.3, 0.1, SIGMA_M / 2])
    assert_allclose(cost.log_det_latent, np.log(2 / SIGMA_M**2))
    H, g = dense_information(cost, patches)
    lift = np.zeros(12)
    lift[11] = 1.0
    assert_allclose(lift @ H @ lift, 0.5 / SIGMA_M**2, rtol=1e-6)
    assert_allclose(g @ lift, -0.5 / SIGMA_M, rtol=1e-6)
    turn = np.zeros(12)
    turn[6] = 1.0  # about x: the patch at y = 0.1 rises by 0.1 a radian
    assert_allclose(turn @ H @ turn, 0.5 * (0.1 / SIGMA_M) ** 2, rtol=1e-6)
    assert_allclose(g @ turn, -0.5 * 0.1 / SIGMA_M, rtol=1e-6)


def test_error_and_gradient_vanish_at_the_truth_however_far_patches_slide(kind, case, surface):
    s = surface(kind, case, sigma=0.0, slide_m=0.02)
    cost = s.cost(s.T_world_joint, s.q, ROBUST)
    assert_allclose(cost.twice_cost, 0.0, atol=1e-15)
    _, g = s.normal_equations(s.T_world_joint, s.q, cost)
    assert_allclose(g, 0.0, atol=1e-4)  # of 1e6 a metre
    assert s.cost(*_off(s), ROBUST).twice_cost > 1


def test_gauge_directions_carry_no_information(kind, case, surface):
    s = surface(kind, case)
    T_world_joint, q = _off(s)
    H, g = s.normal_equations(T_world_joint, q, s.cost(T_world_joint, q, ROBUST))
    assert_allclose(H[GAUGE[kind]], 0.0, atol=1e-11 * H.max())
    assert_allclose(g[GAUGE[kind]], 0.0, atol=1e-10 * np.abs(g).max())


def test_a_keyframe_in_which_a_patch_is_not_seen_does_not_count(kind, surface):
    s = surface(kind, gaps=False)
    moved, precision = s.patches.p_world.copy(), s.patches.precision.copy()
    moved[2, :, 6] += 0.3
    precision[2, 6] = 0
    a, b = (
        replace(s, patches=PatchObservations(p, precision, s.patches.normal_world))
        for p in (moved, s.patches.p_world)
    )
    costs = [x.cost(s.T_world_joint, s.q, ROBUST) for x in (a, b)]
    assert costs[0].twice_cost == costs[1].twice_cost
    assert costs[0].d2[2, 6] == costs[0].weight[2, 6] == costs[0].e[2, 6] == 0
    assert_allclose(costs[0].x_world, costs[1].x_world)
    (H0, g0), (H1, g1) = (
        x.normal_equations(s.T_world_joint, s.q, c) for x, c in zip((a, b), costs, strict=True)
    )
    assert_allclose(H0, H1)
    assert_allclose(g0, g1)


def test_patches_seen_once_or_never_say_nothing_of_the_joint(kind, surface):
    s = surface(kind, gaps=False)
    precision = s.patches.precision.copy()
    precision[1:, 2] = precision[:, 4] = 0
    few = replace(s, patches=replace(s.patches, precision=precision))
    kept = np.setdiff1d(np.arange(14), [2, 4])
    without = replace(
        s,
        patches=PatchObservations(
            s.patches.p_world[:, :, kept], precision[:, kept], s.patches.normal_world[:, kept]
        ),
    )
    costs = [x.cost(s.T_world_joint, s.q, ROBUST) for x in (few, without)]
    assert_allclose(costs[0].twice_cost, costs[1].twice_cost)
    (H0, g0), (H1, g1) = (
        x.normal_equations(s.T_world_joint, s.q, c)
        for x, c in zip((few, without), costs, strict=True)
    )
    assert_allclose(H0, H1, atol=1e-10 * H1.max())
    assert_allclose(g0, g1, atol=1e-10 * np.abs(g1).max())


def test_information_is_less_than_with_the_places_known(surface):
    """What marginalising takes away: all of a common slide, a share of everything else."""
    s = surface(gaps=False)
    cost = s.cost(s.T_world_joint, s.q, ROBUST)
    H, _ = dense_information(cost, s.patches)
    n = s.patches.normal_world
    J = np.concatenate([np.cross(n, cost.x_world, axis=0), -n]).T
    held = np.einsum("s,si,sj->ij", cost.weight[1], J, J)
    lost = np.linalg.eigvalsh(held - H[6:12, 6:12])
    assert lost[0] > 0.05 * np.linalg.eigvalsh(held)[0]


def test_one_wild_reading_hardly_counts(surface):
    s = surface(gaps=False, sigma=0.3)
    p = s.patches.p_world.copy()
    p[1, :, 3] += 0.05 * s.patches.normal_world[:, 3]
    cost = replace(s, patches=replace(s.patches, p_world=p)).cost(s.T_world_joint, s.q, ROBUST)
    share = cost.weight / s.patches.precision
    assert share[1, 3] < 0.01
    assert np.delete(share.ravel(), 14 + 3).min() > 0.4


def test_doubled_scale_quarters_squared_errors_and_information(kind, surface):
    s = surface(kind)
    T_world_joint, q = _off(s)
    costs = [s.cost(T_world_joint, q, GAUSSIAN, scale) for scale in (1.0, 2.0)]
    assert_allclose(costs[1].d2, costs[0].d2 / 4, rtol=1e-6)
    H1, H2 = (s.normal_equations(T_world_joint, q, cost)[0] for cost in costs)
    assert_allclose(H2, H1 / 4, atol=1e-6 * H1.max())


def test_robust_cost_is_that_of_the_student_t_kernel(surface):
    s = surface()
    cost = s.cost(s.T_world_joint, s.q, ROBUST, 1.1)
    d2 = s.patches.precision * cost.e**2 / 1.1**2
    assert_allclose(cost.d2, d2)
    assert_allclose(cost.twice_cost, twice_negative_log_kernel(d2, ROBUST, 1).sum())


def test_gradient_of_the_factor_in_gtsam_is_that_of_its_error(kind, case, surface):
    s = surface(kind, case)
    factor, values = _factor(s, GAUSSIAN, 1.2, 3.0), _values(s, s.T_world_joint, s.q)
    numeric = numeric_gradient(factor, values, [6] + [1] * (len(factor.keys()) - 1), 3e-6)
    assert_allclose(analytic_gradient(factor, values), numeric, atol=1e-5 * np.abs(numeric).max())


def test_factor_keeps_information_gradient_and_cost_of_the_free_variables(kind, surface):
    s = surface(kind)
    T_world_joint, q = _off(s)
    cost = s.cost(T_world_joint, q, ROBUST, 1.3)
    H, g = s.normal_equations(T_world_joint, q, cost)
    free = [*range(6), *range(7, H.shape[0])]
    factor, values = _factor(s, ROBUST, 1.3), _values(s, T_world_joint, q)
    A, b = factor.linearize(values).jacobian()
    assert_allclose(A.T @ A, H[np.ix_(free, free)], atol=1e-9 * H.max())
    assert_allclose(-A.T @ b, g[free], atol=1e-9 * np.abs(g).max())
    assert_allclose(factor.error(values), cost.twice_cost / 2)


def test_four_readings_that_count_as_one_weigh_a_quarter(kind, surface):
    s = surface(kind)
    values = _values(s, *_off(s))
    one, four = _factor(s), _factor(s, count=4.0)
    assert_allclose(four.error(values), one.error(values) / 4)
    (A1, b1), (A4, b4) = (f.linearize(values).jacobian() for f in (one, four))
    assert_allclose(A4.T @ A4, A1.T @ A1 / 4, atol=1e-9 * (A1.T @ A1).max())
    assert_allclose(A4.T @ b4, A1.T @ b1 / 4, atol=1e-9 * np.abs(A1.T @ b1).max())


def test_fifty_factors_are_freed_with_their_patches(surface):
    alive = []
    for _ in range(50):
        s = surface()
        alive.append(weakref.ref(s.patches.p_world))
        factor = _factor(s)
        factor.linearize(_values(s, s.T_world_joint, s.q))
        del factor, s
    gc.collect()
    assert sum(ref() is not None for ref in alive) == 0


def _patches(points=(3, 3, 5), precision=(3, 5), normals=(3, 5), value=1.0):
    return PatchObservations(np.zeros(points), np.full(precision, value), np.ones(normals))


@pytest.mark.parametrize(
    "shapes",
    [{"points": (3, 3, 4)}, {"precision": (5, 3)}, {"normals": (5, 3)}, {"points": (2, 3, 5)}],
)
def test_shapes_that_do_not_match_are_refused(shapes):
    with pytest.raises(ValueError, match=r"expected \(K, 3, S\), \(K, S\), \(3, S\)"):
        _patches(**shapes)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_a_precision_that_is_negative_or_not_finite_is_refused(value):
    with pytest.raises(ValueError, match="precision is negative or not finite"):
        _patches(value=value)


def test_a_point_that_is_not_finite_is_refused():
    points = np.zeros((3, 3, 5))
    points[1, 2, 3] = np.nan
    with pytest.raises(ValueError, match="expected 0 where a patch is not seen"):
        PatchObservations(points, np.ones((3, 5)), np.ones((3, 5)))


def test_keys_that_do_not_fit_the_keyframes_or_the_kind_are_refused(surface):
    patches = surface().patches
    with pytest.raises(ValueError, match="3 state keys, 4 frames"):
        dense_registration_factor("revolute", JOINT, _keys(3), patches, ROBUST, 1.0)
    with pytest.raises(ValueError, match="joint kind 'ball'"):
        dense_registration_factor("ball", JOINT, _keys(4), patches, ROBUST, 1.0)
    for kind, key in (("helical", None), ("revolute", PITCH)):
        with pytest.raises(ValueError, match=f"a {kind} joint with pitch key"):
            dense_registration_factor(kind, JOINT, _keys(4), patches, ROBUST, 1.0, pitch_key=key)


@pytest.mark.parametrize(("scale", "count"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0), (np.nan, 1.0)])
def test_a_scale_or_a_count_that_is_not_positive_is_refused(scale, count, surface):
    with pytest.raises(ValueError, match="expected > 0"):
        dense_registration_factor(
            "revolute", JOINT, _keys(4), surface().patches, ROBUST, scale, count
        )


def test_a_patch_lies_where_most_of_its_readings_see_it():
    """Along the normal at the latent place, which one reading far off hardly moves; by hand.

    Across it in the middle of where it was seen: of (0, 3, 6, 9) cm.
    """
    n = np.array([[0.0], [0.0], [1.0]])
    p = np.zeros((4, 3, 1))
    p[:, 0, 0] = [0.0, 0.03, 0.06, 0.09]
    p[:, 2, 0] = [0.2, 0.2, 0.2, 0.22]
    patches = PatchObservations(p, np.full((4, 1), SIGMA_M**-2), n)
    still = np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3))
    cost = dense_cost(*still, patches, ROBUST, 1.0)
    assert_allclose(cost.x_world[:2, 0], [0.045, 0.0], atol=1e-12)
    assert abs(cost.x_world[2, 0] - 0.2) < 3e-4  # the mean is 5 mm off
    assert_allclose(cost.e[:, 0], p[:, 2, 0] - cost.x_world[2, 0], atol=1e-12)


def test_costs_asked_for_in_any_order_are_those_asked_for_alone(surface):
    s = surface(sigma=3.0)
    costs = PatchCosts(s.patches, ROBUST)
    places = [
        Joint(s.kind, T, s.pitch).motion(q)
        for T, q in ((s.T_world_joint, s.q), _off(s), _off(s, 1e-2))
    ]
    for number, scale in ((0, 1.0), (1, 1.0), (1, 2.5), (2, 1.0), (0, 1.0), (0, 0.7)):
        got = costs.at(*places[number], scale)
        alone = dense_cost(*places[number], s.patches, ROBUST, scale)
        assert got.twice_cost == alone.twice_cost
        assert_array_equal(got.x_world, alone.x_world)
        assert_array_equal(got.weight, alone.weight)


def test_a_cost_asked_for_twice_is_found_once(surface):
    s = surface()
    costs, (R, t) = PatchCosts(s.patches, ROBUST), Joint(s.kind, s.T_world_joint, 0.0).motion(s.q)
    first = costs.at(R, t, 1.0)
    assert costs.at(R.copy(), t.copy(), 1.0) is first
    assert costs.at(R, t, 1.1) is not first
