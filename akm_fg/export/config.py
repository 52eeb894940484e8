"""Settings of the meshes that leave the house."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ExportConfig:
    """From a model to a description with meshes."""

    frames: int = 12  # of the recording, spread over the states, that are fused
    voxel_m: float = 0.005  # of the fused volume
    truncation_m: float = 0.02  # of the distance to the surface: four voxels, above depth noise
    near_m: float = 0.012  # of the model's surface, within which a pixel belongs to it
    poisson_depth: int = 8  # of the octree, where there are only points: 8 mm of a cabinet
    triangles: int = 20_000  # of a mesh that is looked at
    collision_triangles: int = 3_000  # of the mesh that is cut into convex pieces
    collision_threshold: float = 0.1  # CoACD's concavity: coarse
    most_pieces: int = 16
    # Nobody weighed the parts: masses are nominal, of wooden boards with air between.
    density_kg_m3: float = 200.0
    least_mass_kg: float = 0.2
