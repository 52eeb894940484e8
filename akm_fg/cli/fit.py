"""`akm-fg fit`: recordings, tracks and pose logs to posteriors."""

from __future__ import annotations

import shlex
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.config_argument import write_beside
from akm_fg.cli.console.lines import complain, console
from akm_fg.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED, UNDECIDED
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.recordings.said import said_conventions
from akm_fg.errors import AkmError, InputError, NoMotionObserved, OutputError
from akm_fg.posterior import ArticulationPosterior
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.cli.fitting.progress import Progress
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
    out: Path | None = None
    """Folder for report.html, posterior.json, config.toml and, of recordings, pictures; of several
    inputs each gets its own in it."""
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
    sensor: Literal["d455", "l515", "kinect", "azure", "measured"] | None = None
    """Of recordings, whose noise depth has: of a camera's data sheet, or as the first picture shows
    it. If absent that of the configuration, a D455's; clearly more noise than that is noticed."""
    convention: Literal["opencv", "opengl"] | None = None
    """Of recordings, axes of the camera whose poses are given: opencv x right, y down, z forward;
    opengl y up, z back. As the format has it if absent, or found out and said."""
    invert_pose: bool = False
    """Of recordings: poses are T_cam_world, from the world to the camera."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Of recordings in other formats, axis of the world that points up: a floor tells by it how
    poses are written. z if absent, or as the format has it."""
    depth_unit: float | None = None
    """Of recordings, metres a unit of stored depth (0.001); as the format has it if absent."""
    debug: bool = False
    """Show where in the program an input failed."""


_REPEATED = (
    *("frames", "quaternion", "unit", "config", "tracker", "segmenter", "sensor"),
    *("convention", "up", "depth-unit"),
)
_CAUSE_LENGTH = 200  # characters of an unexpected error that go on its line

Announce = Callable[[int, int, Path], None]
"""Is told of an input before it is fitted: its number from 1, of how many, and where it is."""


@dataclass(frozen=True)
class _Batch:
    """What all inputs of one command have in common."""

    arguments: FitArguments
    config: AkmConfig
    stages: Stages
    folders: Sequence[Path] | None  # one an input, where something is to be left
    progress: Progress


def fit(arguments: FitArguments, progress: Announce | None = None) -> int:
    """Run the command.

    Args:
        arguments: of the command line.
        progress: is told of each input instead of standard error.

    Raises:
        InputError: no inputs, or a configuration that cannot be used.
        OutputError: a result cannot be written; what was written before is kept.
    """
    if not arguments.inputs:
        raise InputError("fit", "no inputs", "at least one recording, .npz or pose log")
    from akm_fg.cli.fitting.progress import Progress

    shown = Progress(steps_as_lines=arguments.out is not None)
    batch = _batch(arguments, shown)
    total = len(arguments.inputs)
    announce = shown.input if progress is None else progress
    posteriors: list[ArticulationPosterior] = []
    code = DONE
    with json_output(arguments.json) as results:
        try:
            for number, path in enumerate(arguments.inputs, 1):
                announce(number, total, path)
                posterior = _attempt(batch, number - 1)
                if posterior is None:
                    code = BAD_INPUT
                    continue
                if results is not None:
                    if not posteriors:
                        write_beside(arguments.json, batch.config)
                    write_line(results, _line(posterior))
                posteriors.append(posterior)
                code = max(code, _code(posterior))
        except KeyboardInterrupt:
            complain(f"interrupted; {_kept(len(posteriors), arguments)}")
            code = INTERRUPTED
        except OutputError as error:
            raise OutputError(f"{error}; {_kept(len(posteriors), arguments)}") from error
    shown.done()
    if arguments.json != "-" and posteriors:
        _print_table(posteriors, batch.folders)
    return code


def _batch(arguments: FitArguments, progress: Progress) -> _Batch:
    from akm_fg.backends.registry import stages_of

    config = _config(arguments)
    stages = stages_of(config)
    folders = None
    if arguments.out is not None:
        from akm_fg.cli.fitting.folder import claim_folder, folders_of

        claim_folder(arguments.out)
        folders = folders_of(arguments.out, arguments.inputs)
    return _Batch(arguments, config, stages, folders, progress)


