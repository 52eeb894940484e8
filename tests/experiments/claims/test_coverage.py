from dataclasses import replace

import pytest

from experiments.claims import coverage
from experiments.pages.tables import NoRows
from experiments.rows.rows import read_rows


def _rows(a_row, inside):
    """As many rows as flags; the NEES of the joint 4.8 each, of the last state 2."""
    claimed = a_row().consistency
    return [
        a_row(
            seed=i,
            brier=0.25,
            consistency=replace(
                claimed, joint_inside95=flag, nees_joint=4.8, dof_joint=4, nees_last_state=2.0
            ),
        )
        for i, flag in enumerate(inside)
    ]


def test_coverage_nees_and_brier_are_those_of_the_rows(a_row):
    """40 degrees of freedom: chi-square 24.43 to 59.34."""
    rows = _rows(a_row, [True] * 8 + [False] * 2)
    [line] = [x for x in coverage.tracks_table(rows).splitlines() if "door 40" in x]
    assert "| 10 | 1.20 (0.61 to 1.48) | 2.00 (0.32 to 2.05) |" in line
    assert "| 80.0 (49 to 94) |" in line and line.endswith("| 0.250 |")


def test_the_grid_is_pooled_over_travels(accuracy_rows):
    text = coverage.grid_table(read_rows(accuracy_rows))
    assert "| clean, 3 mm, 40 tracks | 12 |" in text
    assert "| drifting, 3 mm, 40 tracks | 12 |" in text


def test_recordings_are_told_apart_by_what_was_given_and_by_kind(a_row):
    rows = [a_row(method=method, cell="r") for method in ("graph-surface", "graph-both")]
    rows.append(a_row(method="paper-fine", cell="r"))
    text = coverage.recordings_table(rows)
    assert "| surface |" in text and "| both, revolute |" in text and "paper" not in text


def test_figures_are_made_of_rows(a_row, tmp_path):
    coverage.tracks_figure(_rows(a_row, [True, False]), tmp_path / "a.png")
    rows = [a_row(method="graph-both", cell="r")]
    coverage.recordings_figure(rows, tmp_path / "b.png")
    assert (tmp_path / "a.png").stat().st_size > 1000 < (tmp_path / "b.png").stat().st_size


def test_without_rows_there_is_nothing_to_say(tmp_path):
    with pytest.raises(NoRows):
        coverage.recordings_figure([], tmp_path / "a.png")
