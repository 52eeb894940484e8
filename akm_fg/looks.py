"""One moment as a robot knows it: a frame, and where its gripper was."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam

from akm_fg.records import RgbdFrame


@dataclass(frozen=True, slots=True)
class Look:
    """What is known of one moment."""

    frame: RgbdFrame
    T_world_gripper: gtsam.Pose3
    holding: bool  # something was between the closed fingers
