"""What `import akm_fg` offers, and how a posterior shows itself."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import akm_fg
from akm_fg.cli.main import main
from akm_fg.config import AkmConfig
from akm_fg.errors import InputError
from akm_fg.io.posteriors.posterior_json import posterior_as_dict


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A door's marker, in millimetres."""
    angles = np.linspace(0, 1.0, 60)
    p = np.stack([500 * np.cos(angles), 500 * np.sin(angles), 0 * angles], axis=1)
    np.savetxt(tmp_path / "door.log", p + np.random.default_rng(0).normal(0, 0.5, p.shape))
    return tmp_path / "door.log"


def test_every_public_name_is_there_and_found_by_completion() -> None:
    for name in akm_fg.__all__:
        assert getattr(akm_fg, name) is not None and name in dir(akm_fg)
    with pytest.raises(AttributeError, match="'fits'"):
        _ = akm_fg.fits


def test_asking_for_names_loads_nothing_heavy() -> None:
    code = (
        "import sys, akm_fg; dir(akm_fg); akm_fg.fit, akm_fg.read_recording; "
        "print([m for m in ('numpy', 'gtsam', 'cv2', 'open3d', 'tyro') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_fit_says_what_the_command_says(log: Path, capfd: pytest.CaptureFixture[str]) -> None:
    posterior = akm_fg.fit(str(log))
    assert isinstance(posterior, akm_fg.ArticulationPosterior)
    assert main(["fit", str(log), "--json", "-"]) == 0
    said, fields = json.loads(capfd.readouterr().out), posterior.to_dict()
    assert (
        {**said, "time_s": 0}
        == {**fields, "time_s": 0}
        == {**posterior_as_dict(posterior), "time_s": 0}
    )


def test_what_is_said_of_an_input_reaches_the_reader_and_the_estimator(log: Path) -> None:
    far = akm_fg.fit(log, unit="m").best.states
    near = akm_fg.fit(log, unit="mm").best.states
    assert far is not None and near is not None
    assert akm_fg.fit(log, unit="mm").fit.warnings == ()
    other = AkmConfig()
    other = replace(other, fit=replace(other.fit, undecided_below=1.1))
    assert akm_fg.fit(log, config=other).kind == "undecided"
    with pytest.raises(InputError, match="no frames to choose from"):
        akm_fg.fit(log, frames=3)


def test_a_recording_is_read(door, tmp_path: Path) -> None:
    from akm_fg.io.recording import write_recording

    write_recording(tmp_path / "door", door.recording)
    recording = akm_fg.read_recording(str(tmp_path / "door"))
    assert isinstance(recording, akm_fg.Recording)
    assert len(recording.frames) == len(door.recording.frames)
    assert repr(recording) == f"<Recording door: {len(recording.frames)} frames of 320 x 240>"


def test_tracks_and_logs_are_no_recording(log: Path) -> None:
    with pytest.raises(InputError, match=r"holds no images; expected a recording"):
        akm_fg.read_recording(log)


def test_a_posterior_shows_itself_in_words(log: Path) -> None:
    posterior = akm_fg.fit(log)
    lines = posterior.summary().splitlines()
    assert lines[0].startswith(f"{log}: revolute (probability ")
    assert "> 0.999" in lines[0] or "0.9" in lines[0]
    assert lines[1].startswith("axis (") and ", 1.000) ± " in lines[1] and lines[1].endswith(" deg")
    assert lines[2].startswith("pivot (") and lines[2].endswith(" cm")
    assert "57." in lines[3] and "deg in frame 59, seen in 60 of 60 frames" in lines[3]
    assert lines[4].startswith("note: positions span")
    text = repr(posterior)
    assert text.startswith("<ArticulationPosterior ") and "\n" not in text and len(text) < 600
    assert "revolute" in text and "array(" not in text


def test_a_drawer_and_a_part_at_rest_show_themselves_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    shape = rng.uniform(-0.2, 0.2, (12, 3))
    for travel_m, words in ((0.15, "state 1"), (0.0, "rigid")):
        q = np.linspace(0, travel_m, 20)[:, None, None] * np.array([1.0, 0, 0])
        points = shape + q + rng.normal(0, 1e-3, (20, 12, 3))
        np.savez(tmp_path / "a.npz", points=points, sigma_m=1e-3)
        summary = akm_fg.fit(tmp_path / "a.npz").summary()
        assert words in summary and "pivot" not in summary
