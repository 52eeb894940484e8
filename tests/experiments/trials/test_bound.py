"""The bound against a case by hand and against brute force."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.trials.bound import Bound, cramer_rao_bound
from experiments.trials.cells import table_cells
from experiments.trials.openings import make_opening

# Issue 3's column "bound, clean": median axis error, degrees.
STATED_DEG = {
    "door 5 deg": 1.9,
    "door 15 deg": 0.60,
    "door 40 deg": 0.22,
    "drawer 5 cm": 0.46,
    "drawer 15 cm": 0.15,
    "drawer 40 cm": 0.06,
}


@pytest.mark.parametrize("wild_share", [0.0, 0.25])
def test_bound_of_a_drawer_is_the_one_worked_on_paper(wild_share):
    """var w = sigma^2 / (N sum (q - mean q)^2); var q_t = 2 sigma^2 / N; drifting tracks aside."""
    opening = make_opening(0, "prismatic", points=40, wild_share=wild_share)
    N, q = 40 * (1 - wild_share), opening.q
    bound = cramer_rao_bound(opening)
    assert_allclose(
        bound.cov_line, np.eye(2) * 9e-6 / (N * ((q - q.mean()) ** 2).sum()), atol=1e-12
    )
    assert_allclose(bound.var_states, 2 * 9e-6 / N)


def _prediction(opening, xi, q, rest):
    """Points (T, N, 3), the joint moved by a tangent (6,) at the axis point next to the points."""
    T0 = gtsam.Pose3(opening.T_world_joint)
    along = T0.matrix()[:3, :3].T @ (opening.rest_world.mean(axis=0) - T0.translation())
    shift = along if opening.kind == "prismatic" else along * np.array([0, 0, 1.0])
    T = T0 * gtsam.Pose3(gtsam.Rot3(), shift) * gtsam.Pose3.Expmap(xi)
    S = np.eye(6)[2 if opening.kind == "revolute" else 5]
    moves = [(T * gtsam.Pose3.Expmap(state * S) * T.inverse()).matrix() for state in q]
    return np.array([rest @ M[:3, :3].T + M[:3, 3] for M in moves])


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("correlation_m", [0.0, 0.07])
def test_bound_is_that_of_the_full_problem_with_all_points_unknown(kind, correlation_m):
    """Every parameter, latent points too, differentiated numerically; no marginalisation."""
    opening = make_opening(1, kind, points=6, frames=4, correlation_m=correlation_m)
    line = [0, 1, 3, 4] if kind == "revolute" else [0, 1]
    free = len(line) + 3 + 18

    def predicted(theta):
        xi = np.zeros(6)
        xi[line] = theta[: len(line)]
        q = opening.q + np.concatenate([[0.0], theta[len(line) : len(line) + 3]])
        rest = opening.rest_world + theta[len(line) + 3 :].reshape(6, 3)
        return _prediction(opening, xi, q, rest).ravel()

    h = 1e-5 * np.eye(free)
    J = np.column_stack([(predicted(d) - predicted(-d)) / 2e-5 for d in h])
    cov = np.kron(np.kron(np.eye(4), opening.cov_points), np.eye(3))
    full = np.linalg.inv(J.T @ np.linalg.solve(cov, J))
    bound = cramer_rao_bound(opening)
    n = len(line)
    assert_allclose(bound.cov_line, full[:n, :n], rtol=1e-3, atol=1e-4 * full[:n, :n].max())
    assert_allclose(bound.var_states, np.diag(full)[n : n + 3], rtol=1e-3)


def test_bound_of_the_twelve_cells_is_the_one_the_issue_states():
    for cell in table_cells()[:6]:
        bounds = [cramer_rao_bound(cell.opening(seed)) for seed in range(15)]
        median = np.degrees(np.median([bound.median_axis_error_rad for bound in bounds]))
        assert_allclose(median, STATED_DEG[cell.travel_name], rtol=0.15)


def test_share_inside_of_a_drawer_is_rayleighs():
    bound = Bound(np.eye(2) * 0.01**2, np.ones(3))
    share = bound.share_inside(0.012, 0.0, np.random.default_rng(0), draws=20_000)
    assert_allclose(share, 1 - np.exp(-0.5 * 1.2**2), atol=0.01)
    assert_allclose(bound.median_axis_error_rad, 0.01 * np.sqrt(2 * np.log(2)), rtol=1e-3)


def test_share_inside_of_a_hinge_asks_for_the_distance_between_the_lines():
    """Axis error along x alone: the common normal is x, and only errors of the pivot in x count."""
    cov = np.diag([1e-4, 1e-14, 0.01, 1.0]) ** 2
    share = Bound(cov, np.ones(1)).share_inside(1.0, 0.01, np.random.default_rng(0), draws=20_000)
    assert_allclose(share, 0.6827, atol=0.01)


def test_twice_the_noise_is_four_times_the_variance():
    opening = make_opening(2, "revolute")
    doubled = replace(opening, cov_points=4 * opening.cov_points)
    assert_allclose(cramer_rao_bound(doubled).cov_line, 4 * cramer_rao_bound(opening).cov_line)
