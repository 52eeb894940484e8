"""The robot's own end effector, and the point between the fingertips that everything here means."""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.errors import ArmStopped
from akm_fg.hardware.franka.config import FrankaArmConfig
from akm_fg.hardware.franka.link import ArmState
from akm_fg.hardware.franka.straight import off_by


def checked_hand(
    state: ArmState, kinematics: FrankaKinematics, config: FrankaArmConfig
) -> gtsam.Pose3:
    """T_ee_gripper, from where the robot says its end effector is, and where its hand must be.

    Raises:
        ArmStopped: they are so far apart that another hand is mounted or set up.
    """
    T = state.T_world_ee
    T_world_ee = gtsam.Pose3(gtsam.Rot3.ClosestTo(T[:3, :3]), T[:3, 3])
    T_ee_gripper = T_world_ee.inverse() * kinematics.T_world_gripper(state.q)
    off_m, off_rad = off_by(T_ee_gripper.matrix(), gtsam.Pose3())
    if off_m > config.hand_off_m or off_rad > config.hand_off_rad:
        raise ArmStopped(
            f"the robot's end effector is {1e3 * off_m:.0f} mm and {np.rad2deg(off_rad):.0f} deg "
            "from where the Franka hand's fingertips are: set the Franka hand as end effector in "
            "Desk"
        )
    return T_ee_gripper
