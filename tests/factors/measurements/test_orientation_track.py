"""Orientation-track factor: SO(3) derivatives from zero to pi, and one flipped marker."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.joint import Joint
from factors.measurements.orientation_track import (
    log_so3,
    orientation_residual,
    orientation_track_factor,
    right_jacobian_inverse,
)
from factors.student_t import twice_negative_log_kernel, weight

GAUSSIAN, ROBUST = 1e9, 4.0
JOINT, REFERENCE = gtsam.symbol("j", 0), gtsam.symbol("r", 0)
R_REF = gtsam.Rot3.Expmap(np.array([-0.3, 0.8, 0.5]))
# Size of the orientation errors at which derivatives are checked. At exactly pi the logarithm
# jumps, so differences are taken just beside it.
ERRORS = {"zero": 0.0, "near zero": 1e-6, "generic": 0.7, "pi": np.pi - 1e-3}


def _turned(kind, R_world_joint):
    T_world_joint = np.eye(4)
    T_world_joint[:3, :3] = R_world_joint
    return Joint(kind, T_world_joint, 0.0)


def _exp(w):
    return gtsam.Rot3.Expmap(np.asarray(w, dtype=float)).matrix()


def _measured(s, size, seed=0):
    """Orientations (T, 3, 3) seen at the scene's joint, each with an error of `size` radians."""
    rng = np.random.default_rng(seed)
    out = []
    for state in s.q:
        R_wj = s.T_world_joint[:3, :3]
        opened = _exp([0, 0, state]) if s.kind != "prismatic" else np.eye(3)
        e = rng.normal(size=3)
        out.append(R_wj @ opened @ R_wj.T @ R_REF.matrix() @ _exp(size * e / np.linalg.norm(e)))
    return np.array(out)


def _keys(T):
    return [None, *(gtsam.symbol("q", t) for t in range(1, T))]


def _values(s):
    values = gtsam.Values()
    values.insert(JOINT, gtsam.Pose3(s.T_world_joint))
    values.insert(REFERENCE, R_REF)
    for key, state in zip(_keys(s.q.size)[1:], s.q[1:], strict=True):
        values.insert(key, float(state))
    return values


def _factor(s, measured, sigma=0.02, dof=ROBUST):
    keys = _keys(s.q.size)
    return orientation_track_factor(s.kind, JOINT, REFERENCE, keys, measured, sigma, dof)


@pytest.mark.parametrize("size", ERRORS.values(), ids=ERRORS.keys())
def test_jacobians_match_differences(kind, case, size, scene):
    s = scene(kind, case)
    measured = _measured(s, size)
    R_wj = s.T_world_joint[:3, :3]
    _, J_w, J_ref, J_q = orientation_residual(_turned(kind, R_wj), R_REF.matrix(), s.q, measured)

    def moved(w, r, dq):
        R_ref = R_REF.matrix() @ _exp(r)
        return orientation_residual(_turned(kind, R_wj @ _exp(w)), R_ref, s.q + dq, measured)[
            0
        ].ravel()

    zero = np.zeros(3)
    by_w = central_difference(lambda d: moved(d, zero, 0.0), zero)
    by_ref = central_difference(lambda d: moved(zero, d, 0.0), zero)
    by_q = central_difference(lambda d: moved(zero, zero, d[0]), np.zeros(1))
    assert_allclose(J_w.reshape(-1, 3), by_w, atol=1e-6)
    assert_allclose(J_ref.reshape(-1, 3), by_ref, atol=1e-6)
    assert_allclose(J_q.reshape(-1, 1), by_q, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.0099, 0.0101, 0.7, 3.0, np.pi - 1e-6, np.pi])
def test_right_jacobian_inverse_is_the_inverse_of_gtsams(angle):
    w = angle * np.array([[0.6, -0.48, 0.64]])
    J = gtsam.Rot3.ExpmapDerivative(w[0])
    assert_allclose(right_jacobian_inverse(w)[0] @ J, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 3.0, np.pi - 1e-6, np.pi])
def test_logarithm_undoes_the_exponential_up_to_pi(angle):
    w = angle * np.array([0.6, -0.48, 0.64])
    got = log_so3(_exp(w)[None])[0]
    assert_allclose(_exp(got), _exp(w), atol=1e-9)
    assert_allclose(np.linalg.norm(got), angle, atol=1e-7)


def test_door_turned_by_a_tenth_and_modelled_as_shut_errs_by_a_tenth_about_its_axis():
    e, *_ = orientation_residual(
        _turned("revolute", np.eye(3)), np.eye(3), np.zeros(1), _exp([0, 0, 0.1])[None]
    )
    assert_allclose(e[0], [0.0, 0.0, 0.1], atol=1e-12)


