"""The paper's relocalization: the state of one frame from its cloud (Eq. 7, Algorithm 3).

States spread over the range are scored by how far the first keyframe's points, moved there, lie
from the current cloud; the best is refined against all keyframes with the joint held. There is no
memory of the last state.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from experiments.baselines.clouds import PartCloud
from experiments.baselines.config import RelocalizationConfig
from experiments.baselines.descent import Evaluation, minimise
from experiments.baselines.estimate import JointEstimate
from experiments.baselines.kinematics import joint_motion
from experiments.baselines.registration import registration_loss, sampled

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Relocalization:
    """The state of one frame."""

    state: float  # metres or radians, relative to the first keyframe
    candidate: float  # the state it was refined from
    loss: float  # after refinement, square metres; infinite where nothing matched
    time_s: float


def relocalize(
    joint: JointEstimate,
    keyframes: Sequence[PartCloud],
    states: Array,
    current: PartCloud,
    seed: int,
    config: RelocalizationConfig | None = None,
) -> Relocalization:
    """Find the state in which the part is now.

    Args:
        joint: from the fine stage; held.
        keyframes: K clouds of the moving part, the first frame's first.
        states: (K,) of the keyframes, zero at the first.
        current: what is seen now; may hold more than the moving part.
        seed: of the random points.
        config: settings.

    Raises:
        ValueError: no keyframe, or another number of states.
    """
    config = config or RelocalizationConfig()
    if not keyframes or states.shape != (len(keyframes),) or not np.isfinite(states).all():
        raise ValueError(f"{len(keyframes)} keyframes, states {states}: one state each")
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    candidate = _best_candidate(joint, keyframes[0], current, config, rng)
    axis, pivot = _held(joint)
    state = torch.tensor([candidate], dtype=torch.float32, requires_grad=True)
    of_keyframes = torch.tensor(states, dtype=torch.float32)

    def evaluate() -> Evaluation | None:
        R, t = joint_motion(joint.kind, axis, pivot, state - of_keyframes)
        now = sampled(current, config.registration.sample, rng)
        tree = now.tree()
        samples = [sampled(cloud, config.registration.sample, rng) for cloud in keyframes]
        terms = [
            registration_loss(sample, now, tree, R[k], t[k], config.registration)
            for k, sample in enumerate(samples)
        ]
        matched = [term for term in terms if term is not None]
        if not matched:
            return None
        loss = torch.stack(matched).sum() / len(keyframes)
        loss.backward()
        return Evaluation(loss.item())

    best = minimise([state], evaluate, config.descent)
    return Relocalization(
        state=float(best.parameters[0][0]),
        candidate=candidate,
        loss=best.loss,
        time_s=time.perf_counter() - began,
    )


def _best_candidate(
    joint: JointEstimate,
    first: PartCloud,
    current: PartCloud,
    config: RelocalizationConfig,
    rng: np.random.Generator,
) -> float:
    """The candidate with the least Eq. 7 against the first keyframe.

    Every sampled point counts, however far its neighbour: with a match range, a state in which
    little of the part meets anything would win.
    """
    limit = np.deg2rad(config.range_deg) if joint.kind.turns else config.range_m
    candidates = np.linspace(0.0, limit, config.candidates)
    R, t = joint_motion(joint.kind, *_held(joint), torch.tensor(candidates, dtype=torch.float32))
    points = sampled(first, config.registration.sample, rng).points
    moved = (points @ R.mT + t[:, None]).numpy()
    distance, _ = cKDTree(current.points).query(moved)
    return float(candidates[np.argmin((distance**2).mean(axis=1))])


def _held(joint: JointEstimate) -> tuple[torch.Tensor, torch.Tensor]:
    """Axis and pivot as constants."""
    pivot = np.zeros(3) if joint.pivot is None else joint.pivot
    return torch.tensor(joint.axis, dtype=torch.float32), torch.tensor(pivot, dtype=torch.float32)
