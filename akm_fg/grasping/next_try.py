"""Where to try again what a hand failed to hold, by where it stood with its fingers closed.

Fingers that close on the round end of a knob squeeze it out, and the hand to the other side: what
they met is where the hand no longer is. Fingers that were not pushed to a side, and met nothing,
ended before what they were to hold, as at the rim of a board: a little deeper it is between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np

from akm_fg.records import FloatArray

LEAST_M = 0.003  # of a push; a hand under no load stands so far from where it should at most
MOST_M = 0.012  # half a pad's width and a little: beyond it something else was met
NEAR_M = 0.03  # grasps nearer than that are of one place, and meet the same
DEEPER_M = 0.008  # a hand that feels its way is stopped where that is too deep
DEEPEST_M = 0.016


@dataclass(slots=True)
class NextTry:
    """What moved the hand at which grasps, in an order of tries."""

    _places: list[tuple[gtsam.Pose3, FloatArray]] = field(default_factory=list)

    def failed(self, T_world_grasp: gtsam.Pose3, T_world_hand: gtsam.Pose3) -> None:
        """Take in a grasp that met nothing, and where the hand stood then.

        Args:
            T_world_grasp: as it was to be, corrected by what was told before.
            T_world_hand: as it was with its fingers closed.
        """
        x, _, z = T_world_grasp.rotation().matrix().T
        off = T_world_hand.translation() - T_world_grasp.translation()
        pushed_m = float(off @ x)  # along the pads' width, where things slip out
        if np.linalg.norm(off) >= NEAR_M or abs(pushed_m) > MOST_M:
            return  # it did not get there
        if abs(pushed_m) >= LEAST_M:
            self._places.append((T_world_grasp, -pushed_m * x))
        elif sum(abs(float(shift @ z)) for _, shift in self._near(T_world_grasp)) < DEEPEST_M:
            self._places.append((T_world_grasp, DEEPER_M * z))

    def corrected(self, T_world_grasp: gtsam.Pose3) -> gtsam.Pose3:
        """A grasp, moved to where what it is to hold must be."""
        T = T_world_grasp
        for _, shift in self._near(T_world_grasp):
            T = gtsam.Pose3(T.rotation(), T.translation() + shift)
        return T

    def _near(self, T_world_grasp: gtsam.Pose3) -> list[tuple[gtsam.Pose3, FloatArray]]:
        p = T_world_grasp.translation()
        return [each for each in self._places if np.linalg.norm(each[0].translation() - p) < NEAR_M]
