"""All tuning of perception: one record, the rooms' own configs as its parts."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.perception.change.depth_motion import DepthMotionConfig
from akm_fg.perception.moving_part.following import FollowingConfig
from akm_fg.perception.observe import ObserveConfig
from akm_fg.perception.rig.config import RigConfig
from akm_fg.perception.surface.part_surface import SurfaceConfig


@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """From images to tracks, changes and surfaces of the moving part."""

    observe: ObserveConfig = field(default_factory=ObserveConfig)
    change: DepthMotionConfig = field(default_factory=DepthMotionConfig)
    following: FollowingConfig = field(default_factory=FollowingConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    rig: RigConfig = field(default_factory=RigConfig)
    least_explained: float = 0.5  # of what changed in depth, by an answer from depth alone,
    faces_suffice: float = 0.9  # of it, by the planes of a face, that settle how the part moves
    tell_most: float = (
        0.5  # of the frames in which it changed: with states in fewer, more are sought
    )
    least_told: float = 0.25  # and of the frames in which it changed, by those with a state
