"""The law of a straight line of the hand, until something is in the way."""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import rotation_vector
from akm_fg.arm.motion.reaching import line_motion
from akm_fg.hardware.franka.compliance import HandState, Reference
from akm_fg.hardware.franka.config import ApproachConfig
from akm_fg.records import FloatArray


class StraightLine:
    """From a point to another, turned as a goal is; `blocked_m` says whether it was stopped.

    What joint friction keeps the hand behind is made up for slowly, and only by so much: something
    that is in the way still shows as a lag.
    """

    def __init__(
        self,
        T_world_goal: gtsam.Pose3,
        start: FloatArray,
        end: FloatArray,
        speed_m_s: float,
        config: ApproachConfig,
        period_s: float,
    ) -> None:
        self._config, self._period_s = config, period_s
        length_m = float(np.linalg.norm(end - start))
        self._goal, self._start = T_world_goal.matrix(), start
        self._forward = (end - start) / max(length_m, 1e-9)
        self._way_m = np.array(list(line_motion(length_m, period_s, speed_m_s)))
        self._time_s = 0.0
        self._made_up = np.zeros(3)
        self.blocked_m: float | None = None  # before the goal, where something was in the way

    def __call__(self, hand: HandState, dt_s: float) -> Reference | None:
        """See Law."""
        c = self._config
        self._time_s += dt_s
        at = self._time_s / self._period_s
        ends = len(self._way_m) - 1
        way_m = float(np.interp(at, np.arange(ends + 1), self._way_m))
        speed = float(np.interp(at + 1, np.arange(ends + 1), self._way_m)) - way_m
        wanted = self._goal.copy()
        wanted[:3, 3] = self._start + way_m * self._forward
        lag = wanted[:3, 3] - hand.T_world_gripper[:3, 3]
        if self._forward @ lag > c.blocked_m:
            left = self._goal[:3, 3] - hand.T_world_gripper[:3, 3]
            self.blocked_m = float(self._forward @ left)
            return None
        if at >= ends and self._time_s - ends * self._period_s > c.settle_s:
            return None
        self._made_up += c.makeup_1_s * dt_s * lag
        length = float(np.linalg.norm(self._made_up))
        self._made_up *= min(1.0, c.makeup_max_m / max(length, 1e-9))
        wanted[:3, 3] += self._made_up
        return Reference(wanted, np.r_[speed / self._period_s * self._forward, np.zeros(3)])


def off_by(T_world_gripper: FloatArray, T_world_goal: gtsam.Pose3) -> tuple[float, float]:
    """How far a hand (4, 4) is from a goal, m, and by how much it is turned, rad."""
    goal = T_world_goal.matrix()
    turn = rotation_vector(goal[:3, :3] @ T_world_gripper[:3, :3].T)
    off_m = np.linalg.norm(T_world_gripper[:3, 3] - goal[:3, 3])
    return float(off_m), float(np.linalg.norm(turn))
