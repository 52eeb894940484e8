"""Recordings of other formats that are spoilt: read, or one line that says why not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from akm_fg.errors import AkmError
from akm_fg.io.inputs import read_input
from akm_fg.records import Recording
from tests.akm_fg.io.sources.test_bad_sources import small
from tests.spoiled import CHANGES, CUT, SWAPS, spoiled

# A warning would be a second line on standard error.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error::RuntimeWarning")]

FORMATS = ("tum", "redwood", "video", "r3d", "ros1", "mcap")


@pytest.fixture(scope="module")
def sound(write: dict, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A sound recording of each format."""
    root = tmp_path_factory.mktemp("sound")
    made = {name: root / name / "a" for name in FORMATS}
    for path in made.values():
        path.parent.mkdir()
    return {name: write[name](path, small()) for name, path in made.items()}


@pytest.mark.parametrize("name", FORMATS)
@settings(
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(st.integers(0, 100), CHANGES, SWAPS, CUT)
@example(0, [], [(3, b"1e300")], 0)
@example(1, [], [(3, b"1e300")], 0)
def test_a_spoilt_recording_is_read_or_refused_in_a_line(
    sound: dict[str, Path],
    name: str,
    tmp_path: Path,
    which: int,
    changes: list[tuple[int, int]],
    swaps: list[tuple[int, bytes]],
    cut: int,
) -> None:
    copy = tmp_path / "copy" / sound[name].name
    shutil.rmtree(copy.parent, ignore_errors=True)
    copy.parent.mkdir()
    if sound[name].is_dir():
        shutil.copytree(sound[name], copy)
        files = sorted(path for path in copy.rglob("*") if path.is_file())
        files.sort(key=lambda path: path.suffix in (".png", ".jpg"))  # text is first
        file = files[which % len(files)]
    else:
        shutil.copy(sound[name], copy)
        file = copy
    file.write_bytes(spoiled(file.read_bytes(), changes, swaps, cut))
    try:
        assert isinstance(read_input(copy), Recording)
    except AkmError as error:
        assert "\n" not in str(error)