def _attempt(batch: _Batch, index: int) -> ArticulationPosterior | None:
    """One input's posterior; None where it has none, and a line has said why."""
    path, debug = batch.arguments.inputs[index], batch.arguments.debug
    try:
        return _fit_one(batch, index)
    except OutputError:
        raise
    except AkmError as error:
        line = str(error)
        complain(line if str(path) in line else f"{path}: {line}")
        _show_where(debug)
    except Exception as error:  # one bad input never costs the others
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:_CAUSE_LENGTH]
        complain(
            f"{path}: could not be fitted ({cause})" + ("" if debug else "; --debug shows where")
        )
        _show_where(debug)
    return None


def _show_where(debug: bool) -> None:
    """The traceback of the error that is being handled."""
    if debug:
        traceback.print_exc()


def _fit_one(batch: _Batch, index: int) -> ArticulationPosterior:
    from akm_fg import pipeline
    from akm_fg.io.inputs import read_input
    from akm_fg.io.read_options import ReadOptions

    arguments, config = batch.arguments, batch.config
    path, seed = arguments.inputs[index], arguments.seed
    options = ReadOptions(
        arguments.quaternion, arguments.unit, conventions=said_conventions(arguments)
    )
    data = read_input(path, arguments.frames, options)
    watched, settings = batch.progress.watched, (config.fit, config.perception, batch.stages)
    fit = pipeline.observe_and_fit(data, str(path), seed, *settings, watched, config.stream)
    if batch.folders is not None:
        from akm_fg.cli.fitting.folder import write_folder

        folder = batch.folders[index]
        batch.progress.writing(folder)
        write_folder(folder, data, fit, seed, _command(arguments, path), config)
    return fit.posterior


def _command(arguments: FitArguments, path: Path) -> str:
    """That gives this input's posterior again."""
    words = ["akm-fg fit", shlex.quote(str(path)), f"--seed {arguments.seed}"]
    words += ["--grasp"] * arguments.grasp
    words += ["--invert-pose"] * arguments.invert_pose
    for flag in _REPEATED:
        given = getattr(arguments, flag.replace("-", "_"))
        if given is not None:
            between = "=" if str(given).startswith("-") else " "
            words.append(f"--{flag}{between}{shlex.quote(str(given))}")
    return " ".join(words)


def _code(posterior: ArticulationPosterior) -> int:
    """What one posterior says of the exit code; a part that did not move is said, too."""
    if posterior.kind == "rigid":
        complain(str(_no_motion(posterior)))
        return BAD_INPUT
    return UNDECIDED if posterior.kind == "undecided" else DONE


def _kept(done: int, arguments: FitArguments) -> str:
    words = f"{done} of {len(arguments.inputs)} inputs done"
    files = None if arguments.json == "-" else arguments.json
    places = [str(place) for place in (files, arguments.out) if place is not None]
    return f"{words}, kept in {' and '.join(places)}" if done and places else words


def _config(arguments: FitArguments) -> AkmConfig:
    from akm_fg.cli.config_argument import chosen_config
    from akm_fg.config import AkmConfig
    from akm_fg.estimation.config import GraspConfig

    config = chosen_config(AkmConfig(), arguments.config, arguments.tracker, arguments.segmenter)
    if arguments.sensor is not None:
        from akm_fg.perception.sensors import with_sensor

        config = replace(config, perception=with_sensor(config.perception, arguments.sensor))
    if arguments.grasp and config.fit.grasp is None:
        config = replace(config, fit=replace(config.fit, grasp=GraspConfig()))
    return config


def _line(posterior: ArticulationPosterior) -> str:
    from akm_fg.io.posteriors.posterior_json import posterior_as_line

    return posterior_as_line(posterior)


def _no_motion(posterior: ArticulationPosterior) -> NoMotionObserved:
    return NoMotionObserved(
        f"{posterior.name}: nothing moved beyond the noise "
        f"(probability {posterior.kind_probability['rigid']:.3f}); expected a part that moves"
    )


def _print_table(posteriors: list[ArticulationPosterior], folders: Sequence[Path] | None) -> None:
    from akm_fg.report.tables import posterior_table

    out = console()
    out.print(posterior_table(posteriors, plain=out.options.ascii_only))
    for folder in folders or ():
        if (folder / "report.html").exists():
            out.print(f"report: {printable(str(folder / 'report.html'))}", soft_wrap=True)
