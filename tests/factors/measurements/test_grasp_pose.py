"""Grasp-pose factor: the hand tells the joint, a jerk costs a frame, a slip starts a new hold."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.joint import Joint
from factors.measurements.grasp_pose import (
    grasp_log_normaliser,
    grasp_pose_factor,
    grasp_pose_residual,
    grasps_in_joint,
    hold_starts,
    typical_grasp,
)
from factors.priors.gauge import gauge_factor
from factors.student_t import log_normaliser, twice_negative_log_kernel, weight

GAUSSIAN, ROBUST = 1e9, 4.0
SIGMA_ROT, SIGMA_TRANS = 0.01, 0.002
JOINT, PITCH = gtsam.symbol("j", 0), gtsam.symbol("h", 0)
GRASP, SECOND_GRASP = gtsam.symbol("g", 0), gtsam.symbol("g", 1)
T_JOINT_GRASP = gtsam.Pose3(gtsam.Rot3.Expmap([0.7, -1.2, 0.4]), np.array([0.4, 0.1, -0.2]))
STATES = {
    "zero": np.zeros(4),
    "near zero": np.array([0.0, 1e-9, -1e-7, 1e-5]),
    "generic": np.array([0.0, 0.3, -0.8, 1.7]),
    "pi": np.array([0.0, np.pi, -np.pi, np.pi / 2]),
}
FRAME_TURNS = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-7, 0.0, -1e-9]),
    "generic": np.array([0.4, -0.9, 0.6]),
    "pi": np.pi * np.array([0.6, 0.0, 0.8]),
}
# Size of the rotation errors at which derivatives are checked. At exactly pi the logarithm jumps,
# so differences are taken just beside it.
ERRORS = {"zero": 0.0, "near zero": 1e-6, "generic": 0.7, "pi": np.pi - 1e-3}


@pytest.fixture(params=["revolute", "prismatic", "helical"])
def kind(request):
    return request.param


@pytest.fixture(params=list(STATES))
def q(request):
    return STATES[request.param]


def _pitch(kind):
    return 0.07 if kind == "helical" else 0.0


def _joint(turn=(0.4, -0.9, 0.6)):
    return gtsam.Pose3(gtsam.Rot3.Expmap(np.asarray(turn)), np.array([0.2, -0.5, 0.9]))


def _measured(kind, q, size=0.0, seed=0, joint=None, grasp=T_JOINT_GRASP):
    """Gripper poses (T, 4, 4) by GTSAM's own group operations, each off by `size` radians (and
    as many decimetres)."""
    rng = np.random.default_rng(seed)
    twist = Joint(kind, np.eye(4), _pitch(kind)).unit_twist
    out = []
    for state in q:
        pose = (joint or _joint()) * gtsam.Pose3.Expmap(state * twist) * grasp
        w, v = rng.normal(size=(2, 3))
        off = gtsam.Pose3(gtsam.Rot3.Expmap(size * w / np.linalg.norm(w)), 0.1 * size * v)
        out.append((pose * off).matrix())
    return np.array(out)


def _keys(q):
    return [None, *(gtsam.symbol("q", t) for t in range(1, q.size))]


def _values(kind, q, joint=None):
    values = gtsam.Values()
    values.insert(JOINT, joint or _joint())
    values.insert(GRASP, T_JOINT_GRASP)
    if kind == "helical":
        values.insert(PITCH, _pitch(kind))
    for key, state in zip(_keys(q)[1:], q[1:], strict=True):
        values.insert(key, float(state))
    return values


def _factor(kind, q, measured, sigmas=(SIGMA_ROT, SIGMA_TRANS), dof=ROBUST):
    pitch_key = PITCH if kind == "helical" else None
    return grasp_pose_factor(kind, JOINT, GRASP, _keys(q), measured, *sigmas, dof, pitch_key)


@pytest.mark.parametrize("size", ERRORS.values(), ids=ERRORS.keys())
@pytest.mark.parametrize("case", list(STATES))
def test_jacobians_match_differences(kind, case, size):
    q, turn = STATES[case], FRAME_TURNS[case]
    measured, joint = _measured(kind, q, size, joint=_joint(turn)), _joint(turn)
    pitch = _pitch(kind)

    def moved(d):
        T_world_joint = joint.compose(gtsam.Pose3.Expmap(d[:6])).matrix()
        T_joint_grasp = T_JOINT_GRASP.compose(gtsam.Pose3.Expmap(d[6:12])).matrix()
        if kind == "helical":
            h, state = pitch + d[13], q + d[12]
        else:
            h, state = 0.0, q + d[12]
        e, *_ = grasp_pose_residual(Joint(kind, T_world_joint, h), state, T_joint_grasp, measured)
        return e.ravel()

    _, J_joint, J_grasp, J_q, J_pitch = grasp_pose_residual(
        Joint(kind, joint.matrix(), pitch), q, T_JOINT_GRASP.matrix(), measured
    )
    numeric = central_difference(moved, np.zeros(14)).reshape(q.size, 6, 14)
    assert_allclose(J_joint, numeric[:, :, :6], atol=2e-6)
    assert_allclose(J_grasp, numeric[:, :, 6:12], atol=2e-6)
    assert_allclose(J_q, numeric[:, :, 12], atol=2e-6)
    if kind == "helical":
        assert_allclose(J_pitch, numeric[:, :, 13], atol=2e-6)


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
@pytest.mark.parametrize("size", ERRORS.values(), ids=ERRORS.keys())
def test_gradient_of_the_factor_is_that_of_its_error(kind, size, dof):
    q = STATES["generic"]
    factor, values = _factor(kind, q, _measured(kind, q, size), dof=dof), _values(kind, q)
    dims = [6, 6] + [1] * (len(list(factor.keys())) - 2)
    numeric = numeric_gradient(factor, values, dims)
    allowed = 1e-2 if size < 1e-3 else 1e-5 * np.abs(numeric).max()
    assert_allclose(analytic_gradient(factor, values), numeric, atol=allowed)


def test_factor_keeps_information_and_cost_of_the_stacked_frames(kind):
    q = STATES["generic"]
    measured = _measured(kind, q, 0.02)
    e, J_joint, J_grasp, J_q, J_pitch = grasp_pose_residual(
        Joint(kind, _joint().matrix(), _pitch(kind)), q, T_JOINT_GRASP.matrix(), measured
    )
    sigmas = np.repeat([SIGMA_ROT, SIGMA_TRANS], 3)
    states = np.zeros((q.size, 6, q.size))
    for t in range(q.size):
        states[t, :, t] = J_q[t]
    pitch = [J_pitch[..., None]] if kind == "helical" else []
    J = np.concatenate([J_joint, J_grasp, states[:, :, 1:], *pitch], axis=2)
    d2 = ((e / sigmas) ** 2).sum(axis=1)
    J = (J / sigmas[:, None] * np.sqrt(weight(d2, ROBUST, 6))[:, None, None]).reshape(
        6 * q.size, -1
    )
    factor, values = _factor(kind, q, measured), _values(kind, q)
    A, b = factor.linearize(values).jacobian()
    assert_allclose(A.T @ A, J.T @ J, atol=1e-9 * (J.T @ J).max())
    assert_allclose(b @ b, twice_negative_log_kernel(d2, ROBUST, 6).sum())
    assert_allclose(factor.error(values), b @ b / 2)


def test_error_vanishes_at_the_truth(kind, q):
    measured = _measured(kind, q)
    e, *_ = grasp_pose_residual(
        Joint(kind, _joint().matrix(), _pitch(kind)), q, T_JOINT_GRASP.matrix(), measured
    )
    assert_allclose(e, 0.0, atol=1e-12)
    assert_allclose(_factor(kind, q, measured).error(_values(kind, q)), 0.0, atol=1e-12)


def test_door_opened_by_a_quarter_turn_takes_the_hand_from_x_to_y():
    """Hand at (1, 0, 0) of a hinge at the origin; modelled open by 90 deg, seen shut."""
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0])).matrix()
    e, *_ = grasp_pose_residual(
        Joint("revolute", np.eye(4), 0.0), np.array([np.pi / 2]), hand, hand[None]
    )
    assert_allclose(e[0], [0.0, 0.0, np.pi / 2, -1.0, 1.0, 0.0], atol=1e-12)


def test_screw_of_a_quarter_metre_a_radian_lifts_the_hand_by_an_eighth_in_half_a_radian():
    seen = gtsam.Pose3(gtsam.Rot3.Rz(0.5), np.zeros(3)).matrix()
    e, *_ = grasp_pose_residual(
        Joint("helical", np.eye(4), 0.25), np.array([0.5]), np.eye(4), seen[None]
    )
    assert_allclose(e[0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.125], atol=1e-12)


def test_each_frame_alone_gives_the_grasp_back(kind, q):
    grasps = grasps_in_joint(Joint(kind, _joint().matrix(), _pitch(kind)), q, _measured(kind, q))
    assert_allclose(grasps, np.tile(T_JOINT_GRASP.matrix(), (q.size, 1, 1)), atol=1e-12)


def test_the_hand_alone_finds_a_doors_axis():
    """Noise-free: joint, grasp and states come back from a start that is degrees and cm off."""
    q = np.linspace(0.0, 0.6, 12)
    start = _joint().compose(gtsam.Pose3.Expmap([0.1, -0.08, 0.0, 0.03, -0.02, 0.0]))
    values = _values("revolute", q, joint=start)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(_factor("revolute", q, _measured("revolute", q)))
    graph.add(gauge_factor("revolute", JOINT, start.rotation(), np.array([0.5, -0.3, 0.8])))
    result = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    found = result.atPose3(JOINT).matrix()
    axis, pivot = _joint().matrix()[:3, 2], _joint().matrix()[:3, 3]
    assert_allclose(found[:3, 2], axis, atol=1e-6)
    assert_allclose(np.cross(found[:3, 3] - pivot, axis), 0.0, atol=1e-6)
    assert_allclose([result.atDouble(k) for k in _keys(q)[1:]], q[1:], atol=1e-6)


@pytest.mark.slow
def test_the_axis_found_by_the_hand_errs_as_much_as_it_says():
    """Mean NEES of (wx, wy, vx, vy) over 200 holds, Gaussian noise."""
    rng, q = np.random.default_rng(0), np.linspace(0.0, 0.6, 12)
    middle = _joint().transformFrom(np.array([0.4, 0.1, 0.0]))  # as high as the true origin
    exact, nees = _measured("revolute", q), []
    for _ in range(200):
        off = rng.normal(size=(q.size, 6)) * np.repeat([SIGMA_ROT, SIGMA_TRANS], 3)
        measured = np.array(
            [
                (gtsam.Pose3(M) * gtsam.Pose3(gtsam.Rot3.Expmap(d[:3]), d[3:])).matrix()
                for M, d in zip(exact, off, strict=True)
            ]
        )
        graph = gtsam.NonlinearFactorGraph()
        graph.add(_factor("revolute", q, measured, dof=GAUSSIAN))
        graph.add(gauge_factor("revolute", JOINT, _joint().rotation(), middle))
        result = gtsam.LevenbergMarquardtOptimizer(graph, _values("revolute", q)).optimize()
        error = gtsam.Pose3.Logmap(result.atPose3(JOINT).between(_joint()))[[0, 1, 3, 4]]
        cov = gtsam.Marginals(graph, result).marginalCovariance(JOINT)
        nees.append(error @ np.linalg.solve(cov[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], error))
    # 99.9 % band of the mean of 200 chi-squares of four degrees of freedom
    assert 3.40 < np.mean(nees) < 4.68


def test_a_jerk_of_the_hand_costs_one_frame_only():
    q = STATES["generic"]
    measured = _measured("revolute", q, 0.005)
    measured[2, :3, 3] += [0.0, 0.1, 0.1]
    A, _ = _factor("revolute", q, measured).linearize(_values("revolute", q)).jacobian()
    on_state = (A[:, 12:] ** 2).sum(axis=0)
    assert on_state[1] < 1e-2 * min(on_state[0], on_state[2])


def test_two_holds_with_their_own_grasps_explain_a_lasting_slip_and_one_does_not():
    q = np.linspace(0.0, 0.6, 12)
    slipped = T_JOINT_GRASP.compose(gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.03, 0.0])))
    measured = np.vstack(
        [_measured("revolute", q[:6]), _measured("revolute", q[6:], grasp=slipped)]
    )
    keys, noise = _keys(q), (SIGMA_ROT, SIGMA_TRANS, ROBUST)
    values = _values("revolute", q)
    values.insert(SECOND_GRASP, slipped)
    first = grasp_pose_factor("revolute", JOINT, GRASP, keys[:6], measured[:6], *noise)
    second = grasp_pose_factor("revolute", JOINT, SECOND_GRASP, keys[6:], measured[6:], *noise)
    assert_allclose(first.error(values) + second.error(values), 0.0, atol=1e-12)
    assert _factor("revolute", q, measured).error(values) > 30


def _noisy_grasps(T, seed):
    rng = np.random.default_rng(seed)
    return np.array(
        [
            T_JOINT_GRASP.compose(
                gtsam.Pose3(
                    gtsam.Rot3.Expmap(SIGMA_ROT * rng.normal(size=3)),
                    SIGMA_TRANS * rng.normal(size=3),
                )
            ).matrix()
            for _ in range(T)
        ]
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_lasting_slip_is_found_where_it_happens(seed):
    grasps = _noisy_grasps(30, seed)
    grasps[12:] = grasps[12:] @ gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.01, 0.0])).matrix()
    starts = hold_starts(grasps, SIGMA_ROT, SIGMA_TRANS, ROBUST)
    assert starts[0] == 0 and starts.size == 2
    assert abs(starts[1] - 12) <= 1


@pytest.mark.parametrize("seed", range(3))
def test_a_hold_with_single_jerks_is_one_hold(seed):
    grasps = _noisy_grasps(30, seed)
    grasps[[7, 20], :3, 3] += 0.05
    assert_allclose(hold_starts(grasps, SIGMA_ROT, SIGMA_TRANS, ROBUST), [0])


@pytest.mark.parametrize("frames", [1, 3, 5])
def test_few_frames_are_one_hold(frames):
    assert_allclose(hold_starts(_noisy_grasps(frames, 0), SIGMA_ROT, SIGMA_TRANS, ROBUST), [0])


def test_the_typical_grasp_is_none_of_the_outliers():
    grasps = np.tile(T_JOINT_GRASP.matrix(), (5, 1, 1))
    grasps[0, :3, 3] += 0.1
    grasps[1, :3, :3] = grasps[1, :3, :3] @ gtsam.Rot3.Rx(1.0).matrix()
    grasps[3:, :3, 3] += 1e-3
    assert_allclose(typical_grasp(grasps, SIGMA_ROT, SIGMA_TRANS), grasps[3])


@pytest.mark.parametrize("axis", range(3))
def test_a_turn_by_one_deviation_weighs_as_much_as_a_slide_by_one(axis):
    """Five grasps, in deviations; sums of distances to the others are least for the third: 26.9.

    With turns counted by half it would be the second, counted twice the fourth.
    """
    offsets = np.array([[2, -3], [-3, 3], [-2, 4], [1, -3], [3, 4]])
    sums = [sum(np.hypot(*(one - other)) for other in offsets) for one in offsets]
    assert int(np.argmin(sums)) == 2
    grasps = np.tile(T_JOINT_GRASP.matrix(), (5, 1, 1))
    for grasp, (turns, slides) in zip(grasps, offsets, strict=True):
        about = SIGMA_ROT * turns * np.eye(3)[axis]
        grasp[:3, :3] = grasp[:3, :3] @ gtsam.Rot3.Expmap(about).matrix()
        grasp[axis, 3] += SIGMA_TRANS * slides
    assert_allclose(typical_grasp(grasps, SIGMA_ROT, SIGMA_TRANS), grasps[2])


def test_normaliser_is_that_of_the_scaled_density():
    got = grasp_log_normaliser(3, 0.01, 0.002, 4.0)
    assert_allclose(got, 3 * (log_normaliser(4.0, 6) - 3 * np.log(0.01 * 0.002)))


def test_a_still_part_holds_the_hand_still():
    """A prismatic joint with every state fixed is the hypothesis that nothing moved."""
    measured = _measured("prismatic", np.zeros(3))
    factor = grasp_pose_factor(
        "prismatic", JOINT, GRASP, [None] * 3, measured, SIGMA_ROT, SIGMA_TRANS, ROBUST
    )
    assert_allclose(factor.error(_values("prismatic", np.zeros(1))), 0.0, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 4, 4), (4, 3, 4), (4, 4), (4, 6)])
def test_poses_that_do_not_match_the_frames_are_refused(shape):
    with pytest.raises(ValueError, match=r"gripper poses .* expected \(4, 4, 4\)"):
        _factor("revolute", STATES["generic"], np.zeros(shape))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda T: T.__setitem__((2, 0, 3), np.nan),
        lambda T: T.__setitem__((2, 0, 0), np.nan),
        lambda T: T.__setitem__((2, slice(3), slice(3)), 2 * np.eye(3)),
        lambda T: T.__setitem__((2, slice(3), slice(3)), -np.eye(3)),
    ],
    ids=["nan place", "nan turn", "scaled", "mirrored"],
)
def test_a_matrix_that_is_no_pose_is_refused_with_its_frame(spoil):
    measured = _measured("revolute", STATES["generic"])
    spoil(measured)
    with pytest.raises(ValueError, match=r"frames \[2\] are not rigid"):
        _factor("revolute", STATES["generic"], measured)


@pytest.mark.parametrize("bad", [0.0, -0.1, np.nan])
def test_noise_that_is_not_positive_is_refused(bad):
    q = STATES["generic"]
    measured = _measured("revolute", q)
    with pytest.raises(ValueError, match=r"sigma_rot_rad is .* expected > 0"):
        _factor("revolute", q, measured, sigmas=(bad, 0.1))
    with pytest.raises(ValueError, match=r"sigma_trans_m is .* expected > 0"):
        _factor("revolute", q, measured, sigmas=(0.1, bad))
    with pytest.raises(ValueError, match=r"dof is .* expected > 0"):
        _factor("revolute", q, measured, dof=bad)


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="joint kind 'ball'"):
        _factor("ball", STATES["generic"], _measured("revolute", STATES["generic"]))


@pytest.mark.parametrize(("kind", "pitch_key"), [("helical", None), ("revolute", PITCH)])
def test_a_pitch_missing_or_out_of_place_is_refused(kind, pitch_key):
    measured = _measured("revolute", STATES["generic"])
    with pytest.raises(ValueError, match="helical joints have one"):
        grasp_pose_factor(
            kind, JOINT, GRASP, _keys(STATES["generic"]), measured, 0.1, 0.1, 4.0, pitch_key
        )
