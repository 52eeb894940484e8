"""Tables for the terminal."""

from __future__ import annotations

import os
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from akm_fg.posterior import ArticulationPosterior, normal_bound
from akm_fg.report.rows import Row, most_probable, score_rows
from akm_fg.report.summary import RunSummary
from akm_fg.report.wording import NONE, ascii_text, per_cent, printable, size, state, vector


def posterior_table(posteriors: Sequence[ArticulationPosterior], plain: bool = False) -> Table:
    """One row an input; each estimate with its 95 % bound on the line below it. Fits 80 columns.

    Where a kind is undecided, the numbers are those of the most probable kind.

    Args:
        posteriors: named by their inputs; what all names have in common is left out.
        plain: in ASCII alone.
    """

    def text(words: str) -> Text:  # Text: names may hold rich's markup
        return Text(ascii_text(words) if plain else words)

    names = _short([p.name for p in posteriors])
    table = Table(show_lines=len(posteriors) > 1)
    table.add_column("input", overflow="fold", min_width=6)
    table.add_column("kind\nprobability", no_wrap=True)
    table.add_column(text("axis, pivot [cm]\n± 95 % bounds"), justify="right", no_wrap=True)
    table.add_column(text("last state\n± 95 %"), justify="right", no_wrap=True)
    table.add_column("tracks\n/ out", justify="right", no_wrap=True)
    for name, posterior in zip(names, posteriors, strict=True):
        table.add_row(*(text(cell) for cell in (name, *_cells(posterior))))
    noted = [f"{n}: {note}" for n, p in zip(names, posteriors, strict=True) if (note := _notes(p))]
    if noted:  # below the table, because a column would leave no room for the numbers
        table.caption = text("\n".join(noted))
        table.caption_justify = "left"
    return table


def _short(names: Sequence[str]) -> list[str]:
    """Names without the folder that they share, on one line each."""
    try:
        shared = os.path.commonpath([os.path.dirname(name) for name in names])
    except ValueError:  # none at all, or some that begin at the root and some that do not
        shared = ""
    if not shared or len(names) == 1:
        return [printable(name) for name in names]
    return [printable(os.path.relpath(name, shared)) for name in names]


def _cells(posterior: ArticulationPosterior) -> tuple[str, ...]:
    p = posterior.kind_probability[most_probable(posterior)]
    fit = posterior.fit
    joint, last = NONE, NONE
    best = posterior.best
    if best.joint is not None:
        joint = f"{vector(best.joint.axis)}\n± {size(best.joint.axis_bound_rad(), 'rad')}"
        bound = best.joint.pivot_bound_m()
        if best.joint.pivot is not None and bound is not None:
            centre = vector(best.joint.pivot, digits=1, scale=100)
            joint += f"\n{centre}\n± {size(bound, 'm')}"
    frame = None if best.states is None else best.states.last_seen
    if best.states is not None and frame is not None:
        unit = best.states.unit
        bound = normal_bound() * float(best.states.sd[frame])
        last = f"{state(float(best.states.mean[frame]), unit)}\n± {size(bound, unit)}"
    tracks = f"{fit.tracks_used}\n/ {fit.tracks_rejected}"
    return f"{posterior.kind}\n{per_cent(p)}", joint, last, tracks


def _notes(posterior: ArticulationPosterior) -> str:
    notes = list(posterior.fit.warnings)
    if posterior.kind == "undecided":
        notes.insert(0, f"most probable: {most_probable(posterior)}")
    if not posterior.fit.parametric:
        notes.insert(0, "no joint kind explains the data")
    states = posterior.best.states
    if states is not None and states.last_seen not in (None, states.mean.size - 1):
        notes.insert(0, f"last seen in frame {states.last_seen} of {states.mean.size}")
    return "; ".join(notes)


def score_table(summary: RunSummary, plain: bool = False) -> Table:
    """The run's quantities: estimate, 95 % bound, true error; green inside, red outside."""
    return rows_table(summary.title, score_rows(summary), plain)


def rows_table(title: str, rows: Sequence[Row], plain: bool = False) -> Table:
    """Quantities as rows; `plain` in ASCII alone."""

    def text(words: str, style: str = "") -> Text:
        return Text(ascii_text(words) if plain else words, style=style)

    table = Table(title=text(title), title_justify="left")
    table.add_column("quantity")
    table.add_column("estimate", justify="right")
    table.add_column("95 % bound", justify="right")
    table.add_column("true error", justify="right")
    colours = {True: "green", False: "red", None: ""}
    for row in rows:
        error = text(row.error, colours[row.good])
        table.add_row(text(row.quantity), text(row.estimate), text(row.bound), error)
    return table
