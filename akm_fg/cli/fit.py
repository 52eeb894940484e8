"""`akm-fg fit`: recordings, tracks and pose logs to posteriors."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.config_argument import write_beside
from akm_fg.cli.console.lines import complain, console
from akm_fg.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED, UNDECIDED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import AkmError, InputError, NoMotionObserved, OutputError
from akm_fg.posterior import ArticulationPosterior
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.config import AkmConfig
    from akm_fg.stages import Stages


@dataclass(frozen=True)
class FitArguments:
    """Example: akm-fg fit kitchen/recording tracks.npz logs/*.log --json posteriors.jsonl

    Finds kind, axis, pivot and states of the joint in each input, each with its uncertainty.
    An input that is broken, or shows no motion, gets one line on standard error; the others are
    still done, and the exit code is 2. It is 1 where a kind is undecided, 130 after Ctrl-C.
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
    debug: bool = False
    """Show where in the program an input failed."""
    segmenter: str | None = None
    """Of recordings, what finds the object: depth, or another of akm_fg/backends/segmenters."""


_CAUSE_LENGTH = 200  # characters of an unexpected error that go on its line

Progress = Callable[[int, int, Path], None]
"""Is told of an input before it is fitted: its number from 1, of how many, and where it is."""


def show_progress(number: int, total: int, path: Path) -> None:
    """In one line of the terminal that is written over."""
    if sys.stderr.isatty() and total > 1:
        print(
            f"\r\033[K{number}/{total} {printable(str(path))}", end="", file=sys.stderr, flush=True
        )


def fit(arguments: FitArguments, progress: Progress = show_progress) -> int:
    """Run the command.

    Raises:
        InputError: no inputs, or a configuration that cannot be used.
        OutputError: the JSON cannot be written; what was written before is kept.
    """
    if not arguments.inputs:
        raise InputError("fit", "no inputs", "at least one recording, .npz or pose log")
    from akm_fg.backends.registry import stages_of

    config = _config(arguments)
    stages = stages_of(config)
    total = len(arguments.inputs)
    posteriors: list[ArticulationPosterior] = []
    code = DONE
    with json_output(arguments.json) as results:
        try:
            for number, path in enumerate(arguments.inputs, 1):
                progress(number, total, path)
                posterior = _attempt(path, arguments, config, stages)
                if posterior is None:
                    code = BAD_INPUT
                    continue
                if results is not None:
                    if not posteriors:
                        write_beside(arguments.json, config)
                    write_line(results, _line(posterior))
                posteriors.append(posterior)
                code = max(code, _code(posterior))
        except KeyboardInterrupt:
            complain(f"interrupted; {_kept(len(posteriors), arguments)}")
            code = INTERRUPTED
        except OutputError as error:
            raise OutputError(f"{error}; {_kept(len(posteriors), arguments)}") from error
    _show_progress_done()
    if arguments.json != "-" and posteriors:
        _print_table(posteriors)
    return code


def _attempt(
    path: Path, arguments: FitArguments, config: AkmConfig, stages: Stages
) -> ArticulationPosterior | None:
    """One input's posterior; None where it has none, and a line has said why."""
    try:
        return _fit_one(path, arguments, config, stages)
    except OutputError:
        raise
    except AkmError as error:
        line = str(error)
        complain(line if str(path) in line else f"{path}: {line}")
        _show_where(arguments)
    except Exception as error:  # one bad input never costs the others
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:_CAUSE_LENGTH]
        hint = "" if arguments.debug else "; --debug shows where"
        complain(f"{path}: could not be fitted ({cause}){hint}")
        _show_where(arguments)
    return None


def _show_where(arguments: FitArguments) -> None:
    """The traceback of the error that is being handled."""
    if arguments.debug:
        traceback.print_exc()


def _code(posterior: ArticulationPosterior) -> int:
    """What one posterior says of the exit code; a part that did not move is said, too."""
    if posterior.kind == "rigid":
        complain(str(_no_motion(posterior)))
        return BAD_INPUT
    return UNDECIDED if posterior.kind == "undecided" else DONE


def _kept(done: int, arguments: FitArguments) -> str:
    words = f"{done} of {len(arguments.inputs)} inputs done"
    if done == 0 or arguments.json in (None, "-"):
        return words
    return f"{words}, kept in {arguments.json}"


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
    from akm_fg.report.tables import posterior_table

    out = console()
    out.print(posterior_table(posteriors, plain=out.options.ascii_only))


def _show_progress_done() -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
