"""`akm-fg fit`: one clear line for each bad input, exit code 2, and the others still done."""

import json
import shutil

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.cli.fit import FitArguments, fit
from akm_fg.cli.main import main
from akm_fg.io.recording import write_recording
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from factors.joint import Joint


def _drawer_points(frames=8, points=12, travel_m=0.15, noise_m=0.001, seed=0):
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-0.2, 0.2, (points, 3))
    q = np.linspace(0, travel_m, frames)
    R, t = Joint("prismatic", np.eye(4), 0.0).motion(q)
    return (
        np.einsum("tij,nj->tni", R, shape)
        + t[:, None]
        + rng.normal(0, noise_m, (frames, points, 3))
    )


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "good.npz"
    np.savez(path, points=_drawer_points(), sigma_m=0.001)
    return path


@pytest.fixture
def recording(tmp_path):
    """A recording of a plain wall: sound, though nothing moves in it."""
    camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    depth = np.full((48, 64), 1.0, np.float32)
    depth[10:40, 15:50] = 0.8
    up = gtsam.Pose3(gtsam.Rot3(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])), np.zeros(3))
    frames = tuple(RgbdFrame(0.1 * i, rgb, depth, camera, up) for i in range(4))
    folder = tmp_path / "recording"
    write_recording(folder, Recording("wall", frames))
    return folder


def _edit(folder, **changes):
    path = folder / "recording.json"
    described = json.loads(path.read_text())
    for name, value in changes.items():
        if value is None:
            del described[name]
        else:
            described[name] = value
    path.write_text(json.dumps(described))


def _truncated_png(tmp_path, recording):
    path = recording / "rgb" / "000001.png"
    path.write_bytes(path.read_bytes()[:-40])
    return recording


def _other_depth_size(tmp_path, recording):
    cv2.imwrite(str(recording / "depth" / "000002.png"), np.ones((20, 20), np.uint16))
    return recording


def _nan_intrinsics(tmp_path, recording):
    described = json.loads((recording / "recording.json").read_text())
    _edit(recording, camera={**described["camera"], "fx": float("nan")})
    return recording


def _missing_field(tmp_path, recording):
    _edit(recording, depth_unit_m=None)
    return recording


def _ragged_log(tmp_path, recording):
    path = tmp_path / "ragged.log"
    path.write_text("0 0 0\n0 0 0.1\n0 0.2\n")
    return path


def _one_frame_log(tmp_path, recording):
    path = tmp_path / "one.log"
    path.write_text("0 0 0\n")
    return path


def _one_frame_tracks(tmp_path, recording):
    path = tmp_path / "one.npz"
    np.savez(path, points=np.zeros((1, 5, 3)))
    return path


def _still_tracks(tmp_path, recording):
    path = tmp_path / "still.npz"
    np.savez(path, points=_drawer_points(frames=20, travel_m=0.0), sigma_m=0.001)
    return path


def _still_recording(tmp_path, recording):
    return recording


def _lost_tracks(tmp_path, recording):
    path = tmp_path / "lost.npz"
    np.savez(path, points=np.full((5, 4, 3), np.nan))
    return path


def _pickled(tmp_path, recording):
    path = tmp_path / "pickled.npz"
    np.savez(path, points=np.array([{"a": 1}], dtype=object))
    return path


def _missing(tmp_path, recording):
    return tmp_path / "nowhere"


def _folder_of_something_else(tmp_path, recording):
    folder = tmp_path / "photos"
    shutil.copytree(recording / "rgb", folder)
    return folder


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (_missing, "does not exist"),
        (_folder_of_something_else, "recording.json"),
        (_truncated_png, "000001.png"),
        (_other_depth_size, "000002.png"),
        (_nan_intrinsics, "fx"),
        (_missing_field, "depth_unit_m"),
        (_ragged_log, "line 3"),
        (_one_frame_log, "one.log"),
        (_one_frame_tracks, "one.npz"),
        (_still_tracks, "nothing moved"),
        (_still_recording, "nothing moved"),
        (_lost_tracks, "lost.npz"),
        (_pickled, "pickled.npz"),
    ],
)
def test_a_bad_input_gets_one_line_and_the_others_are_done(
    make, words, tmp_path, recording, good, capfd
):
    bad, out = make(tmp_path, recording), tmp_path / "out.jsonl"
    code = main(["fit", str(bad), str(good), "--json", str(out)])
    lines = [line for line in capfd.readouterr().err.splitlines() if line.strip()]
    assert code == 2
    assert len(lines) == 1, lines
    assert words in lines[0] and bad.name in lines[0]
    assert "expected" in lines[0]
    done = [json.loads(line) for line in out.read_text().splitlines()]
    assert done[-1]["input"] == str(good)
    assert done[-1]["kind"] == "prismatic"


