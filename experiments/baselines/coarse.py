"""The paper's coarse stage: a joint from sparse tracks (Eq. 5).

The points of frame 0 are taken as exact and moved by the joint; the mean distance to where they
were observed is minimised over joint and states, for a prismatic joint from one start, for a
hinge from many in parallel, which share one step size and stop when the best of them no longer
improves. The lower loss decides the kind. Lost observations (NaN) do not count; a point lost in
frame 0 has no reference and is left out.
"""

from __future__ import annotations

import time

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from experiments.baselines.config import CoarseConfig
from experiments.baselines.descent import Evaluation, Minimum, minimise
from experiments.baselines.estimate import KINDS, JointEstimate, joint_estimate
from experiments.baselines.kinematics import joint_motion
from experiments.baselines.starts import Starts, observed, prismatic_start, revolute_starts
from factors.joint import JointKind

Array = NDArray[np.float64]

_TINY_M2 = 1e-16  # keeps the gradient of a distance finite at zero: 10 nm
_CHUNK_NUMBERS = 2**20  # coordinates worked on at once: 4 MB stay in the cache


def coarse_estimate(points: Array, seed: int, config: CoarseConfig | None = None) -> JointEstimate:
    """The joint whose kind has the lower loss.

    Args:
        points: (T, N, 3) metres, tracks of the moving part; NaN where lost.
        seed: of the random starts.
        config: settings.

    Returns:
        Losses and times carry both kinds (metres, or square metres if squared; seconds).

    Raises:
        ValueError: see `coarse_alternatives`.
    """
    found = coarse_alternatives(points, seed, config)
    prismatic, revolute = found[JointKind.PRISMATIC], found[JointKind.REVOLUTE]
    lower = prismatic.losses["prismatic"] < revolute.losses["revolute"]
    best = prismatic if lower else revolute
    seconds = {**prismatic.time_s, **revolute.time_s}
    return JointEstimate(
        kind=best.kind,
        axis=best.axis,
        pivot=best.pivot,
        states=best.states,
        losses={**prismatic.losses, **revolute.losses},
        time_s=seconds | {"total": sum(seconds.values())},
    )


def coarse_alternatives(
    points: Array, seed: int, config: CoarseConfig | None = None
) -> dict[str, JointEstimate]:
    """The best joint of either kind, by kind.

    Args:
        points: (T, N, 3) metres, tracks of the moving part; NaN where lost.
        seed: of the random starts.
        config: settings.

    Raises:
        ValueError: another shape, fewer than two frames, no point of frame 0 seen again, or a
            centroid that ends where it began.
    """
    config = config or CoarseConfig()
    kept = _tracks_from_the_first_frame(points)
    found: dict[str, JointEstimate] = {}
    for kind in KINDS:
        began = time.perf_counter()
        if not kind.turns:
            starts = prismatic_start(kept)
        else:
            starts = revolute_starts(kept, config, np.random.default_rng(seed))
        found[kind] = _descend(kind, kept, starts, config, began)
    return found


def _tracks_from_the_first_frame(points: Array) -> Array:
    """The tracks (T, M, 3) that were seen in frame 0."""
    if points.ndim != 3 or points.shape[2] != 3 or points.shape[0] < 2:
        raise ValueError(f"points {points.shape}, expected (T, N, 3) with two frames at least")
    kept = points[:, observed(points[0])]
    if not observed(np.diff(kept, axis=0)).any():
        raise ValueError("no point of the first frame was seen in two frames running")
    return kept


def _descend(
    kind: JointKind, points: Array, starts: Starts, config: CoarseConfig, began: float
) -> JointEstimate:
    """Minimise Eq. 5 from all starts and bring the best into the project's conventions."""
    axis, pivot = (_leaf(v) for v in (starts.axis, starts.pivot))
    states = _leaf(starts.states[:, 1:])
    parameters = [axis, pivot, states] if kind.turns else [axis, states]
    seen = observed(points)
    targets = torch.tensor(np.where(seen[..., None], points, 0.0), dtype=torch.float32)
    weight = torch.tensor(seen[1:], dtype=torch.float32)
    chunk = max(1, _CHUNK_NUMBERS // targets.numel())

    def evaluate() -> Evaluation:
        losses = []
        for rows in torch.arange(axis.shape[0]).split(chunk):
            R, t = joint_motion(kind, axis[rows], pivot[rows], states[rows])
            loss = _mean_distances(R, t, targets, weight, config.squared)
            loss.sum().backward()  # the sum leaves every start the gradient it would have alone
            losses.append(loss.detach())
        best, row = torch.cat(losses).min(dim=0)
        return Evaluation(best.item(), int(row))

    best = minimise(parameters, evaluate, config.descent)
    return _in_conventions(kind, best, points, began)


def _mean_distances(R: Tensor, t: Tensor, targets: Tensor, weight: Tensor, squared: bool) -> Tensor:
    """Mean distance (B,) of the moved points of frame 0 from the targets (T, N, 3).

    R (B, T-1, 3, 3), t (B, T-1, 3), weight (T-1, N), 1 where seen.
    """
    # (B, T-1, 3, N): one product for all frames of a start.
    moved = (R.flatten(1, 2) @ targets[0].T).unflatten(1, R.shape[1:3]) + t[..., None]
    error = moved - targets[1:].transpose(1, 2)
    distance = (error * error).sum(dim=2)
    if not squared:  # five times faster here than vector_norm over a middle dimension
        distance = torch.sqrt(distance + _TINY_M2)
    return (distance * weight).sum(dim=(1, 2)) / weight.sum()


def _in_conventions(kind: JointKind, best: Minimum, points: Array, began: float) -> JointEstimate:
    """The best row of the minimum as an estimate; unseen frames have no state."""
    rows = [p[best.best_row].numpy().astype(np.float64) for p in best.parameters]
    states = np.concatenate([[0.0], rows[-1]])
    states[~observed(points).any(axis=1)] = np.nan
    centroid = points[0].mean(axis=0)
    return joint_estimate(
        kind=kind,
        axis=rows[0],
        point_on_axis=rows[1] if kind.turns else centroid,
        states=states,
        part_centroid=centroid,
        losses={kind: best.loss},
        time_s={kind: time.perf_counter() - began},
    )


def _leaf(value: Array) -> Tensor:
    return torch.tensor(value, dtype=torch.float32, requires_grad=True)
