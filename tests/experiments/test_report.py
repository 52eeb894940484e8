import pytest

from akm_fg.config import AkmConfig
from akm_fg.io.config_file import with_changes
from experiments.accuracy_grid import AccuracyConfig
from experiments.pages.tables import NoRows
from experiments.report import FOLDERS, PAGE, PARTS, figures, provenance_table, renewed, tables
from experiments.rows.provenance import note_run, runs_of

PAGE_TEXT = """# Page
<!-- table: one -->
old
<!-- end -->
written by hand
<!-- table: two -->
<!-- end -->
"""


def test_only_what_is_between_the_markers_changes():
    text = renewed(PAGE_TEXT, {"one": "| new |"})
    assert "old" not in text and "written by hand" in text
    assert text.endswith("<!-- table: two -->\n<!-- end -->\n")
    assert renewed(text, {"one": "| new |"}) == text


def test_a_table_without_a_place_is_an_error():
    with pytest.raises(ValueError, match=r"no place for.*three"):
        renewed(PAGE_TEXT, {"three": ""})


def test_the_page_has_a_place_for_every_table_and_shows_every_figure():
    page = PAGE.read_text()
    names = [part.name for part in PARTS if part.table] + [f"rows-{folder}" for folder in FOLDERS]
    for name in names:
        assert f"<!-- table: {name} -->" in page
    for part in PARTS:
        if part.figure:
            assert f"](images/{part.name}.png)" in page


def test_tables_and_figures_of_what_has_rows_are_made_and_the_rest_is_left(accuracy_rows, tmp_path):
    folder = accuracy_rows.parent
    only = ("accuracy-kind", "coverage-of-tracks", "surface-gain", "rows-accuracy")
    found = tables(folder, only)
    assert set(found) == {"accuracy-kind", "rows-accuracy"}
    assert "| graph | 24 | 0 to 1 |" in found["rows-accuracy"]
    [file] = figures(folder, tmp_path, only)
    assert file.name == "coverage-of-tracks.png" and file.exists()


def test_a_run_is_noted_with_machine_and_revision(tmp_path):
    note_run(tmp_path)
    note_run(tmp_path, AccuracyConfig(runs=7, out=tmp_path))
    first, second = runs_of(tmp_path)
    assert first["machine"] == second["machine"] and first["revision"]
    assert first["packages"]["gtsam"]
    assert second["experiment"]["runs"] == 7 and second["experiment"]["out"] == str(tmp_path)
    assert with_changes(AkmConfig(), second["config"], "the note") == AkmConfig()


def test_a_folder_without_rows_has_no_provenance(tmp_path):
    with pytest.raises(NoRows):
        provenance_table(tmp_path / "absent")
