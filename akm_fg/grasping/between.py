"""How far two grasps are from each other."""

from __future__ import annotations

import gtsam
import numpy as np


def between(one: gtsam.Pose3, other: gtsam.Pose3) -> tuple[float, float]:
    """Metres and radians from one pose of the hand to another."""
    T = one.between(other)
    turn = gtsam.Rot3.Logmap(T.rotation())
    return float(np.linalg.norm(T.translation())), float(np.linalg.norm(turn))
