"""What was seen of an object: the record that the rooms of perception share."""

from __future__ import annotations

from dataclasses import dataclass

from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation
from akm_fg.records import BoolArray, PixelTracks, PointTracks


@dataclass(frozen=True, slots=True)
class ObservedMotion:
    """What was seen of the object: N tracks over T frames."""

    tracks: PointTracks  # all; world frame
    pixels: PixelTracks  # the tracks in the image
    segmentation: MotionSegmentation
    object_mask: BoolArray  # (H, W) in the first frame

    @property
    def moving_tracks(self) -> PointTracks:
        """The tracks of the moving part."""
        return self.tracks.select(self.segmentation.moving)
