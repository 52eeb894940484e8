"""Every method that takes a recording: the graph with tracks, surface or both; the paper's stages.

All start from the images alone, and from the same moving tracks and masks.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from akm_fg.errors import InsufficientData
from akm_fg.io.recording import read_recording
from akm_fg.io.recording_reader import read_truth
from akm_fg.pipeline import fit_recording
from akm_fg.records import JointTruth, Recording
from akm_fg.stages import RecordingFit
from experiments.rows.rows import Key, TrialRow, trial_row
from experiments.scores.answers import Answer, answer_of_estimates, answer_of_posterior, failed
from experiments.trials.track_methods import PAPER_STARTS

log = logging.getLogger(__name__)

GRAPH = ("graph-tracks", "graph-surface", "graph-both")
PAPER = ("paper-coarse", "paper-fine")


Fit = Callable[..., RecordingFit]
"""Fits a recording with a seed; what enters the graph is said by the name `sources`."""


def run_recording(
    folder: Path,
    methods: Sequence[str],
    seed: int,
    starts: int = PAPER_STARTS,
    fit: Fit = fit_recording,
) -> Iterator[TrialRow]:
    """Rows of one recording, a method each; pure in the seed, times aside.

    Args:
        folder: the recording, with its truth.
        methods: of `GRAPH` and `PAPER`; both of the paper's stages are run where one is asked for.
        seed: of whatever is sampled.
        starts: of the paper's coarse stage.
        fit: ours.

    Raises:
        InputError: the folder is no recording.
        ValueError: it has no truth to be scored with.
    """
    recording, truth = read_recording(folder), read_truth(folder)
    recording = replace(recording, T_world_gripper=None, grasp_frames=None)  # images alone
    if truth is None:
        raise ValueError(f"{folder} has no truth: it cannot be scored")
    for method in methods:
        if method in GRAPH:
            began = time.process_time()
            answer = _graph(recording, method.removeprefix("graph-"), seed, fit)
            yield _row(folder, method, seed, truth, answer, time.process_time() - began)
    if set(methods) & set(PAPER):
        for method, answer in _paper(recording, seed, starts).items():
            if method in methods:
                yield _row(folder, method, seed, truth, answer, None)


def _row(
    folder: Path, method: str, seed: int, truth: JointTruth, answer: Answer, cpu_s: float | None
) -> TrialRow:
    return trial_row(Key(folder.name, method, seed), truth, answer, cpu_s)


def _graph(recording: Recording, sources: str, seed: int, fit: Fit) -> Answer:
    try:
        return answer_of_posterior(fit(recording, seed, sources=sources).posterior)
    except Exception as problem:  # a recording without an answer must not end the others
        if not isinstance(problem, InsufficientData):
            log.exception("%s, %s", recording.name, sources)
        return failed(problem)


def _paper(recording: Recording, seed: int, starts: int) -> dict[str, Answer]:
    from experiments.trials.paper_on_recordings import paper_stages  # torch

    try:
        stages = paper_stages(recording, seed, starts)
    except Exception as problem:  # as above
        if not isinstance(problem, InsufficientData):
            log.exception("%s, the paper's method", recording.name)
        return dict.fromkeys(PAPER, failed(problem))
    answers = answer_of_estimates(stages.coarse), answer_of_estimates(stages.fine)
    return dict(zip(PAPER, answers, strict=True))
