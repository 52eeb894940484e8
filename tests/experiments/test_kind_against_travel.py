from experiments.kind_against_travel import (
    KindConfig,
    kind_figure,
    kind_summary,
    kind_table,
    run,
)
from experiments.rows.rows import read_rows
from experiments.trials.cells import Cell


def test_the_smallest_run_gives_rows_table_and_figure_and_is_not_run_again(tmp_path):
    config = KindConfig(runs=1, first_seed=0, travels=(40.0,), out=tmp_path)
    assert run(config) == 2
    assert run(config) == 0
    text = kind_table(read_rows(tmp_path))
    assert text.index("| door 40 deg |") < text.index("| drawer 40 cm |")
    kind_figure(read_rows(tmp_path), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


def test_every_trial_ends_in_exactly_one_way(a_row):
    kinds = ["revolute", "undecided", None, "rigid", "prismatic"]
    rows = [a_row(seed=i, kind=kind) for i, kind in enumerate(kinds)]
    shares = [cell.split()[0] for cell in kind_table(rows).splitlines()[2].split("|")[4:8]]
    assert shares == ["20.0", "40.0", "20.0", "20.0"]


def test_the_travel_from_which_on_the_kind_is_right_counts_no_lucky_cell_before(a_row):
    """Right at 1 and 3 deg, wrong at 2: it can be told from 3 on."""
    kinds = {0.5: "rigid", 1.0: "revolute", 2.0: "prismatic", 3.0: "revolute"}
    rows = [a_row(cell=Cell("door", travel).name, kind=kind) for travel, kind in kinds.items()]
    text = kind_summary(rows)
    assert "from 3 deg on" in text
    assert "confidently wrong in 2 of 3 trials, 1 of them named rigid" in text
    assert "never" in kind_summary(rows[:3])
