"""Every method that takes tracks: the graph, the paper's coarse stage, the peer."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.estimation.fit import fit_tracks
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import PointTracks
from experiments.baselines.config import CoarseConfig
from experiments.peers.ripl import RiplConfig, estimate_openings
from experiments.rows.rows import Key, TrialRow, trial_row
from experiments.scores.answers import Answer, answer_of_estimates, answer_of_posterior, failed
from experiments.trials.cells import cell_named
from experiments.trials.openings import Opening

log = logging.getLogger(__name__)

PAPER_STARTS = 100  # the lighter of its authors' two settings


@dataclass(frozen=True, slots=True)
class TrackMethod:
    """A method and how many openings it takes at once (a process of its own takes long to start).

    Answers come as they are ready, in the order of the openings; a failure is an answer.
    """

    name: str
    batch: int
    answers: Callable[[Sequence[Opening], Sequence[int]], Iterator[Answer]]


def run_trials(method: TrackMethod, keys: Sequence[Key]) -> Iterator[TrialRow]:
    """Rows of some trials; pure in their keys, times aside."""
    openings = [cell_named(key.cell).opening(key.seed) for key in keys]
    answers = method.answers(openings, [key.seed for key in keys])
    for key, opening in zip(keys, openings, strict=True):
        began = time.process_time()
        answer = next(answers)
        yield trial_row(key, opening.truth, answer, time.process_time() - began)


def _one_by_one(
    answer: Callable[[PointTracks, int], Answer],
) -> Callable[[Sequence[Opening], Sequence[int]], Iterator[Answer]]:
    """A method of one opening as one of many; what it raises is its failure."""

    def answers(openings: Sequence[Opening], seeds: Sequence[int]) -> Iterator[Answer]:
        for opening, seed in zip(openings, seeds, strict=True):
            try:
                yield answer(opening.tracks, seed)
            except Exception as problem:  # a trial without an answer must not end the others
                log.exception("a trial failed")
                yield failed(problem)

    return answers


def graph_method(fit: Callable[..., ArticulationPosterior] = fit_tracks) -> TrackMethod:
    """Ours; `fit` takes tracks, and the seed by its name."""
    return TrackMethod(
        "graph", 1, _one_by_one(lambda tracks, seed: answer_of_posterior(fit(tracks, seed=seed)))
    )


def paper_method(starts: int = PAPER_STARTS) -> TrackMethod:
    """The paper's coarse stage from so many starts."""

    def answer(tracks: PointTracks, seed: int) -> Answer:
        from experiments.baselines.coarse import coarse_alternatives

        found = coarse_alternatives(tracks.p_world, seed, CoarseConfig(starts=starts))
        prismatic, revolute = found["prismatic"], found["revolute"]
        lower = prismatic.losses["prismatic"] < revolute.losses["revolute"]
        best = answer_of_estimates(prismatic if lower else revolute, found)
        seconds = {**prismatic.time_s, **revolute.time_s}
        return Answer(best.kind, best.fits, time_s={**seconds, "total": sum(seconds.values())})

    return TrackMethod("paper", 1, _one_by_one(answer))


def _peer(openings: Sequence[Opening], seeds: Sequence[int]) -> Iterator[Answer]:
    """The peer finds one screw of any pitch; it is read as the true kind too, to be scored."""
    tracks = [opening.tracks for opening in openings]
    named = estimate_openings(tracks, seeds[0])
    as_kind = {
        "revolute": estimate_openings(tracks, seeds[0], RiplConfig(hinge_range_m=np.inf)),
        "prismatic": estimate_openings(tracks, seeds[0], RiplConfig(hinge_range_m=-1.0)),
    }
    for i, estimate in enumerate(named):
        if estimate is None:
            yield failed(RuntimeError("the peer's solver failed"))
            continue
        readings = {kind: found[i] for kind, found in as_kind.items()}
        yield answer_of_estimates(estimate, {k: e for k, e in readings.items() if e is not None})


METHODS = {
    method.name: method
    for method in (graph_method(), paper_method(), TrackMethod("peer", 20, _peer))
}
