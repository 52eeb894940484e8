"""When to stop pulling: by the posterior, or by the paper's threshold (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from akm_fg.exploration.records import Bounds, Stretch
from akm_fg.records import PointTracks


@dataclass(frozen=True, slots=True)
class Need:
    """What the task needs to know of the joint."""

    kind_probability: float = 0.99
    axis_rad: float = float(np.deg2rad(1.0))  # 95 % bound
    pivot_m: float = 0.01  # 95 % bound
    # The measure of success is a joint that moved by more than 5 cm or 5 deg (the paper's ESR_5):
    # nothing is called opened before that is sure.
    moved_m: float = 0.05
    moved_rad: float = float(np.deg2rad(5.0))
    sure_sd: float = 3.0  # deviations of the state beyond it


@dataclass(frozen=True, slots=True)
class StopConfig:
    """The stop rules' tuning."""

    need: Need = field(default_factory=Need)
    # A stretch that is expected to better both bounds by less than this share is not worth its
    # time: ten such stretches together would not halve them.
    worth: float = 0.07
    patience: int = 2  # stretches that brought less than that: what is left no pull can better
    threshold: float = 0.5  # the paper's: mean way of the moving tracks over the pulled distance


def met(bounds: Bounds, need: Need) -> bool:
    """Whether the joint is known as well as the task needs."""
    good_pivot = bounds.pivot_m is None or bounds.pivot_m <= need.pivot_m
    return bounds.axis_rad <= need.axis_rad and good_pivot


def moved_enough(stretch: Stretch, need: Need) -> bool:
    """Whether the part is surely seen to have been opened by what counts."""
    if stretch.state is None or stretch.state_sd is None or not stretch.seen:
        return False
    least = need.moved_rad if stretch.turns else need.moved_m
    return abs(stretch.state) - need.sure_sd * stretch.state_sd > least


def enough(stretches: Sequence[Stretch], config: StopConfig) -> str | None:
    """Why the pull may stop now, in words; None where it should go on."""
    last = stretches[-1]
    likely = max(last.kind_probability.values(), default=0.0)
    far = any(moved_enough(stretch, config.need) for stretch in stretches)
    if last.bounds is None or not far:
        return None
    if likely < config.need.kind_probability:
        return None
    if last.kind != "undecided" and met(last.bounds, config.need):
        return "the joint is known as well as the task needs"
    if last.expected_next is not None and not worth(last.bounds, last.expected_next, config.worth):
        return "a further stretch is not expected to tell more"
    if _brought_nothing(stretches, config):
        return "the last stretches have told no more"
    return None


def worth(now: Bounds, then: Bounds, share: float) -> bool:
    """Whether either bound gets better by this share."""
    if then.axis_rad < (1.0 - share) * now.axis_rad:
        return True
    if now.pivot_m is None or then.pivot_m is None:
        return False
    return then.pivot_m < (1.0 - share) * now.pivot_m


def _brought_nothing(stretches: Sequence[Stretch], config: StopConfig) -> bool:
    recent = [stretch.bounds for stretch in stretches[-config.patience - 1 :]]
    if len(recent) <= config.patience or any(bounds is None for bounds in recent):
        return False
    pairs = pairwise(recent)
    return not any(
        worth(before, after, config.worth) for before, after in pairs if before and after
    )


def by_threshold(moving: PointTracks, pulled_m: float, config: StopConfig) -> bool:
    """The paper's Algorithm 2: the moving tracks went far enough for the distance pulled.

    Args:
        moving: (T, N) tracks of the moving part.
        pulled_m: that the hand was told to go.
        config: `threshold`.
    """
    way = 0.0
    for n in range(moving.p_world.shape[1]):
        p = moving.p_world[:, n][moving.observed[:, n]]
        if len(p) > 1:
            way += float(np.linalg.norm(p[-1] - p[0])) / moving.p_world.shape[1]
    return way > config.threshold * pulled_m
