import json
from dataclasses import replace

import pytest

from experiments.rows.rows import Key, append_row, fill, keys, read_rows
from experiments.scores.answers import failed
from experiments.scores.scoring import Errors


def test_a_row_comes_back_from_its_file_as_it_was(tmp_path, a_row):
    append_row(tmp_path / "new" / "graph.jsonl", a_row())
    assert read_rows(tmp_path / "new") == [a_row()]


def test_unknown_numbers_are_null_in_the_file(tmp_path, a_row):
    append_row(tmp_path / "graph.jsonl", a_row(errors=Errors(axis_error_deg=float("nan"))))
    data = json.loads((tmp_path / "graph.jsonl").read_text())
    assert data["errors"]["axis_error_deg"] is None and data["failure"] is None


def _trials(a_row, asked):
    """A `run_batch` that notes what it was asked for."""

    def run_batch(some):
        for key in some:
            asked.append(key)
            yield a_row(cell=key.cell, method=key.method, seed=key.seed)

    return run_batch


def test_only_missing_trials_are_run(tmp_path, a_row):
    file, asked = tmp_path / "graph.jsonl", []
    assert fill(file, keys(["a", "b"], ["graph"], range(2)), _trials(a_row, asked)) == 4
    assert fill(file, keys(["a", "b"], ["graph"], range(3)), _trials(a_row, asked), batch=5) == 2
    assert asked[4:] == [Key("a", "graph", 2), Key("b", "graph", 2)]
    assert [row.key for row in read_rows(tmp_path)] == sorted(asked)


def test_trials_in_another_file_of_the_folder_are_not_run_again(tmp_path, a_row):
    append_row(tmp_path / "other.jsonl", a_row())
    assert fill(tmp_path / "graph.jsonl", [a_row().key], _trials(a_row, [])) == 0


def test_rows_before_an_interruption_are_kept_and_the_rest_is_run_later(tmp_path, a_row):
    file, asked = tmp_path / "graph.jsonl", []

    def interrupted(some):
        for row in _trials(a_row, asked)(some):
            if row.seed == 2:
                raise KeyboardInterrupt
            yield row

    wanted = list(keys(["a"], ["graph"], range(4)))
    with pytest.raises(KeyboardInterrupt):
        fill(file, wanted, interrupted, batch=4)
    assert len(read_rows(tmp_path)) == 2
    assert fill(file, wanted, _trials(a_row, asked)) == 2


def test_half_a_line_is_left_out_and_does_not_spoil_the_next(tmp_path, a_row):
    file = tmp_path / "graph.jsonl"
    append_row(file, a_row(seed=1))
    file.write_text(file.read_text() + '{"cell": "door 15 d')
    append_row(file, a_row(seed=2))
    assert [row.seed for row in read_rows(tmp_path)] == [1, 2]


def test_rows_of_another_version_are_refused_by_place(tmp_path, a_row):
    append_row(tmp_path / "graph.jsonl", a_row())
    text = (tmp_path / "graph.jsonl").read_text()
    for wrong in (text.replace('"brier"', '"briar"'), text.replace('"nees_axis"', '"nees_axes"')):
        (tmp_path / "graph.jsonl").write_text(wrong)
        with pytest.raises(ValueError, match=r"graph.jsonl:1.*another version"):
            read_rows(tmp_path)


@pytest.mark.parametrize(
    ("axis_deg", "distance_m", "inside"),
    [(0.9, 0.009, True), (1.1, 0.009, False), (0.9, 0.011, False)],
)
def test_inside_asks_for_axis_and_distance(a_row, axis_deg, distance_m, inside):
    row = a_row(errors=Errors(axis_error_deg=axis_deg, line_distance_m=distance_m))
    assert row.within(1.0) is inside
    assert row.within(2.0)
    assert not replace(row, kind="undecided").within(2.0)


def test_a_drawer_needs_no_pivot_to_be_inside(a_row):
    row = a_row(kind_true="prismatic", kind="prismatic", errors=Errors(axis_error_deg=0.5))
    assert row.within(1.0)


@pytest.mark.parametrize(
    ("kind", "right", "wrong"),
    [
        ("revolute", True, False),
        ("prismatic", False, True),
        ("rigid", False, True),
        ("undecided", False, False),
        (None, False, False),
    ],
)
def test_undecided_and_failed_are_neither_right_nor_confidently_wrong(a_row, kind, right, wrong):
    row = a_row(kind=kind)
    assert (row.kind_right, row.confidently_wrong) == (right, wrong)


def test_a_failure_is_a_row_without_errors(row_of_answer):
    row = row_of_answer(failed(RuntimeError("singular")))
    assert row.failure == "RuntimeError: singular"
    assert row.kind is None and row.errors == Errors() and not row.within(20.0)
