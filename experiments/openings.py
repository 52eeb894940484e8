"""Openings of a flat panel whose joint is known exactly, and how far an estimate is from it.

The data of the accuracy and calibration experiments, and of the estimator's tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.estimation.posterior import ArticulationPosterior
from akm_fg.records import PointTracks

PANEL_M, SIGMA_M, DRIFT_M = 0.4, 0.003, 0.02


@dataclass(frozen=True)
class Opening:
    """A panel opened by a hinge at its edge, or pulled along its normal."""

    kind: str
    T_world_joint: np.ndarray  # (4, 4), z along the axis
    q: np.ndarray  # (T,), zero in frame 0
    tracks: PointTracks
    wild: np.ndarray  # (N,) tracks that drift away on their own

    @property
    def axis(self) -> np.ndarray:
        """(3,) the true axis; the state grows along it."""
        return self.T_world_joint[:3, 2]


def _moved(kind: str, T_world_joint: np.ndarray, q: float, p_world: np.ndarray) -> np.ndarray:
    """Points (N, 3) at state zero taken to state q, by GTSAM's own group operations."""
    S = np.array([0, 0, 1, 0, 0, 0] if kind == "revolute" else [0, 0, 0, 0, 0, 1], dtype=float)
    joint = gtsam.Pose3(T_world_joint)
    motion = (joint * gtsam.Pose3.Expmap(q * S) * joint.inverse()).matrix()
    return p_world @ motion[:3, :3].T + motion[:3, 3]


def make_opening(
    seed: int,
    kind: str = "revolute",
    travel: float | None = None,
    points: int = 40,
    frames: int = 20,
    noise_m: float = SIGMA_M,
    wild_share: float = 0.0,
    steady: bool = False,
) -> Opening:
    """Points uniform on the panel, states uniform along the travel (or steadily growing).

    Args:
        seed: of everything random, the pose of the panel in the world included.
        kind: revolute (upright, along the panel's edge) or prismatic (along its normal).
        travel: radians or metres.
        points: N.
        frames: T.
        noise_m: standard deviation of every coordinate; the tracks always claim 3 mm.
        wild_share: of the tracks that drift by 2 cm a frame, each in a direction of its own.
        steady: states in even steps.
    """
    rng = np.random.default_rng(seed)
    travel = travel if travel is not None else {"revolute": 0.5, "prismatic": 0.15}[kind]
    panel = np.zeros((points, 3))
    panel[:, [0, 2]] = rng.uniform(-PANEL_M / 2, PANEL_M / 2, (points, 2))
    if kind == "revolute":  # upright, along the panel's left edge
        T_panel_joint = gtsam.Pose3(gtsam.Rot3(), np.array([-PANEL_M / 2, 0.0, 0.0]))
    else:  # along the panel's normal
        T_panel_joint = gtsam.Pose3(gtsam.Rot3.Rx(-np.pi / 2), np.zeros(3))
    T_world_panel = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3), rng.normal(size=3) / 2]))
    T_world_joint = (T_world_panel * T_panel_joint).matrix()
    p_world = np.array([T_world_panel.transformFrom(p) for p in panel])
    q = np.linspace(0, travel, frames)
    if not steady:
        q[1:] = rng.uniform(0, travel, frames - 1)
    p = np.array([_moved(kind, T_world_joint, state, p_world) for state in q])
    p += noise_m * rng.normal(size=p.shape)
    wild = np.arange(points) < round(wild_share * points)
    direction = rng.normal(size=(points, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    p += DRIFT_M * np.arange(frames)[:, None, None] * direction * wild[:, None]
    cov = np.tile(SIGMA_M**2 * np.eye(3), (frames, points, 1, 1))
    return Opening(kind, T_world_joint, q, PointTracks(p, cov), wild)


@dataclass(frozen=True)
class Score:
    """How far a posterior's joint and states are from the truth."""

    axis_error_rad: float  # sign of the axis counts
    pivot_error_m: float  # of the true axis line from the estimated pivot; 0 for prismatic
    state_error: np.ndarray  # (T,)
    nees: float  # of the joint, over its directions that are not gauge
    dimensions: int


def score_opening(posterior: ArticulationPosterior, opening: Opening) -> Score:
    """Score the fit of the true kind. The true axis line, seen from the estimate, is xi."""
    fit = posterior.alternatives[opening.kind]
    T_est_true = np.linalg.inv(fit.joint.T_world_joint) @ opening.T_world_joint
    d, o = T_est_true[:3, 2], T_est_true[:3, 3]
    crossing = o - d * o[2] / d[2]
    xi = np.array([-d[1], d[0], crossing[0], crossing[1]])
    directions = [0, 1, 3, 4] if opening.kind == "revolute" else [0, 1]
    xi = xi[: len(directions)]
    cov = fit.joint.cov[np.ix_(directions, directions)]
    return Score(
        axis_error_rad=float(np.arctan2(np.hypot(d[0], d[1]), d[2])),
        pivot_error_m=float(np.hypot(*crossing[:2])) if opening.kind == "revolute" else 0.0,
        state_error=fit.states.mean - opening.q,
        nees=float(xi @ np.linalg.pinv(cov) @ xi),
        dimensions=len(directions),
    )
