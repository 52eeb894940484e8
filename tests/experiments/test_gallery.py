"""The gallery: its page shows every case, and what is refused is an answer too."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from experiments.gallery import CASES, WIDTH_PX, answer

PAGE = Path(__file__).resolve().parents[2] / "docs" / "start" / "gallery.md"


def test_the_page_shows_every_case_by_a_small_picture_and_its_words() -> None:
    page, files = PAGE.read_text(), {file.name for file in (PAGE.parent / "gallery").iterdir()}
    assert files == {f"{case.name}.{ending}" for case in CASES for ending in ("jpg", "txt")}
    for name in files:
        assert f"gallery/{name}" in page
        assert (PAGE.parent / "gallery" / name).stat().st_size < 100_000


def test_a_refusal_is_shown_with_its_line() -> None:
    camera = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
    rgb, depth_m = np.full((240, 320, 3), 90, np.uint8), np.full((240, 320), 1.5, np.float32)
    frames = [RgbdFrame(0.1 * i, rgb, depth_m, camera, gtsam.Pose3()) for i in range(4)]
    picture, text = answer(Recording("wall", tuple(frames)), None, "wall")
    assert text.startswith("refused: ") and "; expected " in text
    assert picture.shape == (WIDTH_PX * 3 // 4, 2 * WIDTH_PX, 3)
