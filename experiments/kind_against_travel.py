"""How far must a door move before it can be told from a drawer, and who errs before that?

    python -m experiments.kind_against_travel --runs 100

Doors from 0.5 to 40 deg and drawers from 0.5 to 40 cm; 40 points, 20 frames, 3 mm, clean. Each
trial ends right, undecided, or confidently wrong: rigid (nothing moves) or another joint was named,
at 0.95 or more. One row a trial in OUT/METHOD.jsonl, as it ends; what is there is not done again.
`experiments.report` puts table and figure into docs/experiments.md. About five minutes for 100 runs
on one core; `--method paper` is the rule "the lower loss decides", which knows no undecided.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.pages.figures import COLOURS, NAMES, line_with_band, log_ticks, new_figure, save
from experiments.pages.one_line import ends_in_one_line
from experiments.pages.tables import NoRows, grouped, markdown, of_method, percent
from experiments.rows.provenance import note_run
from experiments.rows.rows import TrialRow, fill, keys
from experiments.scores.statistics import share
from experiments.trials.cells import Cell, cell_named
from experiments.trials.track_methods import METHODS, run_trials

TRAVELS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0)  # deg and cm
SURE = 0.95  # share of right trials from which on a kind can be told
FIRST_SEED = 40_000  # nothing was tuned on seeds from here on


@dataclass(frozen=True, slots=True)
class KindConfig:
    """Which trials are run."""

    method: str = "graph"
    runs: int = 100  # a travel
    first_seed: int = FIRST_SEED
    travels: tuple[float, ...] = TRAVELS
    out: Path = Path("runs/kind-against-travel")

    def cells(self) -> list[Cell]:
        """Doors, then drawers."""
        return [Cell(part, travel) for part in ("door", "drawer") for travel in self.travels]


@dataclass(frozen=True, slots=True)
class Outcome:
    """One way in which a trial can end."""

    name: str
    happened: Callable[[TrialRow], bool]
    colour: str


OUTCOMES = (
    Outcome("right", lambda row: row.kind_right, "peer"),
    Outcome("undecided", lambda row: row.kind in (None, "undecided"), "bound"),
    Outcome("named rigid", lambda row: row.confidently_wrong and row.kind == "rigid", "third"),
    Outcome(
        "named another joint", lambda row: row.confidently_wrong and row.kind != "rigid", "paper"
    ),
)


def run(config: KindConfig) -> int:
    """Run what is missing; returns how many trials that were."""
    note_run(config.out, config)
    method = METHODS[config.method]
    seeds = range(config.first_seed, config.first_seed + config.runs)
    wanted = keys([cell.name for cell in config.cells()], [config.method], seeds)
    file = config.out / f"{config.method}.jsonl"
    return fill(file, wanted, lambda some: run_trials(method, some), method.batch)


def kind_table(rows: Sequence[TrialRow]) -> str:
    """Outcomes against travel, for every method that was run."""
    lines = []
    for method, _, cells in _series(rows):
        for cell, some in cells:
            shares = [percent(share([o.happened(row) for row in some])) for o in OUTCOMES]
            lines.append([cell.travel_name, NAMES[method], str(len(some)), *shares])
    return markdown(["travel", "method", "trials", *(f"{o.name}, %" for o in OUTCOMES)], lines)


def kind_summary(rows: Sequence[TrialRow]) -> str:
    """From which travel on the kind is right, and what happened before that."""
    lines = []
    for method, part, cells in _series(rows):
        unit = "deg" if part == "door" else "cm"
        first = len(cells)
        while first > 0 and share([row.kind_right for row in cells[first - 1][1]]).value >= SURE:
            first -= 1
        before = [row for _, some in cells[:first] for row in some]
        wrong = sum(row.confidently_wrong for row in before)
        rigid = sum(row.confidently_wrong and row.kind == "rigid" for row in before)
        start = f"never right in {100 * SURE:g} % of the trials for good"
        if first < len(cells):
            travel = f"{cells[first][0].travel:g} {unit}"
            start = f"right in {100 * SURE:g} % of the trials or more from {travel} on"
        lines.append(
            f"- {NAMES[method]}, {part}s: {start}; before that confidently wrong in {wrong} of "
            f"{len(before)} trials, {rigid} of them named rigid."
        )
    return "\n".join(lines)


def kind_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Shares of the outcomes against travel; the graph's as lines with bands."""
    series = [s for s in _series(rows) if s[0] == "graph"]
    if not series:
        raise NoRows("no trials of the graph: run experiments.kind_against_travel")
    figure, axes = new_figure(2, 3.4)
    for ax, (_, part, cells) in zip(axes, series, strict=False):
        travel = [cell.travel for cell, _ in cells]
        for outcome in OUTCOMES:
            shares = [share([outcome.happened(row) for row in some]) for _, some in cells]
            line_with_band(ax, travel, shares, COLOURS[outcome.colour], factor=100)
        ax.set(xscale="log", ylim=(-3, 103))
        ax.set_xlabel(f"travel of the {part}, {'deg' if part == 'door' else 'cm'}")
        log_ticks(ax.xaxis, [0.5, 1, 2, 5, 10, 20, 40])
    axes[0].set_ylabel("trials, %")
    for outcome in OUTCOMES:
        axes[-1].plot([], [], color=COLOURS[outcome.colour], label=outcome.name)
    figure.legend(loc="outside right center")
    save(figure, file)


def _series(
    rows: Sequence[TrialRow],
) -> list[tuple[str, str, list[tuple[Cell, list[TrialRow]]]]]:
    """Method, part, and the cells in the order of their travel."""
    found = []
    for method in METHODS:
        groups = grouped(of_method(rows, method), lambda row: row.cell)
        cells = sorted(
            ((cell_named(name), some) for name, some in groups.items()),
            key=lambda entry: entry[0].travel,
        )
        for part in ("door", "drawer"):
            here = [entry for entry in cells if entry[0].part == part]
            if here:
                found.append((method, part, here))
    if not found:
        raise NoRows("no trials: run experiments.kind_against_travel")
    return found


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = KindConfig()
    parser.add_argument("--method", choices=tuple(METHODS), default=default.method)
    parser.add_argument("--runs", type=int, default=default.runs, help="trials a travel")
    parser.add_argument("--first-seed", type=int, default=default.first_seed)
    parser.add_argument("--travels", type=float, nargs="+", default=default.travels)
    parser.add_argument("--out", type=Path, default=default.out)
    arguments = vars(parser.parse_args())
    with ends_in_one_line("kind_against_travel"):
        run(KindConfig(**{**arguments, "travels": tuple(arguments["travels"])}))


if __name__ == "__main__":
    main()
