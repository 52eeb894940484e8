"""`akm-fg fit`: recordings, tracks and pose logs to posteriors."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from akm_fg.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import AkmError, InputError, NoMotionObserved, OutputError
from akm_fg.posterior import ArticulationPosterior


@dataclass(frozen=True)
class FitArguments:
    """Example: akm-fg fit kitchen/recording tracks.npz logs/*.log --json posteriors.jsonl

    Finds kind, axis, pivot and states of the joint in each input, each with its uncertainty.
    An input that is broken, or shows no motion, gets one line on standard error; the others are
    still done, and the exit code is 2.
    """

    inputs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recording folders, tracks (.npz) and pose logs (.log, .txt, .dat)."""
    json: str | None = None
    """Write one JSON object a line to this file; - is standard output (no table then)."""
    seed: int = 0
    """Of the random sampling inside the estimator."""
    grasp: bool = False
    """Use where the gripper was while it held, in recordings that say so (T_world_gripper and
    grasp_frames); otherwise the images alone count."""
    frames: int | None = None
    """Take this many frames from the beginning of each recording, as an episode did that modelled
    before it went on; all if absent."""


def fit(arguments: FitArguments) -> int:
    """Run the command.

    Raises:
        OutputError: the JSON cannot be written.
    """
    if not arguments.inputs:
        raise InputError("fit", "no inputs", "at least one recording, .npz or pose log")
    posteriors: list[ArticulationPosterior] = []
    code = DONE
    with json_output(arguments.json) as stream:
        try:
            for number, path in enumerate(arguments.inputs, 1):
                _show_progress(number, len(arguments.inputs), path)
                try:
                    posterior = _fit_one(path, arguments)
                except OutputError:
                    raise
                except AkmError as error:
                    _complain(str(error))
                    code = BAD_INPUT
                    continue
                posteriors.append(posterior)
                if stream is not None:
                    write_line(stream, _line(posterior))
                if posterior.kind == "rigid":
                    _complain(str(_no_motion(posterior)))
                    code = BAD_INPUT
        except KeyboardInterrupt:
            _complain(f"interrupted; {len(posteriors)} of {len(arguments.inputs)} inputs done")
            code = INTERRUPTED
    _show_progress_done()
    if arguments.json != "-" and posteriors:
        _print_table(posteriors)
    return code


def _fit_one(path: Path, arguments: FitArguments) -> ArticulationPosterior:
    from akm_fg.estimation.config import FitConfig, GraspConfig
    from akm_fg.io.inputs import read_input
    from akm_fg.pipeline import fit_input

    config = FitConfig(grasp=GraspConfig() if arguments.grasp else None)
    return fit_input(read_input(path, arguments.frames), str(path), arguments.seed, config)


def _line(posterior: ArticulationPosterior) -> str:
    from akm_fg.io.posterior_json import posterior_as_line

    return posterior_as_line(posterior)


def _no_motion(posterior: ArticulationPosterior) -> NoMotionObserved:
    return NoMotionObserved(
        f"{posterior.name}: nothing moved beyond the noise "
        f"(probability {posterior.kind_probability['rigid']:.3f}); expected a part that moves"
    )


def _print_table(posteriors: list[ArticulationPosterior]) -> None:
    from rich.console import Console

    from akm_fg.report.tables import posterior_table

    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(posterior_table(posteriors))


def _show_progress(number: int, total: int, path: Path) -> None:
    if sys.stderr.isatty() and total > 1:
        print(f"\r\033[K{number}/{total} {path}", end="", file=sys.stderr, flush=True)


def _show_progress_done() -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def _complain(line: str) -> None:
    start = "\r\033[K" if sys.stderr.isatty() else ""
    print(f"{start}akm-fg: {line}", file=sys.stderr)
