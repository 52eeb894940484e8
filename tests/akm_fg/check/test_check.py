"""A look before a fit: what is measured, and which hints each defect gives."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg import pipeline
from akm_fg.check.measure import check_recording
from akm_fg.check.picture import overview
from akm_fg.cli.fit import FitArguments, _command
from akm_fg.cli.main import main
from akm_fg.errors import NoMotionObserved
from akm_fg.io.recording import write_recording
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.sensors import PROFILES, with_sensor
from akm_fg.records import Recording, RgbdFrame
from tests.akm_fg.conftest import PART, Cabinet, Clip, film


@pytest.fixture(scope="module")
def clip() -> Clip:
    return film(Cabinet("prismatic"), 0.25, 12)


def changed(clip: Clip, change: Callable[[int, RgbdFrame], RgbdFrame]) -> Recording:
    return Recording("changed", tuple(change(i, f) for i, f in enumerate(clip.frames)))


def test_a_sound_recording_is_measured_and_has_no_hints(clip: Clip) -> None:
    found = check_recording(clip.recording)
    assert found.hints == ()
    assert found.rate_hz == pytest.approx(10.0) and found.seconds == pytest.approx(1.1)
    assert found.floor is not None and found.floor.off_up_deg < 1.0
    assert found.floor.height_m == pytest.approx(clip.scene.eye[2], abs=0.02)
    eye, target = np.array(clip.scene.eye), np.array(clip.scene.target)
    down = np.rad2deg(np.arcsin((eye - target)[2] / np.linalg.norm(eye - target)))
    assert found.floor.tilt_deg == pytest.approx(down, abs=1.0)
    assert abs(found.floor.roll_deg) < 1.0
    part = clip.labels[0] == PART
    assert found.changes.changed[part].mean() > 0.8
    assert found.changes.still[~part].mean() > 0.5
    assert found.object_mask is not None and found.object_mask[part].mean() > 0.95
    assert found.noise_times == pytest.approx(1.0, abs=0.5)


def hints(recording: Recording, **more: np.ndarray) -> str:
    return "\n".join(check_recording(recording, **more).hints)


def test_noise_that_is_taken_from_the_picture_is_no_hint(clip: Clip) -> None:
    measured = with_sensor(PerceptionConfig(), "measured")
    found = check_recording(clip.recording, perception=measured)
    assert found.noise_times is not None and found.hints == ()


def test_each_defect_is_named(clip: Clip) -> None:
    def millimetres(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, depth_m=f.depth_m * 1000)

    def shaken(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, rgb=np.roll(f.rgb, 3 * i, 1), depth_m=np.roll(f.depth_m, 3 * i, 1))

    def dark(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, rgb=(f.rgb // 12).astype(np.uint8))

    def plain(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, rgb=np.full_like(f.rgb, 128))

    def holes(i: int, f: RgbdFrame) -> RgbdFrame:
        z = f.depth_m.copy()
        z[:, : z.shape[1] * 6 // 10] = np.nan
        return replace(f, depth_m=z)

    def late(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, stamp_s=f.stamp_s + (2.0 if i > 5 else 0.0))

    def slow(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, stamp_s=5.0 * f.stamp_s)

    def on_its_side(i: int, f: RgbdFrame) -> RgbdFrame:
        turned = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.zeros(3)) * f.T_world_cam
        return replace(f, T_world_cam=turned)

    for change, words in (
        (millimetres, "the unit of depth"),
        (shaken, "the camera moved"),
        (dark, "too dark"),
        (plain, "points on the object can be followed"),
        (holes, "% of the pixels have depth"),
        (late, "a gap of 2.10 s"),
        (slow, "2 frames a second"),
        (on_its_side, "the floor's normal is 90 deg off"),
    ):
        assert words in hints(changed(clip, change)), change.__name__


def test_a_part_that_rests_a_short_clip_and_another_up_are_named(clip: Clip) -> None:
    still = film(Cabinet("prismatic"), 0.0, 4)
    said = hints(still.recording)
    assert "nothing moves by more than a centimetre" in said and "only 4 frames" in said
    assert "90 deg off the world's up" in hints(clip.recording, up_world=np.array([0.0, 1.0, 0.0]))
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 3.0]))
    held = replace(clip.recording, T_world_gripper=(hand,) * 12, grasp_frames=(0, 11))
    assert "from the object" in hints(held)


def test_a_picture_without_depth_or_object_is_a_hint_not_an_error(clip: Clip) -> None:
    def blind(i: int, f: RgbdFrame) -> RgbdFrame:
        return replace(f, depth_m=np.full_like(f.depth_m, np.nan))

    recording = changed(clip, blind)
    found = check_recording(recording)
    assert found.depth_m is None and found.floor is None and found.object_mask is None
    assert any("no object stands out" in hint for hint in found.hints)
    assert cv2.imdecode(np.frombuffer(overview(recording, found), np.uint8), 1) is not None


def test_the_command_tells_writes_an_overlay_and_counts_hints(
    clip: Clip, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "rec", tmp_path / "out"
    write_recording(folder, clip.recording)
    assert main(["check", str(folder), "--out", str(out), "--json", "-"]) == 0
    said = json.loads(capfd.readouterr().out)
    assert said["schema"] == "akm-fg/check/1" and said["hints"] == []
    assert json.loads((out / "check.json").read_text()) == said
    picture = cv2.imread(str(out / "overlay.jpg"))
    assert picture.shape[1] == 3 * 640
    red = (picture[..., 2].astype(int) - picture[..., 1] > 60)[:, :640].mean()
    assert 0.02 < red < 0.6
    assert main(["check", str(folder), "--up", "x"]) == 1
    printed = capfd.readouterr().out
    assert "off the world's up" in printed
    assert max(len(line.rstrip()) for line in printed.splitlines()) <= 80


def test_poses_in_other_conventions_are_read_as_the_flags_say(
    clip: Clip, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    turned = gtsam.Pose3(gtsam.Rot3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
    frames = [replace(f, T_world_cam=(f.T_world_cam * turned).inverse()) for f in clip.frames]
    folder, flags = tmp_path / "gl", ["--convention", "opengl", "--invert-pose"]
    write_recording(folder, Recording("gl", tuple(frames)))
    assert main(["check", str(folder), "--json", "-"]) == 1
    assert json.loads(capfd.readouterr().out)["floor"]["off_up_deg"] > 20.0
    assert main(["check", str(folder), *flags, "--json", "-"]) == 0
    assert json.loads(capfd.readouterr().out)["floor"]["off_up_deg"] < 1.0
    assert main(["check", str(folder), "--depth-unit", "0"]) == 2
    assert "--depth-unit" in capfd.readouterr().err


def test_fit_reads_by_the_same_flags_and_repeats_them_in_its_command(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd
) -> None:
    given: dict[str, object] = {}

    def watched(data, name, seed, fit, perception, *others, **more):
        given.update(data=data, noise=perception.observe.noise)
        raise NoMotionObserved("seen")

    monkeypatch.setattr(pipeline, "observe_and_fit", watched)
    write_recording(tmp_path / "r", clip.recording, depth_unit_m=0.001)
    flags = ["--invert-pose", "--up=-z", "--depth-unit", "0.002", "--sensor", "azure"]
    assert main(["fit", str(tmp_path / "r"), *flags]) == 2
    first = given["data"].frames[0]
    expected = clip.scene.T_world_cam.inverse().matrix()
    np.testing.assert_allclose(first.T_world_cam.matrix(), expected, atol=1e-9)
    assert np.nanmedian(first.depth_m / clip.frames[0].depth_m) == pytest.approx(2.0, abs=0.05)
    assert given["noise"] == PROFILES["azure"]
    arguments = FitArguments((tmp_path / "r",), invert_pose=True, up="-z", depth_unit=0.002)
    words = _command(arguments, Path("r"))
    assert words == "akm-fg fit r --seed 0 --invert-pose --up=-z --depth-unit 0.002"


def test_what_is_no_recording_is_one_line(tmp_path: Path, capfd) -> None:
    log = tmp_path / "door.log"
    log.write_text("0 0 0\n0 0 0.1\n0 0 0.2\n")
    for place, words in ((log, "has no pictures"), (tmp_path / "gone", "does not exist")):
        assert main(["check", str(place)]) == 2
        err = capfd.readouterr().err.strip()
        assert err.count("\n") == 0 and words in err