def test_door_modelled_as_open_and_seen_shut_errs_the_other_way():
    e, *_ = orientation_residual(
        _turned("revolute", np.eye(3)), np.eye(3), np.array([0.1]), np.eye(3)[None]
    )
    assert_allclose(e[0], [0.0, 0.0, -0.1], atol=1e-12)


def test_error_vanishes_at_the_truth(kind, case, scene):
    s = scene(kind, case)
    measured = _measured(s, 0.0)
    e, *_ = orientation_residual(s.joint, R_REF.matrix(), s.q, measured)
    assert_allclose(e, 0.0, atol=1e-12)
    assert_allclose(_factor(s, measured).error(_values(s)), 0.0, atol=1e-15)


def test_the_orientation_of_a_drawer_says_nothing_about_its_axis_or_state(scene):
    s = scene("prismatic")
    measured = _measured(s, 0.3)
    _, J_w, _, J_q = orientation_residual(s.joint, R_REF.matrix(), s.q, measured)
    assert_allclose(J_w, 0.0, atol=1e-12)
    assert_allclose(J_q, 0.0)


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
@pytest.mark.parametrize("size", ERRORS.values(), ids=ERRORS.keys())
def test_gradient_of_the_factor_is_that_of_its_error(kind, size, dof, scene):
    s = scene(kind)
    factor, values = _factor(s, _measured(s, size), dof=dof), _values(s)
    numeric = numeric_gradient(factor, values, [6, 3] + [1] * (s.q.size - 1))
    allowed = 1e-4 if size < 1e-3 else 1e-5 * np.abs(numeric).max()
    assert_allclose(analytic_gradient(factor, values), numeric, atol=allowed)


def test_factor_keeps_information_and_cost_of_the_stacked_frames(kind, scene):
    s, sigma = scene(kind), 0.02
    measured, values = _measured(s, 0.05), _values(s)
    e, J_w, J_ref, J_q = orientation_residual(s.joint, R_REF.matrix(), s.q, measured)
    T = s.q.size
    J = np.zeros((T, 3, 9 + T))
    J[:, :, :3], J[:, :, 6:9] = J_w, J_ref
    for t in range(T):
        J[t, :, 9 + t] = J_q[t]
    d2 = (e**2).sum(1) / sigma**2
    J = (J * np.sqrt(weight(d2, ROBUST, 3))[:, None, None] / sigma).reshape(3 * T, -1)
    J = np.delete(J, 9, axis=1)  # the state of frame 0 is fixed
    A, b = _factor(s, measured).linearize(values).jacobian()
    assert_allclose(A.T @ A, J.T @ J, atol=1e-9 * (J.T @ J).max())
    assert_allclose(b @ b, twice_negative_log_kernel(d2, ROBUST, 3).sum())
    assert_allclose(_factor(s, measured).error(values), b @ b / 2)


def test_translation_of_the_joint_carries_no_information(kind, scene):
    s = scene(kind)
    A, _ = _factor(s, _measured(s, 0.05)).linearize(_values(s)).jacobian()
    assert_allclose(A[:, 3:6], 0.0, atol=1e-9)


def test_turning_the_frame_about_its_axis_carries_no_information(scene):
    s = scene("revolute")
    A, _ = _factor(s, _measured(s, 0.05)).linearize(_values(s)).jacobian()
    assert_allclose(A[:, 2], 0.0, atol=1e-9)


def test_a_flipped_marker_costs_one_frame_only(scene):
    s = scene("revolute")
    measured = _measured(s, 0.01)
    measured[2] = measured[2] @ _exp([np.pi, 0, 0])
    A, _ = _factor(s, measured).linearize(_values(s)).jacobian()
    on_state = (A[:, 9:] ** 2).sum(axis=0)  # states 1, 2, 3
    assert on_state[1] < 1e-2 * min(on_state[0], on_state[2])


@pytest.mark.parametrize("shape", [(3, 3, 3), (5, 3, 3), (4, 3), (4, 3, 4)])
def test_orientations_that_do_not_match_the_frames_are_refused(shape, scene):
    with pytest.raises(ValueError, match=r"orientations .* expected \(4, 3, 3\)"):
        _factor(scene(), np.zeros(shape))


@pytest.mark.parametrize("sigma", [0.0, -0.1, np.nan])
def test_a_sigma_that_is_not_positive_is_refused(sigma, scene):
    s = scene()
    with pytest.raises(ValueError, match=r"sigma_rad .* expected > 0"):
        _factor(s, _measured(s, 0.0), sigma=sigma)


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="joint kind 'ball'"):
        orientation_track_factor("ball", JOINT, REFERENCE, _keys(1), np.zeros((1, 3, 3)), 0.1, 4.0)
