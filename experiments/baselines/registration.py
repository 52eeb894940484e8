"""How badly two clouds agree once the joint has moved one to the other (inside Eq. 6 and 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from experiments.baselines.clouds import PartCloud
from experiments.baselines.config import RegistrationConfig


@dataclass(frozen=True, slots=True)
class SampledCloud:
    """Random points of a cloud."""

    points: Tensor  # (M, 3) metres
    normals: Tensor  # (M, 3)

    def tree(self) -> cKDTree:
        """For matching others to these points."""
        return cKDTree(self.points.numpy())


def sampled(cloud: PartCloud, count: int, rng: np.random.Generator) -> SampledCloud:
    """At most `count` points of the cloud, drawn without putting back."""
    index = np.arange(len(cloud.points))
    if index.size > count:
        index = rng.choice(index, count, replace=False)
    return SampledCloud(
        torch.tensor(cloud.points[index], dtype=torch.float32),
        torch.tensor(cloud.normals[index], dtype=torch.float32),
    )


def registration_loss(
    source: SampledCloud,
    target: SampledCloud,
    tree: cKDTree,
    R: Tensor,
    t: Tensor,
    config: RegistrationConfig,
) -> Tensor | None:
    """Mean squared distance of the moved source from its matches in the target, square metres.

    Distances run along the target's normals, or straight if the paper is followed to the letter.

    Args:
        source: points to move.
        target: points to be matched.
        tree: of the target.
        R: (3, 3) rotation from the source's state to the target's.
        t: (3,) translation of the same motion, metres.
        config: kind of distance, limits of a match.

    Returns:
        A scalar, or None where too few points have a match.
    """
    moved = source.points @ R.T + t
    distance, index = tree.query(moved.detach().numpy(), distance_upper_bound=config.match_range_m)
    matched = np.flatnonzero(np.isfinite(distance))
    if matched.size < config.min_matches:
        return None
    error = moved[matched] - target.points[index[matched]]
    if config.point_to_plane:
        return ((error * target.normals[index[matched]]).sum(dim=1) ** 2).mean()
    return (error * error).sum(dim=1).mean()
