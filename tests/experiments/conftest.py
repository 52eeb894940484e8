"""Trials that were run once for all tests, and rows whose numbers are made up."""

from dataclasses import replace

import pytest

from experiments.accuracy_grid import AccuracyConfig, run
from experiments.rows.rows import Key, trial_row
from experiments.trials.cells import Cell
from experiments.trials.track_methods import METHODS, run_trials


@pytest.fixture(scope="session")
def accuracy_rows(tmp_path_factory):
    """Two trials of the graph in each of the twelve cells, in a folder of their own."""
    folder = tmp_path_factory.mktemp("rows") / "accuracy"
    assert run(AccuracyConfig(runs=2, first_seed=0, out=folder)) == 24
    return folder


@pytest.fixture(scope="session")
def a_row():
    """A row of the graph that a test may change: a_row(kind=..., errors=..., ...)."""
    key = Key(Cell("door", 40.0).name, "graph", 0)
    row = next(iter(run_trials(METHODS["graph"], [key])))

    def changed(**fields):
        return replace(row, **fields)

    return changed


@pytest.fixture(scope="session")
def row_of_answer():
    """row_of_answer(answer): scored against an opening of a door."""

    cell = Cell("door", 40.0)

    def make(answer):
        return trial_row(Key(cell.name, "graph", 0), cell.opening(0).truth, answer, None)

    return make
