from dataclasses import replace

import numpy as np
import pytest

from experiments.peers.ripl import PYTHON
from experiments.rows.rows import Key
from experiments.trials.cells import Cell
from experiments.trials.track_methods import METHODS, graph_method, paper_method, run_trials

DOOR = Cell("door", 40.0, noise_mm=1.0).name
DRAWER = Cell("drawer", 40.0, noise_mm=1.0).name


def _rows(method, cells=(DOOR, DRAWER)):
    if isinstance(method, str):
        method = METHODS[method]
    return list(run_trials(method, [Key(cell, method.name, 0) for cell in cells]))


def _without_times(row):
    return replace(row, time_s={}, cpu_s=None)


def test_the_graph_gives_the_same_row_every_time_with_covariance_and_probability():
    first, again = _rows("graph"), _rows("graph")
    assert [_without_times(row) for row in first] == [_without_times(row) for row in again]
    for row in first:
        assert row.within(1.0) and row.brier < 0.1 and row.consistency.nees_joint > 0
        assert row.time_s["total"] > 0 and row.failure is None


def test_the_papers_method_gives_errors_and_no_covariance():
    pytest.importorskip("torch")
    for row in _rows(paper_method(starts=4)):
        assert row.kind_right and row.errors.axis_error_deg < 5
        assert row.consistency.nees_joint is None and row.brier is None


@pytest.mark.slow
@pytest.mark.skipif(not PYTHON.exists(), reason="the peer is not installed (`make peer`)")
def test_the_peer_is_scored_as_the_true_kind_whatever_it_is_taken_for():
    for row in _rows("peer"):
        assert row.kind_right and row.errors.axis_error_deg < 5


def test_a_method_that_raises_leaves_a_row_that_says_so():
    def broken(tracks, seed):
        raise np.linalg.LinAlgError("singular")

    for row in _rows(graph_method(broken)):
        assert row.failure == "LinAlgError: singular" and row.kind is None
