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

from akm_fg.check.measure import check_recording
from akm_fg.check.picture import overview
from akm_fg.cli.main import main
from akm_fg.io.recording import write_recording
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


def test_what_is_no_recording_is_one_line(tmp_path: Path, capfd) -> None:
    log = tmp_path / "door.log"
    log.write_text("0 0 0\n0 0 0.1\n0 0 0.2\n")
    for place, words in ((log, "has no pictures"), (tmp_path / "gone", "does not exist")):
        assert main(["check", str(place)]) == 2
        err = capfd.readouterr().err.strip()
        assert err.count("\n") == 0 and words in err
