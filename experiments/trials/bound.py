"""The Cramer-Rao bound of an opening: the least covariance that any unbiased estimate can have.

Measurement model: p_tn = T_world_joint Exp(q_t S) x_n + noise, Gaussian, of the true covariance,
alike in all coordinates; unknown are the axis line (four numbers, two for a drawer), q_1..q_T-1 and
every reference point x_n. Turned into the part's frame, the derivative by x_n is the identity in
every frame, so that marginalising x_n takes the mean over the frames off the other derivatives.
What is left is a matrix product: nothing here is shared with the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.posterior import radius_quantile
from akm_fg.records import FloatArray
from experiments.trials.openings import Opening

_MEDIAN_OF_ABS_NORMAL = 0.6745  # in standard deviations


@dataclass(frozen=True, slots=True)
class Bound:
    """Least covariances at the truth."""

    cov_line: FloatArray  # (4, 4) of (wx, wy, vx, vy), rad and m, joint frame; (2, 2) for drawers
    var_states: FloatArray  # (T - 1,) of the states after frame 0, rad^2 or m^2

    @property
    def axis_variance_rad2(self) -> float:
        """Mean square of the angle between true and estimated axis."""
        return float(np.trace(self.cov_line[:2, :2]))

    @property
    def pivot_variance_m2(self) -> float | None:
        """Mean square distance of the axis line from the pivot; None for a drawer."""
        return float(np.trace(self.cov_line[2:, 2:])) if len(self.cov_line) == 4 else None

    @property
    def median_axis_error_rad(self) -> float:
        """Of an estimate that reaches the bound."""
        return radius_quantile(self.cov_line[:2, :2], 0.5)

    @property
    def median_pivot_error_m(self) -> float | None:
        """Of an estimate that reaches the bound; None for a drawer."""
        return radius_quantile(self.cov_line[2:, 2:], 0.5) if len(self.cov_line) == 4 else None

    @property
    def median_last_state_error(self) -> float:
        """Of an estimate that reaches the bound."""
        return _MEDIAN_OF_ABS_NORMAL * float(np.sqrt(self.var_states[-1]))

    def share_inside(
        self, axis_rad: float, line_distance_m: float, rng: np.random.Generator, draws: int = 200
    ) -> float:
        """Share of estimates at the bound whose axis line is this near to the truth.

        Args:
            axis_rad: largest angle.
            line_distance_m: largest distance between the axis lines.
            rng: draws the estimates.
            draws: how many.
        """
        xi = rng.multivariate_normal(np.zeros(len(self.cov_line)), self.cov_line, draws)
        angle = np.linalg.norm(xi[:, :2], axis=1)
        inside = angle <= axis_rad
        if xi.shape[1] == 4:  # (vx, vy, 0) along the common normal, which is along (wx, wy, 0)
            distance = np.abs((xi[:, :2] * xi[:, 2:]).sum(axis=1)) / angle
            inside &= distance <= line_distance_m
        return float(inside.mean())


def cramer_rao_bound(opening: Opening) -> Bound:
    """The bound at the true parameters with the true noise; drifting tracks are left out."""
    used = ~opening.wild
    x_joint = _reference(opening, opening.rest_world[used])
    J = _centred_jacobian(opening.kind, opening.q, x_joint)
    whitened = np.linalg.solve(
        np.linalg.cholesky(opening.cov_points[np.ix_(used, used)]),
        J.transpose(1, 0, 2, 3).reshape(int(used.sum()), -1),
    ).reshape(-1, J.shape[-1])
    cov = np.linalg.inv(whitened.T @ whitened)
    line = 4 if opening.kind == "revolute" else 2
    return Bound(cov[:line, :line], np.diag(cov)[line:])


def _reference(opening: Opening, rest_world: FloatArray) -> FloatArray:
    """Points (N, 3) in the joint frame, its origin moved along the axis next to the centroid."""
    R, t = opening.T_world_joint[:3, :3], opening.T_world_joint[:3, 3]
    x_joint = (rest_world - t) @ R
    shift = np.array([0.0, 0.0, x_joint[:, 2].mean()])
    if opening.kind == "prismatic":
        shift = x_joint.mean(axis=0)
    return x_joint - shift


def _centred_jacobian(kind: str, q: FloatArray, x_joint: FloatArray) -> FloatArray:
    """(T, N, 3, line + T - 1): derivatives in the part's frame, their mean over frames taken off.

    A twist (w, v) of the joint frame moves a point y = Exp(q S) x by w x y + v; the state moves it
    by S. Both are then turned back by the part's rotation.
    """
    T, N = q.size, len(x_joint)
    line = 4 if kind == "revolute" else 2
    J = np.zeros((T, N, 3, line + T - 1))
    z = np.array([0.0, 0.0, 1.0])
    for t, state in enumerate(q):
        R, shift = np.eye(3), state * z
        if kind == "revolute":
            c, s = np.cos(state), np.sin(state)
            R, shift = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)
        y = x_joint @ R.T + shift
        for k in range(2):
            J[t, :, :, k] = np.cross(np.eye(3)[k], y) @ R
        if kind == "revolute":
            J[t, :, :, 2:4] = R.T[:, :2]
        if t > 0:
            J[t, :, :, line + t - 1] = np.cross(z, x_joint) if kind == "revolute" else z
    return J - J.mean(axis=0)
