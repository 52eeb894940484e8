"""What `akm-fg fit --out DIR` leaves there: page, posterior, settings, pictures and model."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from akm_fg import __version__
from akm_fg.cli.config_argument import CONFIG, write_tree
from akm_fg.config import AkmConfig
from akm_fg.errors import InsufficientData, OutputError
from akm_fg.io.inputs import FitInput
from akm_fg.io.png import replace_file
from akm_fg.io.posteriors.posterior_json import posterior_as_line
from akm_fg.io.tracks import TracksInput
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.model.records import ObjectModel
from akm_fg.model.write import set_aside, write_model
from akm_fg.pipeline import InputFit
from akm_fg.records import Recording
from akm_fg.report.pictures import pictures, shown_frames
from akm_fg.report.summary import PartTracks, PointPaths, RunSummary
from akm_fg.report.write import write_report
from akm_fg.view.embedded import embedded_view

log = logging.getLogger(__name__)

_OF_A_FIT = "# All settings of akm-fg fit"  # how the settings of one begin


def folders_of(out: Path, inputs: Sequence[Path]) -> list[Path]:
    """OUT itself for one input; for several a folder in it for each, named like the input."""
    if len(inputs) == 1:
        return [out]
    names = [_plain(p.stem if p.suffix else p.name) for p in inputs]
    if len(set(names)) < len(names):
        shared = os.path.commonpath([p.absolute().parent for p in inputs])
        names = [_plain(os.path.relpath(p.absolute(), shared)) for p in inputs]
    unique = [name if names.index(name) == i else f"{name}-{i + 1}" for i, name in enumerate(names)]
    return [out / name for name in unique]


def _plain(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name).strip(".-") or "input"


def make_folder(folder: Path) -> None:
    """Make it, and find out before any work whether it can be written.

    Raises:
        OutputError: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "is a file" if isinstance(error, FileExistsError) else error.strerror
        raise OutputError(f"{folder}: cannot be made ({why}); expected a folder") from error
    if not os.access(folder, os.W_OK):
        raise OutputError(f"{folder}: cannot be written; expected a folder that can")


def claim_folder(folder: Path) -> None:
    """Make a fit's folder, as `make_folder`, and find out whether it is another command's.

    Raises:
        OutputError: it cannot be made or written, or another command keeps its settings there.
    """
    make_folder(folder)
    kept = folder / CONFIG
    try:
        with kept.open(encoding="utf-8", errors="replace") as file:
            begins = file.readline()
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(f"{kept}: {error.strerror}; expected settings of a fit") from error
    if not begins.startswith(_OF_A_FIT):
        wanted = "expected a new folder, or one that a fit wrote"
        raise OutputError(f"{kept}: is of another run, which would be lost; {wanted}")


def write_folder(
    folder: Path, data: FitInput, fit: InputFit, seed: int, command: str, config: AkmConfig
) -> None:
    """Write all files of one input, each whole or not at all.

    Raises:
        OutputError: the disk refuses.
    """
    claim_folder(folder)
    summary = _summary(data, fit, seed, command)
    line = posterior_as_line(fit.posterior) + "\n"
    replace_file(folder / "posterior.json", line.encode())
    write_tree(folder / CONFIG, config, f"All settings of {command}")
    drawn = None
    if summary.recording is not None:
        make_folder(folder / "pictures")
        drawn = pictures(summary, config.overlay)
        for frame, picture in zip(shown_frames(summary), drawn, strict=True):
            replace_file(folder / "pictures" / f"{frame:06d}.jpg", picture.jpeg)
    model = None
    if isinstance(data, Recording) and fit.observed is not None:
        fitted = FittedRecording(data, fit.observed, fit.posterior)
        model = keep_model(folder, fitted, config)
    view = None if model is None else embedded_view(model, summary.title)
    write_report(folder / "report.html", summary, config.overlay, drawn, view=view)


def keep_model(folder: Path, fitted: FittedRecording, config: AkmConfig) -> ObjectModel | None:
    """The object's model, where the answer suffices for one; else the log says why there is none.

    An older one of the same folder is kept under another name, and none stays that is not of it.
    """
    try:
        model = build_model(
            fitted,
            sources=[fitted.posterior.name],
            perception=config.perception,
            config=config.model,
        )
    except InsufficientData as error:
        log.warning("no model.json: %s", error)
        set_aside(folder)
        return None
    write_model(folder, model)
    return model


def _summary(data: FitInput, fit: InputFit, seed: int, command: str) -> RunSummary:
    recording, tracks, paths = None, None, None
    if isinstance(data, Recording):
        recording = data
    elif isinstance(data, TracksInput):
        paths = PointPaths(data.tracks.p_world)
    else:
        paths = PointPaths(np.asarray(data.p_world[:, None]), data.stamps_s)
    if fit.observed is not None:
        parts = fit.observed.segmentation
        tracks = PartTracks(fit.observed.pixels, parts.moving, parts.static)
    return RunSummary(
        title=fit.posterior.name,
        command=command,
        seed=seed,
        version=__version__,
        recording=recording,
        tracks=tracks,
        posterior=fit.posterior,
        paths=paths,
        time_s=dict(fit.posterior.time_s),
    )