def test_an_unwritable_output_is_told_before_any_work(tmp_path, good, capfd):
    code = main(["fit", str(good), "--json", str(tmp_path / "no" / "such" / "folder" / "x.json")])
    captured = capfd.readouterr()
    assert code == 2
    assert captured.out == ""
    assert "cannot be written" in captured.err and "expected" in captured.err


def test_no_input_is_told(capfd):
    assert main(["fit"]) == 2
    assert "no inputs" in capfd.readouterr().err


def test_json_on_standard_output_is_one_strict_object_a_line(good, tmp_path, capfd):
    other = tmp_path / "other.npz"
    np.savez(other, points=_drawer_points(seed=1))
    assert main(["fit", str(good), str(other), "--json", "-"]) == 0
    lines = capfd.readouterr().out.splitlines()
    posteriors = [
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
        for line in lines
    ]
    assert [p["input"] for p in posteriors] == [str(good), str(other)]
    for posterior in posteriors:
        assert posterior["schema"] == "akm-fg/posterior/1"
        assert set(posterior["kind_probability"]) == {"rigid", "prismatic", "revolute", "helical"}
        assert np.shape(posterior["joint"]["cov"]) == (6, 6)
        assert posterior["joint"]["pivot"] is None
        assert posterior["joint"]["gauge"] == ["wz", "vx", "vy", "vz"]
        assert len(posterior["states"]["mean"]) == len(posterior["states"]["sd"]) == 8
        assert posterior["states"]["unit"] == "m"
        assert set(posterior["alternatives"]) == {"rigid", "revolute", "helical"}
        np.testing.assert_allclose(np.abs(posterior["joint"]["axis"]), [0, 0, 1], atol=0.01)


def test_a_frame_that_nobody_saw_is_null(tmp_path, capfd):
    points = _drawer_points()
    points[3] = np.nan
    np.savez(tmp_path / "gap.npz", points=points, sigma_m=0.001)
    assert main(["fit", str(tmp_path / "gap.npz"), "--json", "-"]) == 0
    states = json.loads(capfd.readouterr().out)["states"]
    assert states["mean"][3] is None and states["sd"][3] is None
    assert states["mean"][4] is not None


def test_the_table_names_every_input(good, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")  # folders of tests have long names
    assert main(["fit", str(good)]) == 0
    out = capfd.readouterr().out
    assert "good.npz" in out and "prismatic" in out


def test_an_interruption_keeps_what_is_done(good, tmp_path, capfd):
    out = tmp_path / "out.jsonl"

    def interrupted_at_the_second(number, total, path):
        if number == 2:
            assert len(out.read_text().splitlines()) == 1  # on disk already: a kill loses nothing
            raise KeyboardInterrupt

    arguments = FitArguments((good, good, good), json=str(out))
    code = fit(arguments, progress=interrupted_at_the_second)
    assert code == 130
    assert len(out.read_text().splitlines()) == 1
    assert "1 of 3 inputs done" in capfd.readouterr().err


@pytest.mark.parametrize("command", [[], ["fit"], ["demo"], ["doctor"]])
def test_help_opens_with_an_example(command, capfd):
    with pytest.raises(SystemExit) as done:
        main([*command, "--help"])
    assert done.value.code == 0
    assert "Example: akm-fg" in capfd.readouterr().out


def test_an_unknown_option_is_exit_code_2(capfd):
    with pytest.raises(SystemExit) as done:
        main(["fit", "--no-such-option"])
    assert done.value.code == 2
