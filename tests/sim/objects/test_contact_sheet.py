from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import cv2
import numpy as np
import pytest

from akm_fg.errors import MotionInfeasible
from sim.objects.contact_sheet import Cell, SheetConfig, label_of, lay_out, main, take_cell
from sim.objects.suites.catalogue import find_suite

SMALL = SheetConfig(columns=4, width=80)


def flat(colour: tuple[int, int, int]) -> np.ndarray:
    return np.full((SMALL.height, SMALL.width, 3), colour, dtype=np.uint8)


def test_objects_stand_in_rows_closed_left_of_open_under_their_names():
    red, blue = (200, 0, 0), (0, 0, 200)
    page = lay_out([Cell(f"object {i}", flat(red), flat(blue)) for i in range(3)], SMALL)
    row = SMALL.label + SMALL.height + SMALL.gap
    assert page.shape == (2 * row, 2 * (2 * 80 + SMALL.gap) - SMALL.gap, 3)
    for i in range(3):
        top, left = (i // 2) * row, (i % 2) * (2 * 80 + SMALL.gap)
        picture = page[top + SMALL.label : top + SMALL.label + SMALL.height]
        assert (picture[:, left : left + 80] == red).all()
        assert (picture[:, left + 80 : left + 160] == blue).all()
        assert (page[top : top + SMALL.label, left : left + 80] < 128).sum() > 50  # the name
    assert (page[row:, 2 * 80 + SMALL.gap :] == 255).all()


def test_a_cell_shows_the_object_closed_and_open_and_what_it_is():
    spec = find_suite("furniture-dev").load("drawer-001")
    cell = take_cell(spec, 0, SMALL)
    assert cell.label == label_of(spec) == "drawer-001 chest, arch"
    assert cell.opened is not None and cell.closed.shape == (60, 80, 3)
    assert (np.abs(cell.opened.astype(int) - cell.closed) > 20).any(axis=2).mean() > 0.05


def broken(name: str, *_: object) -> NoReturn:
    raise MotionInfeasible(f"{name}: no place")


def test_an_object_that_cannot_be_built_gets_a_cell_that_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    out = tmp_path / "pages" / "dev.jpg"
    command = ["--suite", "furniture-dev", "--out", str(out), "--processes", "1"]
    assert main(command, broken) == 1
    assert "0 of 40 objects" in " ".join(capsys.readouterr().err.split())
    page = cv2.imread(str(out))
    assert page is not None and (page > 200).mean() > 0.9


def test_a_page_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "file").touch()
    for out in (tmp_path / "file" / "page.jpg", tmp_path / "page.nothing"):
        arguments = ["--suite", "furniture-dev", "--out", str(out), "--processes", "1"]
        assert main(arguments, broken) == 2
        assert out.name in capsys.readouterr().err.replace("\n", "")


def test_a_page_of_some_objects_alone_and_a_name_that_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    command = ["--suite", "furniture-dev", "--processes", "1", "--out", str(tmp_path / "some.jpg")]
    assert main([*command, "--only", "door-001", "drawer-002"], broken) == 1
    assert "0 of 2 objects" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(SystemExit):
        main([*command, "--only", "door-099"], broken)
    assert "no such object" in capsys.readouterr().err
