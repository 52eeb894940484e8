"""How accurate is a joint from tracks, for graph, paper's method and peer on the same tracks?

    python -m experiments.accuracy_grid --part table --method graph --runs 200
    python -m experiments.accuracy_grid --part table --method paper --runs 48
    python -m experiments.accuracy_grid --part table --method peer --runs 48
    python -m experiments.accuracy_grid --part grid --method graph --runs 20

Noise, travel, number of tracks, and clean, drifting or spatially correlated tracks
(`experiments.trials.cells`). One row a trial in OUT/METHOD.jsonl, as it ends; what is there is not
done
again, and two processes may fill one folder with different seeds. `experiments.report` makes the
tables and figures of docs/experiments.md. A trial takes the graph 0.1 s, the paper's method 2 s,
the peer 0.5 s.
"""

from __future__ import annotations

import argparse
import fnmatch
from dataclasses import dataclass
from pathlib import Path

from experiments.pages.one_line import ends_in_one_line
from experiments.rows.provenance import note_run
from experiments.rows.rows import fill, keys
from experiments.trials.cells import Cell, grid_cells, table_cells
from experiments.trials.track_methods import METHODS, run_trials

FIRST_SEED = 20_000  # nothing was tuned on seeds from here on


@dataclass(frozen=True, slots=True)
class AccuracyConfig:
    """Which trials are run."""

    part: str = "table"  # the twelve cells of the table, or the whole grid
    method: str = "graph"
    runs: int = 200  # a cell
    first_seed: int = FIRST_SEED
    cells: str = "*"  # glob of the cells' names
    out: Path = Path("runs/accuracy")

    def chosen(self) -> list[Cell]:
        """The cells."""
        cells = table_cells() if self.part == "table" else grid_cells()
        return [cell for cell in cells if fnmatch.fnmatch(cell.name, self.cells)]


def run(config: AccuracyConfig) -> int:
    """Run what is missing; returns how many trials that were."""
    note_run(config.out, config)
    method = METHODS[config.method]
    seeds = range(config.first_seed, config.first_seed + config.runs)
    wanted = keys([cell.name for cell in config.chosen()], [config.method], seeds)
    return fill(
        config.out / f"{config.method}.jsonl",
        wanted,
        lambda some: run_trials(method, some),
        method.batch,
    )


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = AccuracyConfig()
    parser.add_argument("--part", choices=("table", "grid"), default=default.part)
    parser.add_argument("--method", choices=tuple(METHODS), default=default.method)
    parser.add_argument("--runs", type=int, default=default.runs, help="trials a cell")
    parser.add_argument("--first-seed", type=int, default=default.first_seed)
    parser.add_argument("--cells", default=default.cells, help="a glob, such as '*clean'")
    parser.add_argument("--out", type=Path, default=default.out)
    with ends_in_one_line("accuracy_grid"):
        run(AccuracyConfig(**vars(parser.parse_args())))


if __name__ == "__main__":
    main()
