"""Writes the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from akm_fg.errors import OutputError
from akm_fg.io.png import replace_file
from akm_fg.report.overlay import OverlayConfig
from akm_fg.report.page import render_page
from akm_fg.report.pictures import Picture
from akm_fg.report.summary import RunSummary


def write_report(
    path: Path,
    summary: RunSummary,
    config: OverlayConfig | None = None,
    drawn: Sequence[Picture] | None = None,
    introduction: Markup | None = None,
    view: Markup | None = None,
) -> None:
    """Write one self-contained HTML file, whole or not at all; makes the folder it goes to.

    Args:
        path: of the file.
        summary: of the run.
        config: of what is drawn into the pictures.
        drawn: the pictures, where they were drawn already.
        introduction: HTML that goes before them.
        view: HTML that shows the object in three dimensions.

    Raises:
        OutputError: the file cannot be written there.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; expected a file name such as report.html")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise OutputError(f"{path.parent}: cannot be made ({e.strerror})") from e
    page = render_page(summary, config, drawn, introduction, view)
    replace_file(path, page.encode("utf-8"))
