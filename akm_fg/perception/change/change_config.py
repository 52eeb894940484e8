"""Tuning of what counts as a change of depth."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DepthChangeConfig:
    """What counts as a change of depth."""

    stride_px: int = 3  # of the pixels compared, of a VGA image: errors of neighbours agree,
    pitch_m: float = 0.009  # unless they would be farther apart on the object: parts may be small
    window: int = 3  # of such pixels, whose mean is compared
    least_known: float = 0.33  # of a window, in both images
    sigmas: float = 3.0  # of the mean; chance alone seldom changes nine windows side by side
    least_m: float = 0.005  # on top: systematic errors
    around: int = 5  # of such pixels: a window whose readings tell of a hole in its middle,
    agreeing: float = 0.8  # where so many of them have changed
    least_seen: int = 2  # frames that show what lies behind a pixel that the first does not know,
    least_share: float = 0.2  # of those that know it
    # Between a change and the object, or what was nearer in a frame before: of a lid that is up,
    # the edge and its shadow have no depth.
    beside_px: float = 15.0  # at 640 pixels
    least_area_m2: float = 0.0015  # of a connected change: 4 cm squared; smaller is no furniture
    share_frames: int = 8  # asked for `explained_share`
    share_points: int = 200  # of each, nearer and farther
    share_sigmas: float = 3.0  # how far a point may be off the surface seen; plus `least_m`
