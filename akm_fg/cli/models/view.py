"""`akm-fg view`: a model, a run or a recording in three dimensions."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from akm_fg.cli.exit_codes import DONE
from akm_fg.errors import InputError
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.view.contents import Contents

WHAT = "a model (model.json), a folder that holds one, or a recording"
_PORTS = 65_535


@dataclass(frozen=True)
class ViewArguments:
    """Example: akm-fg view runs/kitchen

    Opens a page with the cloud of each part, the axis with the cone that holds it with 95 %, a
    slider for the state, and the recording played back. A recording is fitted first, and its tracks
    are shown, too. Ctrl-C ends it.
    """

    place: Annotated[Path, tyro.conf.Positional]
    """A model.json, the folder of a run or of fit --out, or a recording of any format."""
    html: Path | None = None
    """Write the page to this file instead: it needs no server and no network."""
    rerun: Path | None = None
    """Write the same for rerun's viewer (.rrd)."""
    host: str = "127.0.0.1"
    """Where from the page can be reached; 0.0.0.0 is everywhere."""
    port: int = 8080
    """Of the page; the next that is free is taken."""
    seed: int = 0
    """Of the fit of a recording."""


def view(arguments: ViewArguments) -> int:
    """Run the command.

    Raises:
        InputError: nothing there that can be shown.
        InsufficientData: a recording in which nothing is found.
        MissingDependency: what shows it is not installed.
        OutputError: the disk refuses.
    """
    if not 0 < arguments.port <= _PORTS:
        raise InputError("--port", f"is {arguments.port}", f"1 to {_PORTS}")
    contents = _contents(arguments)
    if arguments.html is not None:
        from akm_fg.io.png import replace_file
        from akm_fg.view.page import html_page

        replace_file(arguments.html, html_page(contents).encode())
        print(printable(str(arguments.html)))
    if arguments.rerun is not None:
        from akm_fg.view.rerun_log import write_rerun

        write_rerun(arguments.rerun, contents)
        print(printable(str(arguments.rerun)))
    if arguments.html is None and arguments.rerun is None:
        _serve(arguments, contents)
    return DONE


def _contents(arguments: ViewArguments) -> Contents:
    from akm_fg.io.sources.registry import format_of
    from akm_fg.model.read import FILE, read_model
    from akm_fg.view.contents import contents_of

    place = arguments.place
    other_format = place.exists() and format_of(place) is not None
    if (place / FILE).exists() or (place.is_file() and not other_format):
        return contents_of(read_model(place), str(place))
    for recording in (place, place / "recording"):
        if (recording / "recording.json").exists() or (recording == place and other_format):
            return _fitted(recording, arguments.seed)
    raise InputError(place, "holds nothing to show" if place.exists() else "does not exist", WHAT)


def _fitted(place: Path, seed: int) -> Contents:
    """A recording of any format, after a fit."""
    import akm_fg
    from akm_fg.cli.fitting.progress import Progress
    from akm_fg.model.build import FittedRecording, build_model
    from akm_fg.pipeline import fit_recording
    from akm_fg.view.contents import contents_of

    progress = Progress(steps_as_lines=True)
    progress.input(1, 1, place)
    recording = akm_fg.read_recording(place)
    fit = fit_recording(recording, seed, watched=progress.watched)
    progress.done()
    model = build_model(FittedRecording.of(recording, fit))
    return contents_of(model, str(place), fit.observed)


def _serve(arguments: ViewArguments, contents: Contents) -> None:
    """Until Ctrl-C, which is the way to end it."""
    from akm_fg.view.page import serving

    with serving(contents, arguments.host, arguments.port) as server:
        print(f"http://{server.get_host()}:{server.get_port()}  (Ctrl-C ends it)", flush=True)
        try:
            while True:
                time.sleep(1.0)
        except KeyboardInterrupt:
            return
