"""Openings of a flat panel whose joint is known exactly, and how far an estimate is from it.

The data of the accuracy and calibration experiments, and of the estimator's tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import gtsam
import numpy as np

from akm_fg.geometry.lines import line_in_joint_frame
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, FloatArray, JointTruth, KindName, PointTracks
from factors.joint import Joint, JointKind

PANEL_M, SIGMA_M, DRIFT_M = 0.4, 0.003, 0.02
_OWN_SHARE = 1e-6  # of the variance of correlated noise: keeps the correlation matrix regular


@dataclass(frozen=True)
class Opening:
    """A panel opened by a hinge at its edge, or pulled along its normal."""

    kind: str
    T_world_joint: FloatArray  # (4, 4), z along the axis
    q: FloatArray  # (T,), zero in frame 0
    tracks: PointTracks
    wild: BoolArray  # (N,) tracks that drift away on their own
    rest_world: FloatArray  # (N, 3) where the points are at state zero
    cov_points: FloatArray  # (N, N) m^2, noise of one coordinate in one frame

    @property
    def axis(self) -> FloatArray:
        """(3,) the true axis; the state grows along it."""
        return self.T_world_joint[:3, 2]

    @property
    def T_world_panel(self) -> gtsam.Pose3:
        """The panel at state zero: x across, y along its normal, z up, its middle the origin."""
        return gtsam.Pose3(self.T_world_joint) * _panel_joint(self.kind).inverse()

    @property
    def joint(self) -> Joint:
        """The true joint."""
        return Joint(JointKind(self.kind), self.T_world_joint, 0.0)

    @property
    def truth(self) -> JointTruth:
        """The joint as recordings give it."""
        pivot = self.T_world_joint[:3, 3] if self.kind == "revolute" else None
        return JointTruth(cast(KindName, self.kind), self.axis, pivot, self.q)


def _moved(kind: str, T_world_joint: FloatArray, q: float, p_world: FloatArray) -> FloatArray:
    """Points (N, 3) at state zero taken to state q, by GTSAM's own group operations."""
    S = np.array([0, 0, 1, 0, 0, 0] if kind == "revolute" else [0, 0, 0, 0, 0, 1], dtype=float)
    joint = gtsam.Pose3(T_world_joint)
    motion = (joint * gtsam.Pose3.Expmap(q * S) * joint.inverse()).matrix()
    return p_world @ motion[:3, :3].T + motion[:3, 3]


def make_opening(
    seed: int | Sequence[int],
    kind: str = "revolute",
    travel: float | None = None,
    points: int = 40,
    frames: int = 20,
    noise_m: float = SIGMA_M,
    wild_share: float = 0.0,
    steady: bool = False,
    claimed_m: float = SIGMA_M,
    correlation_m: float = 0.0,
) -> Opening:
    """Points uniform on the panel, states uniform along the travel (or steadily growing).

    Args:
        seed: of everything random, the pose of the panel in the world included.
        kind: revolute (upright, along the panel's edge) or prismatic (along its normal).
        travel: radians or metres.
        points: N.
        frames: T.
        noise_m: standard deviation of every coordinate.
        wild_share: of the tracks that drift by 2 cm a frame, each in a direction of its own.
        steady: states in even steps.
        claimed_m: standard deviation that the tracks claim.
        correlation_m: of `spatial_correlation`; 0 for independent noise.
    """
    rng = np.random.default_rng(seed)
    travel = travel if travel is not None else {"revolute": 0.5, "prismatic": 0.15}[kind]
    panel = rng.uniform(-PANEL_M / 2, PANEL_M / 2, (points, 2)) @ np.eye(3)[[0, 2]]
    T_world_panel = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3), rng.normal(size=3) / 2]))
    T_world_joint = (T_world_panel * _panel_joint(kind)).matrix()
    p_world = np.array([T_world_panel.transformFrom(p) for p in panel])
    q = np.linspace(0, travel, frames)
    if not steady:
        q[1:] = rng.uniform(0, travel, frames - 1)
    p = np.array([_moved(kind, T_world_joint, state, p_world) for state in q])
    correlation = spatial_correlation(panel, correlation_m)
    p += noise_m * np.linalg.cholesky(correlation) @ rng.normal(size=p.shape)
    wild = np.arange(points) < round(wild_share * points)
    p += _drift(rng, frames, wild)
    tracks = PointTracks(p, np.tile(claimed_m**2 * np.eye(3), (frames, points, 1, 1)))
    return Opening(kind, T_world_joint, q, tracks, wild, p_world, noise_m**2 * correlation)


def spatial_correlation(p: FloatArray, length_m: float) -> FloatArray:
    """Correlations (N, N) of a Gaussian random field at points (N, 3): exp(-d^2 / (2 length^2)).

    A millionth of the variance is each point's own, so that the matrix has an inverse.
    """
    if length_m <= 0:
        return np.eye(len(p))
    d2 = ((p[:, None] - p[None]) ** 2).sum(axis=-1)
    return (1 - _OWN_SHARE) * np.exp(-0.5 * d2 / length_m**2) + _OWN_SHARE * np.eye(len(p))


def _panel_joint(kind: str) -> gtsam.Pose3:
    """T_panel_joint: upright along the panel's left edge, or along its normal."""
    if kind == "revolute":
        return gtsam.Pose3(gtsam.Rot3(), np.array([-PANEL_M / 2, 0.0, 0.0]))
    return gtsam.Pose3(gtsam.Rot3.Rx(-np.pi / 2), np.zeros(3))


def _drift(rng: np.random.Generator, frames: int, wild: BoolArray) -> FloatArray:
    """(T, N, 3) how far the wild tracks are off; each goes its own way."""
    direction = rng.normal(size=(wild.size, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return DRIFT_M * np.arange(frames)[:, None, None] * direction * wild[:, None]


@dataclass(frozen=True)
class Score:
    """How far a posterior's joint and states are from the truth."""

    axis_error_rad: float  # sign of the axis counts
    pivot_error_m: float  # of the true axis line from the estimated pivot; 0 for prismatic
    state_error: FloatArray  # (T,)
    nees: float  # of the joint, over its directions that are not gauge
    dimensions: int


def score_opening(posterior: ArticulationPosterior, opening: Opening) -> Score:
    """Score the fit of the true kind."""
    fit = posterior.alternatives[opening.kind]
    assert fit.joint is not None and fit.states is not None
    xi = line_in_joint_frame(fit.joint.T_world_joint, opening.axis, opening.T_world_joint[:3, 3])
    directions = [0, 1, 3, 4] if opening.kind == "revolute" else [0, 1]
    xi = xi[directions]
    cov = fit.joint.cov[np.ix_(directions, directions)]
    cosine = float(fit.joint.axis @ opening.axis)
    return Score(
        axis_error_rad=float(
            np.arctan2(np.linalg.norm(np.cross(fit.joint.axis, opening.axis)), cosine)
        ),
        pivot_error_m=float(np.hypot(xi[2], xi[3])) if opening.kind == "revolute" else 0.0,
        state_error=fit.states.mean - opening.q,
        nees=float(xi @ np.linalg.pinv(cov) @ xi),
        dimensions=len(directions),
    )
