"""Coordinates of joints near a solved one in which a vague posterior is nearly Gaussian.

The tangent of T_world_joint counts a hinge's place in metres, but what tracks say of it is its
distance from the part times a factor: a short, noisy opening leaves a log-normal. Coordinates
here, at a joint whose x axis points from the part's middle to the hinge:

    tilt of the axis about x and y (rad), [log distance over that of the solved joint, bearing of
    the hinge about the axis (rad), [pitch over that of the solved joint (m/rad)]].

To first order they are the tangent's wx, wy, vx / distance, vy / distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.estimation.given.motion_fit import nearest_origin
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.records import FloatArray
from factors.joint import Joint, JointKind, skew

# Widths of Gaussians whose integral is that of the flat priors: 2 pi of a half sphere's solid
# angle, 2 pi of bearings. Distance and pitch have proper priors of their own.
_TILT_RAD, _BEARING_RAD = 1.0, np.sqrt(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Joints:
    """S joints of one kind."""

    axis: FloatArray  # (S, 3) unit, world
    point: FloatArray  # (S, 3) of the axis, world
    distance: FloatArray  # (S,) of a hinge from the part's middle; 1 for prismatic
    pitch: FloatArray  # (S,)
    turns: bool  # whether the part turns

    def unit_twists(self) -> FloatArray:
        """(S, 6) of the part per unit of arc, rotation first, world axes."""
        if not self.turns:
            return np.concatenate([np.zeros_like(self.axis), self.axis], axis=1)
        along = np.cross(self.point, self.axis) + self.pitch[:, None] * self.axis
        return np.concatenate([self.axis, along], axis=1) / self.distance[:, None]

    def motions(self, arcs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (S, T, 3, 3) and translations (S, T, 3) of the part at arcs (S, T), metres.

        About an axis that does not go through the origin.
        """
        if not self.turns:
            return np.broadcast_to(np.eye(3), (*arcs.shape, 3, 3)), arcs[..., None] * self.axis[
                :, None
            ]
        q = arcs / self.distance[:, None]
        R = _turns(self.axis, q)
        t = self.point[:, None] - np.einsum("stij,sj->sti", R, self.point)
        return R, t + (self.pitch[:, None] * q)[..., None] * self.axis[:, None]


@dataclass(frozen=True, slots=True)
class JointChart:
    """The coordinates at one solved joint."""

    kind: JointKind
    R_world_joint: FloatArray  # (3, 3); x points from the part's middle to the hinge
    centroid_world: FloatArray  # (3,) of the part
    distance: float  # of the hinge from there; 1 for prismatic
    pitch: float

    @classmethod
    def at(cls, joint: Joint, centroid_world: FloatArray) -> JointChart:
        """At a joint."""
        T, distance = nearest_origin(joint, centroid_world)
        return cls(joint.kind, T[:3, :3], centroid_world, distance, joint.pitch)

    @property
    def turns(self) -> bool:
        """Whether the part turns."""
        return self.kind.turns

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.kind.coordinates

    def covariance(self, fit: KindFit) -> FloatArray:
        """The fit's own covariance in these coordinates, (k, k)."""
        k, T_world_joint = self.size, fit.moving.T_world_joint
        J = self.by_tangent(T_world_joint[:3, :3])
        return J @ fit.cov[:k, :k] @ J.T

    def by_tangent(self, R_world_joint: FloatArray) -> FloatArray:
        """(k, k) coordinates by the tangent of a joint's frame with the axis of this one."""
        return self._by_tangent(self.R_world_joint[:, :2].T @ R_world_joint[:, :2], self.distance)

    def _by_tangent(self, turn: FloatArray, distance: float) -> FloatArray:
        """(k, k) coordinates by the tangent of a frame that is turned about z against this one."""
        J = np.eye(self.size)
        J[:2, :2] = turn
        if self.turns:
            J[2:4, 2:4] = turn / distance
        return J

    def joints(self, u: FloatArray) -> Joints:
        """The joints at coordinates u (S, k)."""
        R = self.R_world_joint @ _tilts(u[:, :2])
        if not self.turns:
            ones = np.ones(len(u))
            place = np.broadcast_to(self.centroid_world, (len(u), 3))
            return Joints(R[:, :, 2], place, ones, 0 * ones, turns=False)
        distance = self.distance * np.exp(u[:, 2])
        towards = np.cos(u[:, 3])[:, None] * R[:, :, 0] + np.sin(u[:, 3])[:, None] * R[:, :, 1]
        pitch = self.pitch + (u[:, 4] if self.kind.has_pitch else np.zeros(len(u)))
        point = self.centroid_world + distance[:, None] * towards
        return Joints(R[:, :, 2], point, distance, pitch, turns=True)

    def frame(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """T_world_joint (4, 4) at coordinates u (k,), and its tangent by the coordinates (k, k)."""
        T = np.eye(4)
        turn = gtsam.Rot3.Rz(u[3] if self.turns else 0.0).matrix()
        T[:3, :3] = self.R_world_joint @ _tilts(u[None, :2])[0] @ turn
        distance = self.distance * float(np.exp(u[2])) if self.turns else 1.0
        T[:3, 3] = self.centroid_world + (distance * T[:3, 0] if self.turns else 0.0)
        by_tangent = self._by_tangent(np.eye(2), distance)
        by_tangent[:2, :2] = turn[:2, :2]
        return T, np.asarray(np.linalg.inv(by_tangent))


def widest_information(joint: Joint, centroid_world: FloatArray) -> FloatArray:
    """Information (k, k) on a joint's coordinates that its flat priors are worth, tangent order.

    A Gaussian of so much information has, at its peak density, the integral of the flat prior of
    axis direction and bearing: what is known of a joint is never less.
    """
    chart = JointChart.at(joint, centroid_world)
    flat = np.zeros(chart.size)
    flat[:2] = _TILT_RAD**-2
    if joint.kind.turns:
        flat[3] = _BEARING_RAD**-2
    J = chart.by_tangent(joint.R_world_joint)
    return np.asarray(J.T @ (flat[:, None] * J))


def _tilts(tilt: FloatArray) -> FloatArray:
    """Rotations (S, 3, 3) about axes across z, rotation vectors (S, 2)."""
    angle = np.linalg.norm(tilt, axis=1)
    axis = np.pad(tilt / np.maximum(angle, 1e-12)[:, None], ((0, 0), (0, 1)))
    return _turns(axis, angle[:, None])[:, 0]


def _turns(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations (S, T, 3, 3) about unit axes (S, 3) by angles (S, T): Rodrigues' formula."""
    K = skew(axis)[:, None]
    sine, versine = np.sin(angle)[..., None, None], (1 - np.cos(angle))[..., None, None]
    turns: FloatArray = np.eye(3) + sine * K + versine * (K @ K)
    return turns
