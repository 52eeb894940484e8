"""Joint kinematics: every motion against GTSAM's own exponential, every derivative numerically."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import central_difference
from factors.joint import Joint, JointKind, cross, skew


def _reference(s, T_world_joint, q):
    return Joint(s.kind, T_world_joint, s.pitch).reference_coordinates(q, s.p_world.swapaxes(1, 2))


def test_door_opened_by_a_quarter_turn_moves_the_handle_from_x_to_y():
    R, t = Joint("revolute", np.eye(4), 0.0).motion(np.array([np.pi / 2]))
    assert_allclose(R[0] @ [0.7, 0.0, 1.0] + t[0], [0.0, 0.7, 1.0], atol=1e-15)


def test_door_hinged_at_its_edge_swings_about_that_edge():
    hinge = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0])).matrix()
    R, t = Joint("revolute", hinge, 0.0).motion(np.array([np.pi / 2]))
    assert_allclose(R[0] @ [1.5, 0.0, 0.2] + t[0], [1.0, 0.5, 0.2], atol=1e-15)


def test_drawer_pulled_by_ten_centimetres_moves_along_the_joint_axis():
    sideways = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([4.0, 5.0, 6.0])).matrix()
    R, t = Joint("prismatic", sideways, 0.0).motion(np.array([0.1]))
    assert_allclose(R[0], np.eye(3), atol=1e-15)
    assert_allclose(t[0], [0.1, 0.0, 0.0], atol=1e-15)


def test_screw_of_five_centimetres_a_radian_climbs_by_five_pi_centimetres_in_half_a_turn():
    R, t = Joint("helical", np.eye(4), 0.05).motion(np.array([np.pi]))
    assert_allclose(R[0] @ [0.7, 0.0, 1.0] + t[0], [-0.7, 0.0, 1.0 + 0.05 * np.pi], atol=1e-15)


def test_a_screw_without_pitch_is_a_hinge(scene):
    s = scene("revolute")
    for hinge, screw in zip(
        Joint("revolute", s.T_world_joint, 0.0).motion(s.q),
        Joint("helical", s.T_world_joint, 0.0).motion(s.q),
        strict=True,
    ):
        assert_allclose(screw, hinge, atol=1e-15)


def test_joint_displacement_is_the_exponential_of_the_unit_twist(kind, case, scene):
    s = scene(kind, case)
    rotations, translations = s.joint.displacement(s.q)
    for t, state in enumerate(s.q):
        want = gtsam.Pose3.Expmap(state * s.joint.unit_twist)
        assert_allclose(rotations[t], want.rotation().matrix(), atol=1e-12)
        assert_allclose(translations[t], want.translation(), atol=1e-12)


def test_part_motion_is_the_displacement_seen_from_the_world(kind, case, scene):
    s = scene(kind, case)
    joint = gtsam.Pose3(s.T_world_joint)
    R, t = s.joint.motion(s.q)
    for k, state in enumerate(s.q):
        want = joint * gtsam.Pose3.Expmap(state * s.joint.unit_twist) * joint.inverse()
        assert_allclose(R[k], want.rotation().matrix(), atol=1e-12)
        assert_allclose(t[k], want.translation(), atol=1e-12)


def test_at_the_truth_a_point_has_the_same_reference_coordinates_in_every_frame(kind, case, scene):
    s = scene(kind, case, sigma=0)
    z = _reference(s, s.T_world_joint, s.q)
    assert_allclose(z, np.broadcast_to(s.x_joint.T, z.shape), atol=1e-12)


def test_adjoint_of_return_is_that_of_the_inverse_displacement(kind, case, scene):
    s = scene(kind, case)
    S = s.joint.unit_twist
    want = [gtsam.Pose3.Expmap(-state * S).AdjointMap() for state in s.q]
    assert_allclose(s.joint.adjoint_of_return(s.q), want, atol=1e-12)


def test_twist_jacobian_of_reference_coordinates_matches_differences(kind, case, scene):
    s = scene(kind, case)
    z = _reference(s, s.T_world_joint, s.q)

    def moved(xi):
        T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(xi)).matrix()
        return _reference(s, T, s.q).ravel()

    numeric = central_difference(moved, np.zeros(6)).reshape(*z.shape, 6)
    G = np.concatenate([skew(z.swapaxes(1, 2)), np.tile(-np.eye(3), (*z.shape[::2], 1, 1))], -1)
    analytic = np.einsum("tnij,tjk->tink", G, s.joint.adjoint_of_return(s.q))
    assert_allclose(analytic, numeric, atol=1e-8)


def test_state_jacobian_of_reference_coordinates_matches_differences(kind, case, scene):
    s = scene(kind, case)
    z = _reference(s, s.T_world_joint, s.q)

    def moved(dq):
        return _reference(s, s.T_world_joint, s.q + dq[0]).ravel()

    numeric = central_difference(moved, np.zeros(1)).reshape(z.shape)
    S = s.joint.unit_twist
    analytic = np.cross(z, S[:3], axisa=1, axisb=0, axisc=1) - S[3:, None]
    assert_allclose(analytic, numeric, atol=1e-8)


def test_pitch_jacobian_of_reference_coordinates_matches_differences(case, scene):
    s = scene("helical", case)

    def moved(dh):
        p = s.p_world.swapaxes(1, 2)
        z = Joint("helical", s.T_world_joint, s.pitch + dh[0]).reference_coordinates(s.q, p)
        return z.ravel()

    numeric = central_difference(moved, np.zeros(1)).reshape(len(s.q), 3, -1)
    analytic = -s.q[:, None, None] * np.array([0.0, 0.0, 1.0])[:, None]
    assert_allclose(numeric, np.broadcast_to(analytic, numeric.shape), atol=1e-8)


def _log_of_change(s, T_world_joint, q, pitch):
    """Twists (T, 6) from the scene's own motions to these, by GTSAM's logarithm."""
    R0, t0 = s.joint.motion(s.q)
    R1, t1 = Joint(s.kind, T_world_joint, pitch).motion(q)
    pairs = zip(R0, t0, R1, t1, strict=True)
    return np.array(
        [
            gtsam.Pose3.Logmap(gtsam.Pose3(gtsam.Rot3(a), b).between(gtsam.Pose3(gtsam.Rot3(c), d)))
            for a, b, c, d in pairs
        ]
    )


def test_motion_jacobians_match_differences_of_the_motions_logarithms(kind, case, scene):
    s = scene(kind, case)
    by_xi, by_state, by_pitch = s.joint.motion_jacobians(s.q)

    def by(function, size):
        numeric = central_difference(lambda d: function(d).ravel(), np.zeros(size))
        return numeric.reshape(len(s.q), 6, size)

    def turned(xi):
        T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(xi)).matrix()
        return _log_of_change(s, T, s.q, s.pitch)

    assert_allclose(by_xi, by(turned, 6), atol=1e-7)
    opened = by(lambda d: _log_of_change(s, s.T_world_joint, s.q + d[0], s.pitch), 1)
    assert_allclose(by_state, opened[..., 0], atol=1e-7)
    if kind == "helical":
        pitched = by(lambda d: _log_of_change(s, s.T_world_joint, s.q, s.pitch + d[0]), 1)
        assert_allclose(by_pitch, pitched[..., 0], atol=1e-7)


def test_cross_of_x_and_y_is_z_and_of_any_two_vectors_what_numpy_says():
    assert_allclose(cross(np.array([1.0, 0, 0]), np.array([0.0, 1, 0])), [0, 0, 1])
    a, b = np.random.default_rng(0).normal(size=(2, 3))
    assert_allclose(cross(a, b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_pitch_of_a_joint_that_is_not_helical_is_refused(kind):
    with pytest.raises(ValueError, match=f"pitch 0.1 m/rad of a {kind} joint, expected 0"):
        Joint(kind, np.eye(4), 0.1)


def test_skew_times_a_vector_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 7, 3))
    assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("kind", ["rigid", "Revolute", ""])
def test_an_unknown_kind_is_refused_with_the_known_ones_named(kind):
    with pytest.raises(ValueError, match=r"expected one of \['helical', 'prismatic', 'revolute'\]"):
        Joint(kind, np.eye(4), 0.0)


@pytest.mark.parametrize("kind", list(JointKind))
def test_points_go_where_their_velocity_says(kind):
    """Central differences of the motion, at a state that is not zero."""
    T = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.7, 1.2), np.array([0.4, -0.2, 0.7])).matrix()
    joint = Joint(kind, T, 0.13 if kind.has_pitch else 0.0)
    x, q, step = np.array([[0.1, 0.5, -0.3], [1.0, 0.0, 0.2]]), 0.8, 1e-6
    R, t = joint.motion(np.array([q - step, q, q + step]))
    before, now, after = (x @ R[k].T + t[k] for k in range(3))
    assert_allclose(joint.velocity(now), (after - before) / (2 * step), atol=1e-8)
