"""Settings of the making of models."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.perception.depth.depth_planes import DepthPlanesConfig


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """From fitted recordings to surfaces."""

    frames: int = 12  # of a recording, spread over its states, whose depth makes the surfaces
    voxel_m: float = 0.004  # readings within are averaged; twice a D455's noise at 1.2 m
    planes: DepthPlanesConfig = field(default_factory=DepthPlanesConfig)
    # Where wide windows find no plane: handles, edges, mouldings.
    fine_planes: DepthPlanesConfig = field(default_factory=lambda: DepthPlanesConfig(radius_px=2))
    fine_width_px: int = 640  # of an image at which every pixel is taken; of wider ones fewer
    gate_sigmas: float = 3.0  # of two depth readings, beyond which a surface is not where it was
    gate_m: float = 0.006  # on top: systematic errors, and the width of a voxel
    # Of the frames that could see a point, that look through it: more, and it is none of the part.
    most_seen_through: float = 0.25
    # A part is one piece: islands beyond a gap and smaller than a share of it are none of it.
    island_gap_m: float = 0.03
    island_share: float = 0.05
    outline_px: int = 3  # of the object's mask, that may show what is beside it
    least_points: int = 50  # of a surface; fewer are no model of a part
