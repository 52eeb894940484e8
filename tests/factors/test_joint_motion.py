"""Joint kinematics: every motion against GTSAM's own exponential, every derivative numerically."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import central_difference
from factors.joint_motion import (
    adjoint_of_return,
    joint_displacement,
    part_motion,
    reference_coordinates,
    skew,
    unit_twist,
)


def _reference(s, T_world_joint, q):
    return reference_coordinates(s.kind, T_world_joint, q, s.p_world.swapaxes(1, 2))


def test_door_opened_by_a_quarter_turn_moves_the_handle_from_x_to_y():
    R, t = part_motion("revolute", np.eye(4), np.array([np.pi / 2]))
    assert_allclose(R[0] @ [0.7, 0.0, 1.0] + t[0], [0.0, 0.7, 1.0], atol=1e-15)


def test_door_hinged_at_its_edge_swings_about_that_edge():
    hinge = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0])).matrix()
    R, t = part_motion("revolute", hinge, np.array([np.pi / 2]))
    assert_allclose(R[0] @ [1.5, 0.0, 0.2] + t[0], [1.0, 0.5, 0.2], atol=1e-15)


def test_drawer_pulled_by_ten_centimetres_moves_along_the_joint_axis():
    sideways = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([4.0, 5.0, 6.0])).matrix()
    R, t = part_motion("prismatic", sideways, np.array([0.1]))
    assert_allclose(R[0], np.eye(3), atol=1e-15)
    assert_allclose(t[0], [0.1, 0.0, 0.0], atol=1e-15)


def test_joint_displacement_is_the_exponential_of_the_unit_twist(kind, case, scene):
    q = scene(kind, case).q
    rotations, translations = joint_displacement(kind, q)
    for t, state in enumerate(q):
        want = gtsam.Pose3.Expmap(state * unit_twist(kind))
        assert_allclose(rotations[t], want.rotation().matrix(), atol=1e-12)
        assert_allclose(translations[t], want.translation(), atol=1e-12)


def test_part_motion_is_the_displacement_seen_from_the_world(kind, case, scene):
    s = scene(kind, case)
    joint = gtsam.Pose3(s.T_world_joint)
    R, t = part_motion(kind, s.T_world_joint, s.q)
    for k, state in enumerate(s.q):
        want = joint * gtsam.Pose3.Expmap(state * unit_twist(kind)) * joint.inverse()
        assert_allclose(R[k], want.rotation().matrix(), atol=1e-12)
        assert_allclose(t[k], want.translation(), atol=1e-12)


def test_at_the_truth_a_point_has_the_same_reference_coordinates_in_every_frame(kind, case, scene):
    s = scene(kind, case, sigma=0)
    z = _reference(s, s.T_world_joint, s.q)
    assert_allclose(z, np.broadcast_to(s.x_joint.T, z.shape), atol=1e-12)


def test_adjoint_of_return_is_that_of_the_inverse_displacement(kind, case, scene):
    q = scene(kind, case).q
    want = [gtsam.Pose3.Expmap(-state * unit_twist(kind)).AdjointMap() for state in q]
    assert_allclose(adjoint_of_return(kind, q), want, atol=1e-12)


def test_twist_jacobian_of_reference_coordinates_matches_differences(kind, case, scene):
    s = scene(kind, case)
    z = _reference(s, s.T_world_joint, s.q)

    def moved(xi):
        T = gtsam.Pose3(s.T_world_joint).compose(gtsam.Pose3.Expmap(xi)).matrix()
        return _reference(s, T, s.q).ravel()

    numeric = central_difference(moved, np.zeros(6)).reshape(*z.shape, 6)
    G = np.concatenate([skew(z.swapaxes(1, 2)), np.tile(-np.eye(3), (*z.shape[::2], 1, 1))], -1)
    analytic = np.einsum("tnij,tjk->tink", G, adjoint_of_return(kind, s.q))
    assert_allclose(analytic, numeric, atol=1e-8)


def test_state_jacobian_of_reference_coordinates_matches_differences(kind, case, scene):
    s = scene(kind, case)
    z = _reference(s, s.T_world_joint, s.q)

    def moved(dq):
        return _reference(s, s.T_world_joint, s.q + dq[0]).ravel()

    numeric = central_difference(moved, np.zeros(1)).reshape(z.shape)
    S = unit_twist(kind)
    analytic = np.cross(z, S[:3], axisa=1, axisb=0, axisc=1) - S[3:, None]
    assert_allclose(analytic, numeric, atol=1e-8)


def test_skew_times_a_vector_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 7, 3))
    assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("kind", ["rigid", "Revolute", ""])
def test_an_unknown_kind_is_refused_with_the_known_ones_named(kind):
    with pytest.raises(ValueError, match=r"expected one of \['helical', 'prismatic', 'revolute'\]"):
        unit_twist(kind)
