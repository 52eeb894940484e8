"""Gauge factor: it fixes exactly what no measurement can fix, and nothing else."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import numeric_jacobian
from factors.joint import Joint, JointKind
from factors.measurements.track_cost import track_cost
from factors.measurements.track_information import track_normal_equations
from factors.priors.gauge import SIGMA, gauge_factor

TANGENT = ("wx", "wy", "wz", "vx", "vy", "vz")
CENTROID = np.array([0.4, -0.2, 1.1])
# Turn of the joint frame from the heading to keep; at exactly pi the logarithm jumps.
TURNS = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-9, -1e-7, 1e-6]),
    "generic": np.array([0.4, -0.9, 0.6]),
    "pi": (np.pi - 1e-3) * np.array([0.6, 0.0, 0.8]),
}
REFERENCE = gtsam.Rot3.Expmap(np.array([0.3, 0.2, -0.7]))


def _values(turn, origin=(0.2, -0.5, 0.9)):
    values = gtsam.Values()
    R = REFERENCE.compose(gtsam.Rot3.Expmap(np.asarray(turn, dtype=float)))
    values.insert(0, gtsam.Pose3(R, np.array(origin, dtype=float)))
    return values


def _jacobian(kind, values):
    A, _ = gauge_factor(kind, 0, REFERENCE, CENTROID).linearize(values).jacobian()
    return A * SIGMA


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS.keys())
def test_jacobian_matches_differences(kind, turn):
    values = _values(turn)
    numeric = numeric_jacobian(gauge_factor(kind, 0, REFERENCE, CENTROID), values, [6])
    assert_allclose(_jacobian(kind, values), numeric, atol=1e-7)


def test_error_vanishes_with_heading_kept_and_origin_at_the_centroid(kind):
    factor = gauge_factor(kind, 0, REFERENCE, CENTROID)
    assert_allclose(factor.error(_values(np.zeros(3), CENTROID)), 0.0, atol=1e-12)


def test_hinge_a_metre_beside_the_centroid_is_where_it_should_be_and_a_drawer_is_not():
    beside = CENTROID + REFERENCE.matrix()[:, 0]
    values = _values(np.zeros(3), beside)
    hinge = gauge_factor("revolute", 0, REFERENCE, CENTROID)
    drawer = gauge_factor("prismatic", 0, REFERENCE, CENTROID)
    assert_allclose(hinge.unwhitenedError(values), [0.0, 0.0], atol=1e-12)
    assert_allclose(drawer.unwhitenedError(values), [0.0, -1.0, 0.0, 0.0], atol=1e-12)


def test_slide_of_ten_centimetres_and_turn_of_a_fifth_are_the_error():
    slid = CENTROID + 0.1 * REFERENCE.matrix()[:, 2]
    hinge = gauge_factor("revolute", 0, REFERENCE, CENTROID)
    assert_allclose(hinge.unwhitenedError(_values([0, 0, 0.2], slid)), [0.2, -0.1], atol=1e-12)


def test_every_gauge_direction_is_fixed_and_no_other_is_measured(kind):
    """As many rows as gauge directions, and these alone already fill them."""
    J = _jacobian(kind, _values(TURNS["near zero"]))
    gauge = [TANGENT.index(name) for name in JointKind(kind).gauge]
    assert J.shape[0] == len(gauge)
    assert np.linalg.svd(J[:, gauge])[1].min() > 0.5


def test_gauge_directions_are_exactly_those_the_tracks_leave_open(kind, scene):
    s = scene(kind)
    cost = track_cost(Joint(kind, s.T_world_joint, s.pitch), s.q, s.tracks, 6.0, 1.0)
    H, _ = track_normal_equations(Joint(kind, np.eye(4), s.pitch), s.q, cost)
    diagonal = np.diag(H)[:6]
    open_directions = [TANGENT[i] for i in range(6) if diagonal[i] < 1e-10 * diagonal.max()]
    assert tuple(open_directions) == JointKind(kind).gauge


@pytest.mark.parametrize("centroid", [[0.0, 1.0], [0.0, np.nan, 1.0], [np.inf, 0, 0], 3.0])
def test_a_centroid_that_is_not_three_finite_numbers_is_refused(centroid):
    with pytest.raises(ValueError, match="expected three finite numbers"):
        gauge_factor("revolute", 0, REFERENCE, np.array(centroid))


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="joint kind 'rigid'"):
        gauge_factor("rigid", 0, REFERENCE, CENTROID)
