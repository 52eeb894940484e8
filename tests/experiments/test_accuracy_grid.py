import pytest

from experiments.accuracy_grid import AccuracyConfig, run
from experiments.pages import accuracy_report
from experiments.pages.tables import NoRows
from experiments.rows.rows import read_rows
from experiments.scores.scoring import Errors

TABLES = (
    accuracy_report.axis_table,
    accuracy_report.inside_table,
    accuracy_report.kind_table,
    accuracy_report.pivot_table,
    accuracy_report.time_table,
    accuracy_report.grid_table,
    accuracy_report.cells_named_wrongly,
)
FIGURES = (
    accuracy_report.travel_figure,
    accuracy_report.inside_figure,
    accuracy_report.grid_figure,
)


def test_what_is_there_is_not_run_again(accuracy_rows):
    assert run(AccuracyConfig(runs=2, first_seed=0, out=accuracy_rows)) == 0


def test_cells_may_be_chosen_by_a_glob():
    config = AccuracyConfig(part="grid", cells="drawer 5 cm*correlated")
    assert len(config.chosen()) == 9


@pytest.mark.parametrize("table", TABLES, ids=lambda f: f.__name__)
def test_tables_are_made_of_rows(table, accuracy_rows):
    text = table(read_rows(accuracy_rows))
    columns = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert len(columns) <= 1 and "nan" not in text


@pytest.mark.parametrize("figure", FIGURES, ids=lambda f: f.__name__)
def test_figures_are_made_of_rows(figure, accuracy_rows, tmp_path):
    figure(read_rows(accuracy_rows), tmp_path / "new" / "figure.png")
    assert (tmp_path / "new" / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_the_median_and_the_share_inside_are_those_of_the_rows(a_row):
    name = "door 40 deg, 3 mm, 40 points, 20 frames, clean"
    errors = [0.25, 0.5, 3.0]
    rows = [
        a_row(cell=name, seed=i, errors=Errors(axis_error_deg=e, line_distance_m=0.001))
        for i, e in enumerate(errors)
    ]
    [line] = [x for x in accuracy_report.axis_table(rows).splitlines() if "door 40 deg" in x]
    assert line.split("|")[3:5] == [" 0.24 ", " 0.5 (0.25 to 3) "]
    [line] = [x for x in accuracy_report.inside_table(rows).splitlines() if "door 40 deg" in x]
    assert "66.7 (21 to 94)" in line


def test_a_trial_without_an_answer_counts_as_infinitely_far_off(a_row):
    rows = [a_row(seed=i, kind=None, errors=Errors()) for i in range(3)]
    assert "inf (inf to inf)" in accuracy_report.axis_table(rows)


def test_kinds_named_wrongly_are_listed_by_cell(a_row):
    rows = [a_row(seed=0), a_row(seed=1, kind="rigid")]
    assert "1 of 2 | rigid" in accuracy_report.cells_named_wrongly(rows)
    assert "No cell" in accuracy_report.cells_named_wrongly(rows[:1])


def test_without_rows_there_is_no_table():
    with pytest.raises(NoRows):
        accuracy_report.axis_table([])
