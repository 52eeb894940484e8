"""Renews the tables and figures of docs/experiments.md from the rows of all experiments.

    python -m experiments.report --rows runs

Between `<!-- table: NAME -->` and `<!-- end -->` stands what this command has written; everything
else in the page is written by people and stays. What has no rows yet keeps what it had. Figures go
to docs/images/. About a minute, for the bounds of every opening. With `--only` some parts.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from experiments import kind_against_travel, surface_gain
from experiments.claims import coverage, cramer_rao
from experiments.pages import accuracy_report
from experiments.pages.tables import NoRows, grouped, markdown, of_method
from experiments.rows.provenance import runs_of
from experiments.rows.rows import TrialRow, read_rows

PAGE = Path(__file__).resolve().parents[1] / "docs" / "experiments.md"
_BLOCK = re.compile(
    r"(?P<head><!-- table: (?P<name>[a-z-]+) -->\n).*?(?P<tail>\n?<!-- end -->)", re.DOTALL
)
TracksRows = Sequence[TrialRow]


@dataclass(frozen=True, slots=True)
class Part:
    """A table or figure and the folder of rows that it is made of."""

    name: str
    folder: str
    table: Callable[[TracksRows], str] | None = None
    figure: Callable[[TracksRows, Path], None] | None = None


PARTS = (
    Part("accuracy-axis", "accuracy", accuracy_report.axis_table),
    Part("accuracy-inside", "accuracy", accuracy_report.inside_table),
    Part("accuracy-kind", "accuracy", accuracy_report.kind_table),
    Part("accuracy-pivot", "accuracy", accuracy_report.pivot_table),
    Part("accuracy-time", "accuracy", accuracy_report.time_table),
    Part("accuracy-grid", "accuracy", accuracy_report.grid_table),
    Part("accuracy-wrong", "accuracy", accuracy_report.cells_named_wrongly),
    Part("accuracy-travel", "accuracy", figure=accuracy_report.travel_figure),
    Part("accuracy-share-inside", "accuracy", figure=accuracy_report.inside_figure),
    Part("accuracy-over-bound", "accuracy", figure=accuracy_report.grid_figure),
    Part("coverage-tracks", "accuracy", coverage.tracks_table),
    Part("coverage-grid", "accuracy", coverage.grid_table),
    Part("coverage-recordings", "surface-gain", coverage.recordings_table),
    Part("coverage-of-tracks", "accuracy", figure=coverage.tracks_figure),
    Part("coverage-of-recordings", "surface-gain", figure=coverage.recordings_figure),
    Part("surface-gain", "surface-gain", surface_gain.gain_table),
    Part("surface-gain-kinds", "surface-gain", surface_gain.kinds_table),
    Part("surface-gain-outside", "surface-gain", surface_gain.failures_table),
    Part("surface-gain-asr", "surface-gain", figure=surface_gain.gain_figure),
    Part("cramer-rao", "accuracy", cramer_rao.ratio_table),
    Part("cramer-rao-ratio", "accuracy", figure=cramer_rao.ratio_figure),
    Part("kind-against-travel", "kind-against-travel", kind_against_travel.kind_table),
    Part("kind-summary", "kind-against-travel", kind_against_travel.kind_summary),
    Part("kind-outcomes", "kind-against-travel", figure=kind_against_travel.kind_figure),
)
FOLDERS = ("accuracy", "surface-gain", "kind-against-travel")


def provenance_table(folder: Path) -> str:
    """Trials, seeds, revisions and machines of one folder of rows.

    Raises:
        NoRows: there are none.
    """
    rows = read_rows(folder) if folder.exists() else []
    if not rows:
        raise NoRows(f"{folder} has no rows")
    runs = runs_of(folder)
    lines = []
    for method in grouped(rows, lambda row: row.method):
        some = of_method(rows, method)
        seeds = [row.seed for row in some]
        lines.append([method, str(len(some)), f"{min(seeds)} to {max(seeds)}"])
    table = markdown(["method", "trials", "seeds"], lines)
    revisions = ", ".join(sorted({run["revision"] for run in runs}))
    machines = "; ".join(sorted({run["machine"] for run in runs}))
    days = sorted({run["started"][:10] for run in runs})
    said = f"Revision {revisions}; {machines}; {' and '.join({days[0], days[-1]})}." if runs else ""
    return f"{table}\n\n{said}".rstrip()


def tables(rows_folder: Path, only: Sequence[str]) -> dict[str, str]:
    """All tables that have rows, by name."""
    found = {}
    for folder in FOLDERS:
        name = f"rows-{folder}"
        if not only or name in only:
            found.update(_if_any(name, partial(provenance_table, rows_folder / folder)))
    for part, rows in _with_rows(rows_folder, only):
        if part.table is not None:
            found.update(_if_any(part.name, partial(part.table, rows)))
    return found


def figures(rows_folder: Path, images: Path, only: Sequence[str]) -> list[Path]:
    """Draws all figures that have rows; returns their files."""
    drawn = []
    for part, rows in _with_rows(rows_folder, only):
        if part.figure is not None:
            file = images / f"{part.name}.png"
            if _if_any(part.name, partial(part.figure, rows, file)):
                drawn.append(file)
    return drawn


def renewed(page: str, found: dict[str, str]) -> str:
    """The page with these tables between their markers.

    Raises:
        ValueError: a table that the page has no place for.
    """
    places = {match["name"] for match in _BLOCK.finditer(page)}
    if set(found) - places:
        raise ValueError(f"the page has no place for {sorted(set(found) - places)}")

    def block(match: re.Match[str]) -> str:
        if match["name"] not in found:
            return match[0]
        return f"{match['head']}\n{found[match['name']]}\n\n<!-- end -->"

    return _BLOCK.sub(block, page)


def _with_rows(rows_folder: Path, only: Sequence[str]) -> list[tuple[Part, list[TrialRow]]]:
    read: dict[str, list[TrialRow]] = {}
    chosen = []
    for part in PARTS:
        if not only or part.name in only:
            folder = rows_folder / part.folder
            if part.folder not in read:
                read[part.folder] = read_rows(folder) if folder.exists() else []
            chosen.append((part, read[part.folder]))
    return chosen


def _if_any(name: str, make: Callable[[], object]) -> dict[str, str]:
    """What was made, by name; nothing where there are no rows for it."""
    try:
        return {name: str(make())}
    except NoRows as nothing:
        print(f"{name}: {nothing}", file=sys.stderr)
        return {}


def main() -> None:
    """Renew the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=Path, default=Path("runs"), help="folder of all rows")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--only", nargs="+", default=(), help="names of parts")
    arguments = parser.parse_args()
    page: Path = arguments.page
    found = tables(arguments.rows, arguments.only)
    page.write_text(renewed(page.read_text(encoding="utf-8"), found), encoding="utf-8")
    drawn = figures(arguments.rows, page.parent / "images", arguments.only)
    print(f"{len(found)} tables in {page}, {len(drawn)} figures in {page.parent / 'images'}")


if __name__ == "__main__":
    main()
