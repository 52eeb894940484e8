"""A person's hand that holds the part and rides along. FOR GENERATING DATA ONLY.

It is seen and measured like anything else: unlike the robot's, its pixels are not taken out. Sizes
are those of an adult's hand and forearm.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from sim.bullet import p, quaternion_xyzw
from sim.world import SimWorld

SKIN_RGBA = (0.78, 0.58, 0.47, 1.0)
SLEEVE_RGBA = (0.22, 0.26, 0.38, 1.0)


@dataclass(frozen=True, slots=True)
class _Piece:
    half_m: tuple[float, float, float]  # along the bar, across it, along the approach
    at_m: tuple[float, float, float]  # in the grip's frame, z the way the hand comes
    rgba: tuple[float, float, float, float]


PIECES = (
    _Piece((0.042, 0.009, 0.030), (0.0, 0.018, -0.005), SKIN_RGBA),  # fingers, on one side
    _Piece((0.012, 0.009, 0.025), (-0.01, -0.018, -0.005), SKIN_RGBA),  # the thumb, on the other
    _Piece((0.045, 0.016, 0.045), (0.0, 0.0, -0.080), SKIN_RGBA),  # the palm
    _Piece((0.035, 0.030, 0.120), (0.0, 0.0, -0.240), SLEEVE_RGBA),  # the forearm
)


class RidingHand:
    """Boxes that follow the grip."""

    def __init__(self, world: SimWorld) -> None:
        """Puts a hand into the world; `show` places it."""
        self._world, self._bodies = world, []
        where = {"physicsClientId": world.client}
        for piece in PIECES:
            half = list(piece.half_m)
            look = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=piece.rgba, **where)
            self._bodies.append(p.createMultiBody(0.0, -1, look, **where))

    def show(self, T_world_grip: gtsam.Pose3) -> None:
        """At a pose of the grip, z the way the hand comes."""
        for body, piece in zip(self._bodies, PIECES, strict=True):
            T = T_world_grip * gtsam.Pose3(gtsam.Rot3(), np.array(piece.at_m))
            p.resetBasePositionAndOrientation(
                body,
                T.translation().tolist(),
                quaternion_xyzw(T.rotation()),
                physicsClientId=self._world.client,
            )
