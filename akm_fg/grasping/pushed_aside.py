"""Where a handle is, by how the hand that failed to hold it was pushed aside.

Fingers that close on the round end of a knob squeeze it out, and the hand to the other side: what
they met is where the hand no longer is.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np

from akm_fg.records import FloatArray

LEAST_M = 0.003  # of a push; a hand under no load stands so far from where it should at most
MOST_M = 0.012  # half a pad's width and a little: beyond it something else was met
NEAR_M = 0.03  # grasps nearer than that are of one place, and meet the same


@dataclass(slots=True)
class PushedAside:
    """What pushed the hand at which grasps, in an order of tries."""

    _places: list[tuple[gtsam.Pose3, FloatArray]] = field(default_factory=list)

    def failed(self, T_world_grasp: gtsam.Pose3, T_world_hand: gtsam.Pose3) -> None:
        """Take in a grasp that met nothing, and where the hand stood then.

        Args:
            T_world_grasp: as it was to be, corrected by what was told before.
            T_world_hand: as it was with its fingers closed.
        """
        x = T_world_grasp.rotation().matrix()[:, 0]  # the pads' width, along which things slip out
        off = T_world_hand.translation() - T_world_grasp.translation()
        pushed_m = float(off @ x)
        arrived = float(np.linalg.norm(off)) < NEAR_M
        if arrived and LEAST_M <= abs(pushed_m) <= MOST_M:
            self._places.append((T_world_grasp, -pushed_m * x))

    def corrected(self, T_world_grasp: gtsam.Pose3) -> gtsam.Pose3:
        """A grasp, moved to where what it is to hold must be."""
        T = T_world_grasp
        for place, shift in self._places:
            if np.linalg.norm(place.translation() - T.translation()) < NEAR_M:
                T = gtsam.Pose3(T.rotation(), T.translation() + shift)
        return T
