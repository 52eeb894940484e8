"""librealsense may end or hang on a broken file: in a process of its own, which is given up."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from akm_fg.errors import InputError
from akm_fg.io.sources.realsense import playback

ANSWERS = {
    "import os; os.kill(os.getpid(), 11)": "librealsense ended on it",
    "import time; time.sleep(60)": "librealsense said nothing for 0.5 s",
    'print(\'{"error": "no such thing"}\')': "no such thing",
    'print(\'{"sides": {"depth": {}}}\')': "has no colour stream",
    'print(\'{"sides": {"depth": {}, "colour": {}}}\')': "librealsense ended on it",
}


@pytest.mark.parametrize("code", ANSWERS)
def test_a_player_that_fails_is_one_line(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(b"")
    stand_in = tmp_path / "python"
    stand_in.write_text(f"#!{sys.executable}\n{code}\n")
    stand_in.chmod(0o755)
    monkeypatch.setattr(playback.sys, "executable", str(stand_in))
    patience_s = 0.5 if "sleep" in code else 60.0
    with pytest.raises(InputError, match=ANSWERS[code]):
        with playback.play(path, patience_s=patience_s) as played:
            list(played.pictures())
