"""`akm-fg fit`: recordings, tracks and pose logs to posteriors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import AkmError, InputError, NoMotionObserved, OutputError
from akm_fg.posterior import ArticulationPosterior

if TYPE_CHECKING:
    from akm_fg.config import AkmConfig
    from akm_fg.stages import Stages


@dataclass(frozen=True)
class FitArguments:
    """Example: akm-fg fit kitchen/recording tracks.npz logs/*.log --json posteriors.jsonl

    Finds kind, axis, pivot and states of the joint in each input, each with its uncertainty.
    An input that is broken, or shows no motion, gets one line on standard error; the others are
    still done, and the exit code is 2.
    """

    inputs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recording folders, tracks (.npz) and pose logs (.log, .txt, .csv, .tum, ...)."""
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
    quaternion: Literal["xyzw", "wxyz"] | None = None
    """Order of the quaternions in pose logs, where it is not what the file's format says."""
    unit: Literal["m", "mm"] | None = None
    """Of positions in pose logs and tracks; found out from their size if absent."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults, such as fit.dof = 4.0. All settings
    of a run are written beside OUT of --json OUT, as OUT.config.toml."""
    tracker: str | None = None
    """Of recordings, what follows points: flow, or another file of akm_fg/backends/trackers."""
    segmenter: str | None = None
    """Of recordings, what finds the object: depth, or another of akm_fg/backends/segmenters."""


Progress = Callable[[int, int, Path], None]
"""Is told of an input before it is fitted: its number from 1, of how many, and where it is."""


def show_progress(number: int, total: int, path: Path) -> None:
    """In one line of the terminal that is written over."""
    if sys.stderr.isatty() and total > 1:
        print(f"\r\033[K{number}/{total} {path}", end="", file=sys.stderr, flush=True)


def fit(arguments: FitArguments, progress: Progress = show_progress) -> int:
    """Run the command.

    Raises:
        InputError: no inputs, or a configuration that cannot be used.
        OutputError: the JSON cannot be written.
    """
    if not arguments.inputs:
        raise InputError("fit", "no inputs", "at least one recording, .npz or pose log")
    from akm_fg.backends.registry import stages_of
    from akm_fg.cli.config_argument import write_beside

    config = _config(arguments)
    stages = stages_of(config)
    posteriors: list[ArticulationPosterior] = []
    code = DONE
    with json_output(arguments.json) as stream:
        write_beside(arguments.json, config)
        try:
            for number, path in enumerate(arguments.inputs, 1):
                progress(number, len(arguments.inputs), path)
                try:
                    posterior = _fit_one(path, arguments, config, stages)
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


def _config(arguments: FitArguments) -> AkmConfig:
    from akm_fg.cli.config_argument import chosen_config
    from akm_fg.config import AkmConfig
    from akm_fg.estimation.config import GraspConfig

    config = chosen_config(AkmConfig(), arguments.config, arguments.tracker, arguments.segmenter)
    if arguments.grasp and config.fit.grasp is None:
        config = replace(config, fit=replace(config.fit, grasp=GraspConfig()))
    return config


def _fit_one(
    path: Path, arguments: FitArguments, config: AkmConfig, stages: Stages
) -> ArticulationPosterior:
    from akm_fg.io.inputs import read_input
    from akm_fg.io.read_options import ReadOptions
    from akm_fg.pipeline import fit_input

    options = ReadOptions(arguments.quaternion, arguments.unit)
    data = read_input(path, arguments.frames, options)
    return fit_input(data, str(path), arguments.seed, config.fit, config.perception, stages)


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


def _show_progress_done() -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def _complain(line: str) -> None:
    start = "\r\033[K" if sys.stderr.isatty() else ""
    print(f"{start}akm-fg: {line}", file=sys.stderr)
