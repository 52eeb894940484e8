"""Errors and bounds along a pull: what is tabled is what the rows say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from experiments.along_the_pull import PullRow, figure, stops, table
from experiments.exploration import ExplorationRow

ROW = PullRow("s/door-001", 1, 0, False, 0.03, "revolute", "revolute", 0.5, 2.0, 0.004, 0.01)
EXPLORED = ExplorationRow(
    "s/door-001", "full", 1, "revolute", 1, True, True, 1, 0, "revolute", 0.4, 0.002, 1.0, True,
    0.06, [], None, ["opened"], 0.0, {}, 0.1, 1.0, None,
)  # fmt: skip


def test_a_bin_shows_medians_of_what_was_named_right() -> None:
    rows = [replace(ROW, name=f"s/door-{k:03d}", axis_error_deg=0.1 * k) for k in range(1, 6)]
    wrong = replace(ROW, name="s/door-009", kind="prismatic", axis_error_deg=90.0)
    line = table([*rows, wrong]).splitlines()[-1]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[0] == "1.5 to 4.5"
    assert cells[1] == "6"
    assert cells[3:7] == ["0.30", "2.00", "0.40", "1.00"]  # the wrong one's 90 deg left out
    assert cells[7].startswith("83")  # but counted as a failure


def test_few_stretches_of_a_bin_are_not_shown() -> None:
    assert len(table([ROW] * 4).splitlines()) == 2


def test_an_error_of_the_line_alone_is_no_success() -> None:
    assert ROW.within
    assert not replace(ROW, line_distance_m=0.011).within
    assert not replace(ROW, axis_error_deg=1.1).within
    assert not replace(ROW, kind="helical").within


def test_stops_are_compared_on_what_both_opened() -> None:
    other = replace(EXPLORED, name="s/door-002")  # that the threshold did not open
    threshold = replace(EXPLORED, setting="threshold", travel_m=0.10, axis_error_deg=1.5)
    lines = stops([EXPLORED, other, threshold]).splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [row[1] for row in cells] == ["1", "1"]
    assert [row[2] for row in cells] == ["6.00", "10.00"]
    assert cells[0][6].startswith("100")
    assert cells[1][6].startswith("0")


def test_a_figure_is_drawn(tmp_path: Path) -> None:
    rows = [replace(ROW, last=k == 5) for k in range(6)]
    figure(rows, tmp_path / "pull.png")
    assert (tmp_path / "pull.png").read_bytes().startswith(b"\x89PNG")
