"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from akm_fg.posterior import ArticulationPosterior, normal_bound
from akm_fg.report.rows import last_seen, most_probable, score_rows
from akm_fg.report.summary import RunSummary
from akm_fg.report.wording import NONE, per_cent, size, state, vector


def posterior_table(posteriors: Sequence[ArticulationPosterior]) -> Table:
    """One row an input; each estimate with its 95 % bound on the line below it.

    Where a kind is undecided, the numbers are those of the most probable kind.
    """
    table = Table(show_lines=len(posteriors) > 1)
    table.add_column("input", overflow="fold", min_width=6)
    table.add_column("kind\nprobability", no_wrap=True)
    table.add_column("axis\n95 % bound [deg]", justify="right", overflow="fold")
    table.add_column("pivot [cm]\n95 % bound [cm]", justify="right", overflow="fold")
    table.add_column("last state\n95 % bound", justify="right", no_wrap=True)
    table.add_column("tracks used\n/ rejected", justify="right")
    for posterior in posteriors:
        cells = (posterior.name, *_cells(posterior))
        table.add_row(*(Text(cell) for cell in cells))  # Text: names may hold rich's markup
    noted = [f"{p.name}: {note}" for p in posteriors if (note := _notes(p))]
    if noted:  # below the table, because a column would leave no room for the numbers
        table.caption = Text("\n".join(noted))
        table.caption_justify = "left"
    return table


def _cells(posterior: ArticulationPosterior) -> tuple[str, ...]:
    p = posterior.kind_probability[most_probable(posterior)]
    fit = posterior.fit
    axis = pivot = last = NONE
    best = posterior.best
    if best.joint is not None:
        axis = f"{vector(best.joint.axis)}\n± {size(best.joint.axis_bound_rad(), 'rad')}"
        bound = best.joint.pivot_bound_m()
        if best.joint.pivot is not None and bound is not None:
            centre = vector(best.joint.pivot, digits=1, scale=100)
            pivot = f"{centre}\n± {size(bound, 'm')}"
    frame = None if best.states is None else last_seen(best.states)
    if best.states is not None and frame is not None:
        unit = best.states.unit
        bound = normal_bound() * float(best.states.sd[frame])
        last = f"{state(float(best.states.mean[frame]), unit)}\n± {size(bound, unit)}"
    tracks = f"{fit.tracks_used}\n/ {fit.tracks_rejected}"
    return f"{posterior.kind}\n{per_cent(p)}", axis, pivot, last, tracks


def _notes(posterior: ArticulationPosterior) -> str:
    notes = list(posterior.fit.warnings)
    if posterior.kind == "undecided":
        notes.insert(0, f"most probable: {most_probable(posterior)}")
    if not posterior.fit.parametric:
        notes.insert(0, "no joint kind explains the data")
    return "; ".join(notes)


def score_table(summary: RunSummary) -> Table:
    """The run's quantities: estimate, 95 % bound, true error; green inside, red outside."""
    table = Table(title=Text(summary.title), title_justify="left")
    table.add_column("quantity")
    table.add_column("estimate", justify="right")
    table.add_column("95 % bound", justify="right")
    table.add_column("true error", justify="right")
    colours = {True: "green", False: "red", None: ""}
    for row in score_rows(summary):
        error = Text(row.error, style=colours[row.good])
        table.add_row(Text(row.quantity), Text(row.estimate), Text(row.bound), error)
    return table
