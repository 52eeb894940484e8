"""The paper's coarse and fine stages on a recording, from the images alone.

They work on our moving tracks and on clouds of our masks: what is compared is the estimation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.perception.observe import ObserveConfig, observe_motion
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import FloatArray, Recording
from experiments.baselines.clouds import PartCloud, choose_keyframes
from experiments.baselines.coarse import coarse_estimate
from experiments.baselines.config import CoarseConfig, FineConfig
from experiments.baselines.estimate import JointEstimate
from experiments.baselines.fine import fine_estimate
from experiments.trials.part_clouds import keyframe_clouds


@dataclass(frozen=True, slots=True)
class PaperStages:
    """Both stages' answers; the fine one is the coarse where no two clouds were seen."""

    coarse: JointEstimate
    fine: JointEstimate


def paper_stages(recording: Recording, seed: int, starts: int) -> PaperStages:
    """Run both.

    Args:
        recording: the clip.
        seed: of whatever is sampled.
        starts: of the coarse stage.

    Raises:
        InsufficientData: nothing was seen to move.
        ValueError: tracks that the coarse stage cannot work on.
    """
    began = time.perf_counter()
    observed = observe_motion(recording, seed=seed)
    observed.segmentation.require_motion()
    perception_s = time.perf_counter() - began
    coarse = coarse_estimate(observed.moving_tracks.p_world, seed, CoarseConfig(starts=starts))
    began = time.perf_counter()
    clouds = _clouds(recording, observed, coarse, seed)
    clouds_s = time.perf_counter() - began
    fine = refined(coarse, clouds, seed) if len(clouds) > 1 else coarse
    stages = {"perception": perception_s, "clouds": clouds_s, "coarse": coarse.time_s["total"]}
    if fine is not coarse:
        stages["fine"] = fine.time_s["fine"]
    to_coarse = {name: stages[name] for name in ("perception", "coarse")}
    return PaperStages(_timed(coarse, to_coarse), _timed(fine, stages))


def _clouds(
    recording: Recording, observed: ObservedMotion, coarse: JointEstimate, seed: int
) -> dict[int, PartCloud]:
    frames = [int(k) for k in choose_keyframes(coarse.states, FineConfig().keyframes)]
    rng = np.random.default_rng(seed)
    return keyframe_clouds(recording, observed, frames, ObserveConfig().noise, rng)


Refine = Callable[[JointEstimate, Sequence[PartCloud], FloatArray, int], JointEstimate]
"""A coarse estimate, clouds of K keyframes, their states (K,), a seed -> a finer estimate."""


def refined(
    coarse: JointEstimate,
    clouds: Mapping[int, PartCloud],
    seed: int,
    refine: Refine = fine_estimate,
) -> JointEstimate:
    """The fine stage on clouds by frame, its states brought back to the recording's frames."""
    seen = sorted(clouds)
    fine = refine(coarse, [clouds[k] for k in seen], coarse.states[seen], seed)
    sign = 1.0 if fine.axis @ coarse.axis >= 0 else -1.0
    states = np.full(coarse.states.size, np.nan)
    states[seen] = fine.states + sign * coarse.states[seen[0]]
    states[0] = 0.0
    return replace(fine, states=states)


def _timed(estimate: JointEstimate, stages: dict[str, float]) -> JointEstimate:
    fit_s = sum(s for name, s in stages.items() if name != "perception")
    return replace(estimate, time_s={**stages, "fit": fit_s, "total": sum(stages.values())})
