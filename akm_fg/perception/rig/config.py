"""All tuning of the checks on a rig."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.perception.rig.camera_motion import CameraMotionConfig
from akm_fg.perception.rig.depth_against_colour import DepthAgainstColourConfig
from akm_fg.perception.rig.gripper_place import GripperPlaceConfig


@dataclass(frozen=True, slots=True)
class RigConfig:
    """Camera, depth and gripper, held against what is seen."""

    camera: CameraMotionConfig = field(default_factory=CameraMotionConfig)
    depth: DepthAgainstColourConfig = field(default_factory=DepthAgainstColourConfig)
    gripper: GripperPlaceConfig = field(default_factory=GripperPlaceConfig)
    least_tracks: int = 6  # of the part; with fewer the answer rests on depth alone
    # And then on so many patches of it at least: of household-dev's answers by depth alone those on
    # 115 to 249 patches were all off, on furniture-dev those on 2700 and more all right.
    least_patches: int = 300
    without_depth: float = 0.2  # share of the object's place; furniture-dev has at most 0.14
