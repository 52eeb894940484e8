"""The paper's fine stage: joint and states from the dense clouds of a few keyframes (Eq. 6).

Every pair of keyframes is registered by the motion that the joint gives it; the kind stays what
the coarse stage found. The first keyframe's state stays where it is.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from experiments.baselines.clouds import PartCloud
from experiments.baselines.config import FineConfig
from experiments.baselines.descent import Evaluation, minimise
from experiments.baselines.estimate import JointEstimate, joint_estimate
from experiments.baselines.kinematics import joint_motion
from experiments.baselines.registration import registration_loss, sampled

Array = NDArray[np.float64]


def fine_estimate(
    coarse: JointEstimate,
    clouds: Sequence[PartCloud],
    states: Array,
    seed: int,
    config: FineConfig | None = None,
) -> JointEstimate:
    """Refine a joint.

    Args:
        coarse: where to start from; its kind is kept.
        clouds: K keyframes of the moving part, the first frame's first.
        states: (K,) coarse states of the keyframes.
        seed: of the random points.
        config: settings.

    Returns:
        The joint, with the states of the K keyframes relative to the first. Its loss "fine" (square
        metres) is infinite where no two clouds could be matched: then the joint is the coarse one.

    Raises:
        ValueError: fewer than two keyframes, or another number of states.
    """
    config = config or FineConfig()
    if len(clouds) < 2 or states.shape != (len(clouds),) or not np.isfinite(states).all():
        raise ValueError(f"{len(clouds)} clouds, states {states}: two or more, one state each")
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    centroid = clouds[0].points.mean(axis=0)
    axis = _leaf(coarse.axis)
    pivot = _leaf(centroid if coarse.pivot is None else coarse.pivot)
    later = _leaf(states[1:] - states[0])
    pairs = list(itertools.combinations(range(len(clouds)), 2))

    def evaluate() -> Evaluation | None:
        samples = [sampled(cloud, config.registration.sample, rng) for cloud in clouds]
        trees = [None, *(sample.tree() for sample in samples[1:])]  # the first is never a target
        q = torch.cat([torch.zeros(1), later])
        between = torch.stack([q[j] - q[i] for i, j in pairs])
        R, t = joint_motion(coarse.kind, axis, pivot, between)
        terms = [
            registration_loss(samples[i], samples[j], trees[j], R[k], t[k], config.registration)
            for k, (i, j) in enumerate(pairs)
        ]
        matched = [term for term in terms if term is not None]
        if not matched:
            return None
        loss = torch.stack(matched).sum() / len(pairs)
        loss.backward()
        return Evaluation(loss.item())

    parameters = [axis, pivot, later] if coarse.kind.turns else [axis, later]
    best = minimise(parameters, evaluate, config.descent)
    found = [p.numpy().astype(np.float64) for p in best.parameters]
    return joint_estimate(
        kind=coarse.kind,
        axis=found[0],
        point_on_axis=found[1] if coarse.kind.turns else centroid,
        states=np.concatenate([[0.0], found[-1]]),
        part_centroid=centroid,
        losses={**coarse.losses, "fine": best.loss},
        time_s={**coarse.time_s, "fine": time.perf_counter() - began},
    )


def _leaf(value: Array) -> Tensor:
    return torch.tensor(value, dtype=torch.float32, requires_grad=True)
