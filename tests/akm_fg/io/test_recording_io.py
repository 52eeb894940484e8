"""Recordings survive the way to disk, and every broken one gets one clear line."""

import contextlib
import json
import struct
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest
from PIL import Image

from akm_fg.errors import InputError, OutputError
from akm_fg.io.recording import (
    RecordingWriter,
    as_stored,
    read_recording,
    read_truth,
    write_recording,
)
from akm_fg.io.recording_depth import depth_from_raw
from akm_fg.records import JointTruth, PinholeCamera, Recording, RgbdFrame

CAMERA = PinholeCamera(32, 24, 30.5, 30.25, 15.5, 11.5)
T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 1.1), np.array([0.1, -2.0, 0.7]))


def make_recording(n: int = 3, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    frames, masks, grips = [], [], []
    for i in range(n):
        rgb = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
        depth_m = rng.uniform(0.3, 5.0, (24, 32)).astype(np.float32)
        depth_m[rng.random(depth_m.shape) < 0.2] = np.nan
        frames.append(RgbdFrame(0.1 * i, rgb, depth_m, CAMERA, T_WORLD_CAM))
        masks.append(rng.random(depth_m.shape) < 0.5)
        grips.append(gtsam.Pose3(gtsam.Rot3.Rz(0.1 * i), np.array([0.1 * i, 0.0, 0.5])))
    return Recording("clip", tuple(frames), tuple(masks), tuple(grips), (0, n - 1))


def make_truth(n: int = 3) -> JointTruth:
    axis, pivot = np.array([0.0, 0.6, 0.8]), np.array([1.0, 2.0, 3.0])
    return JointTruth("revolute", axis, pivot, np.linspace(0, 0.5, n))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(tmp_path / "clip", make_recording(), make_truth())
    return tmp_path / "clip"


def edit(folder: Path, **changes: object) -> None:
    path = folder / "recording.json"
    description = json.loads(path.read_text())
    for name, value in changes.items():
        if value is KeyError:
            del description[name]
        else:
            description[name] = value
    path.write_text(json.dumps(description))


def all_bytes(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_recording_comes_back_as_written(folder: Path) -> None:
    want, got = make_recording(), read_recording(folder)
    assert got.name == "clip"
    assert got.grasp_frames == (0, 2)
    for a, b in zip(want.frames, got.frames, strict=True):
        assert a.camera == b.camera
        assert a.stamp_s == b.stamp_s
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_allclose(a.depth_m, b.depth_m, atol=5.1e-5)
        assert a.T_world_cam.equals(b.T_world_cam, 1e-12)
    assert want.object_masks is not None and got.object_masks is not None
    np.testing.assert_array_equal(want.object_masks, got.object_masks)
    assert want.T_world_gripper is not None and got.T_world_gripper is not None
    for A, B in zip(want.T_world_gripper, got.T_world_gripper, strict=True):
        assert A.equals(B, 1e-12)


@pytest.mark.parametrize("depth_unit_m", [1e-4, 1e-3, 0.00025])
def test_writing_what_was_read_gives_the_same_bytes(tmp_path: Path, depth_unit_m: float) -> None:
    write_recording(tmp_path / "a", make_recording(), make_truth(), depth_unit_m)
    read, truth = read_recording(tmp_path / "a"), read_truth(tmp_path / "a")
    write_recording(tmp_path / "b", read, truth, depth_unit_m)
    assert all_bytes(tmp_path / "a") == all_bytes(tmp_path / "b")


@pytest.mark.parametrize("depth_unit_m", [1e-4, 1e-3, 0.00025, 1.25e-4])
def test_stored_frames_come_back_bit_for_bit(tmp_path: Path, depth_unit_m: float) -> None:
    raw = make_recording()
    frames = tuple(as_stored(frame, depth_unit_m) for frame in raw.frames)
    assert any((a.depth_m != b.depth_m).any() for a, b in zip(frames, raw.frames, strict=True))
    write_recording(tmp_path / "a", Recording("a", frames), None, depth_unit_m)
    for a, b in zip(frames, read_recording(tmp_path / "a").frames, strict=True):
        assert a.rgb.tobytes() == b.rgb.tobytes()
        np.testing.assert_array_equal(a.depth_m, b.depth_m)
        assert a.depth_m.dtype == b.depth_m.dtype
        np.testing.assert_array_equal(a.T_world_cam.matrix(), b.T_world_cam.matrix())


@pytest.mark.parametrize("depth_unit_m", [1e-4, 1e-3, 0.00025, 1.25e-4])
def test_every_depth_that_a_file_can_hold_stays_as_it_is(depth_unit_m: float) -> None:
    depth_m = depth_from_raw(np.arange(2**16, dtype=np.uint16).reshape(256, 256), depth_unit_m)
    camera = PinholeCamera(256, 256, 300.0, 300.0, 127.5, 127.5)
    rgb = np.zeros((256, 256, 3), np.uint8)
    frame = RgbdFrame(0.0, rgb, depth_m, camera, T_WORLD_CAM)
    np.testing.assert_array_equal(as_stored(frame, depth_unit_m).depth_m, depth_m)
    assert np.isnan(depth_m[0, 0]) and np.isfinite(depth_m).sum() == 2**16 - 1


def test_poses_come_back_exactly_however_they_were_composed(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    turns = rng.normal(size=(40, 2, 3))
    grips = [
        gtsam.Pose3(gtsam.Rot3.Expmap(a) * gtsam.Rot3.Expmap(b), rng.normal(size=3))
        for a, b in turns
    ]
    frame = make_recording(1).frames[0]
    frames = tuple(replace(frame, stamp_s=0.1 * i) for i in range(len(grips)))
    write_recording(tmp_path / "a", Recording("a", frames, None, tuple(grips)))
    got = read_recording(tmp_path / "a").T_world_gripper
    assert got is not None
    for A, B in zip(got, grips, strict=True):
        np.testing.assert_array_equal(A.matrix(), B.matrix())


def test_a_description_may_begin_with_the_mark_that_windows_puts_there(folder: Path) -> None:
    path = folder / "recording.json"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_recording(folder).frames) == 3


@pytest.mark.parametrize("ending", [".jpg", ".jpeg"])
def test_colour_may_be_jpeg(folder: Path, ending: str) -> None:
    kept = {}
    for path in (folder / "rgb").glob("*.png"):
        Image.open(path).save(path.with_suffix(ending), "JPEG", quality=95)
        kept[path.stem] = np.asarray(Image.open(path.with_suffix(ending)))
        path.unlink()
    for i, frame in enumerate(read_recording(folder).frames):
        np.testing.assert_array_equal(frame.rgb, kept[f"{i:06d}"])


def _all_jpeg(folder: Path, size: tuple[int, int] = (32, 24)) -> Path:
    for path in (folder / "rgb").glob("*.png"):
        Image.open(path).resize(size).save(path.with_suffix(".jpg"))
        path.unlink()
    return folder


def test_bad_jpegs_get_one_line(folder: Path) -> None:
    with pytest.raises(InputError, match=r"000000.jpg: is 16x24"):
        read_recording(_all_jpeg(folder, (16, 24)))
    (folder / "rgb/000000.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(20))
    with pytest.raises(InputError, match=r"000000.jpg: is a damaged JPEG"):
        read_recording(folder)
    (folder / "rgb/000001.jpg").unlink()
    with pytest.raises(InputError, match=r"rgb/000001.png: is missing"):
        read_recording(folder)


def test_where_a_frame_has_both_the_png_counts(folder: Path) -> None:
    Image.new("RGB", (32, 24)).save(folder / "rgb/000001.jpg")
    assert read_recording(folder).frames[1].rgb.any()


def test_the_first_frames_can_be_read_alone(folder: Path) -> None:
    whole, part = read_recording(folder), read_recording(folder, first_frames=2)
    assert [f.stamp_s for f in part.frames] == [f.stamp_s for f in whole.frames[:2]]
    assert part.grasp_frames == (0, 1)
    assert part.object_masks is not None and len(part.object_masks) == 2
    assert part.T_world_gripper is not None and len(part.T_world_gripper) == 2
    edit(folder, grasp_frames=[2, 2])
    assert read_recording(folder, first_frames=2).grasp_frames is None
    for wrong in (1, 4):
        with pytest.raises(InputError, match=f"first {wrong} frames; expected 2 to 3 frames"):
            read_recording(folder, first_frames=wrong)


def test_the_truth_comes_back_by_its_own_door(folder: Path) -> None:
    truth = read_truth(folder)
    assert truth is not None
    assert truth.kind == "revolute"
    assert truth.pivot is not None
    np.testing.assert_array_equal(truth.axis, make_truth().axis)
    np.testing.assert_array_equal(truth.pivot, make_truth().pivot)
    np.testing.assert_array_equal(truth.states, make_truth().states)


def test_a_rigid_truth_needs_neither_axis_nor_pivot(tmp_path: Path) -> None:
    truth = JointTruth("rigid", np.full(3, np.nan), None, np.zeros(3))
    write_recording(tmp_path / "a", make_recording(), truth)
    got = read_truth(tmp_path / "a")
    assert got is not None
    assert got.kind == "rigid" and got.pivot is None and np.isnan(got.axis).all()


def test_a_recording_without_truth_masks_and_gripper_is_fine(tmp_path: Path) -> None:
    write_recording(tmp_path / "a", Recording("a", make_recording().frames))
    got = read_recording(tmp_path / "a")
    assert got.object_masks is None and got.T_world_gripper is None and got.grasp_frames is None
    assert read_truth(tmp_path / "a") is None


def test_optional_fields_may_be_left_out(folder: Path) -> None:
    edit(folder, T_world_gripper=KeyError, grasp_frames=KeyError, truth=KeyError)
    assert read_recording(folder).T_world_gripper is None
    assert read_truth(folder) is None


def test_depth_beyond_sixteen_bits_is_unknown(tmp_path: Path) -> None:
    depth_m = np.full((24, 32), 1.0, np.float32)
    depth_m[0, :4] = [7.0, np.inf, -1.0, 1e-6]
    frames = [RgbdFrame(t, make_recording().frames[0].rgb, depth_m, CAMERA, T_WORLD_CAM)
              for t in (0.0, 1.0)]  # fmt: skip
    write_recording(tmp_path / "a", Recording("a", tuple(frames)))
    got = read_recording(tmp_path / "a").frames[0].depth_m
    assert np.isnan(got[0, :4]).all() and np.isfinite(got[1:]).all()


def test_a_slightly_rounded_pose_is_made_rigid(folder: Path) -> None:
    edit(folder, T_world_cam=np.round(T_WORLD_CAM.matrix(), 4).tolist())
    R = read_recording(folder).frames[0].T_world_cam.rotation().matrix()
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)


def test_an_interrupted_recording_stays_readable_after_every_frame(tmp_path: Path) -> None:
    recording = make_recording(4)
    with pytest.raises(KeyboardInterrupt), RecordingWriter(tmp_path / "a") as writer:
        for i, frame in enumerate(recording.frames):
            writer.add(frame)
            assert len(read_recording(tmp_path / "a", min_frames=1).frames) == i + 1
            if i == 2:
                raise KeyboardInterrupt
    assert len(read_recording(tmp_path / "a").frames) == 3


class InterruptedWriter(RecordingWriter):
    """Is interrupted where one of its steps begins, while that step is named."""

    at: str | None = None

    def _make(self, folder: Path) -> None:
        self._interrupt("_make")
        super()._make(folder)

    def _describe(self) -> None:
        self._interrupt("_describe")
        super()._describe()

    def _interrupt(self, step: str) -> None:
        if step == self.at:
            raise KeyboardInterrupt


def test_an_interrupt_between_images_and_description_loses_that_frame_alone(
    tmp_path: Path,
) -> None:
    frames = make_recording(3).frames
    writer = InterruptedWriter(tmp_path / "a")
    writer.add(frames[0])
    writer.add(frames[1])

    writer.at = "_describe"
    with pytest.raises(KeyboardInterrupt):
        writer.add(frames[2])
    assert (tmp_path / "a/rgb/000002.png").exists()
    assert len(read_recording(tmp_path / "a").frames) == 2


@pytest.mark.parametrize("after", ["_make", "_describe"])
def test_writing_goes_on_after_an_interrupt_anywhere_in_a_frame(tmp_path: Path, after: str) -> None:
    recording = make_recording(3)
    assert recording.T_world_gripper is not None
    writer = InterruptedWriter(tmp_path / "a")
    for i, frame in enumerate(recording.frames):
        writer.at = after if i == 1 else None
        with pytest.raises(KeyboardInterrupt) if i == 1 else contextlib.nullcontext():
            writer.add(frame, None, recording.T_world_gripper[i])
    writer.at = None
    n = len(writer)
    assert n == (2 if after == "_make" else 3)
    writer.set_truth(make_truth(n))
    got = read_recording(tmp_path / "a")
    assert got.T_world_gripper is not None and len(got.T_world_gripper) == n


def test_the_writer_refuses_a_used_folder(folder: Path) -> None:
    with pytest.raises(OutputError, match="not empty"):
        RecordingWriter(folder)


def test_the_writer_refuses_frames_that_do_not_go_together(tmp_path: Path) -> None:
    a, b, _ = make_recording().frames
    writer = RecordingWriter(tmp_path / "a")
    writer.add(a)
    with pytest.raises(ValueError, match="must grow"):
        writer.add(a)
    with pytest.raises(ValueError, match="object mask"):
        writer.add(b, object_mask=np.zeros((24, 32), bool))
    with pytest.raises(ValueError, match="gripper pose"):
        writer.add(b, T_world_gripper=gtsam.Pose3())
    with pytest.raises(ValueError, match="depth_unit_m"):
        RecordingWriter(tmp_path / "b", depth_unit_m=0)


def test_a_camera_that_moves_comes_back_with_its_pose_in_every_frame(tmp_path: Path) -> None:
    recording = make_recording()
    moved = [gtsam.Pose3(gtsam.Rot3.Ry(0.1 * i), np.array([0.1 * i, 0, 0])) for i in range(3)]
    pairs = zip(recording.frames, moved, strict=True)
    frames = tuple(replace(f, T_world_cam=f.T_world_cam * T) for f, T in pairs)
    write_recording(tmp_path / "a", replace(recording, frames=frames))
    back = read_recording(tmp_path / "a")
    for a, b in zip(frames, back.frames, strict=True):
        np.testing.assert_array_equal(a.T_world_cam.matrix(), b.T_world_cam.matrix())
    described = json.loads((tmp_path / "a" / "recording.json").read_text())
    assert np.shape(described["T_world_cam"]) == (3, 4, 4)


def test_camera_poses_for_other_frames_are_refused(folder: Path) -> None:
    edit(folder, T_world_cam=[T_WORLD_CAM.matrix().tolist()] * 2)
    with pytest.raises(InputError, match="`T_world_cam` is 2x4x4; expected 3 rigid transforms"):
        read_recording(folder)


def test_the_writer_refuses_poses_that_a_reader_would_mend(tmp_path: Path) -> None:
    frame = make_recording(1).frames[0]
    rounded = np.round(gtsam.Rot3.Rz(0.4).matrix(), 4)
    pose = gtsam.Pose3(gtsam.Rot3(rounded), np.zeros(3))
    with pytest.raises(ValueError, match="T_world_gripper is not a rigid transform"):
        RecordingWriter(tmp_path / "a").add(frame, T_world_gripper=pose)
    with pytest.raises(ValueError, match="T_world_cam is not a rigid transform"):
        RecordingWriter(tmp_path / "b").add(replace(frame, T_world_cam=pose))


CAMERA_FIELDS = {"width": 32, "height": 24, "fx": 30.5, "fy": 30.25, "cx": 15.5, "cy": 11.5}
SHEARED = np.eye(4) + 0.01 * np.eye(4, k=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": KeyError}, "`schema` is missing; expected the string 'akm-fg/recording/1'"),
        ({"schema": "akm-fg/recording/9"}, "`schema` is 'akm-fg/recording/9'"),
        ({"schema": 1}, "`schema` is a number"),
        ({"camera": KeyError}, "`camera` is missing"),
        ({"camera": [1, 2]}, "`camera` is a list"),
        ({"camera": CAMERA_FIELDS | {"fx": float("nan")}}, "`camera.fx` holds NaN"),
        ({"camera": CAMERA_FIELDS | {"fy": -3}}, "`camera.fy` is -3"),
        ({"camera": CAMERA_FIELDS | {"cx": "12"}}, "`camera.cx` is a string"),
        ({"camera": CAMERA_FIELDS | {"cx": None}}, "`camera.cx` is null"),
        ({"camera": CAMERA_FIELDS | {"cx": 10**400}}, "`camera.cx`"),
        ({"camera": CAMERA_FIELDS | {"width": 32.5}}, "`camera.width` is 32.5"),
        ({"camera": CAMERA_FIELDS | {"width": 0}}, "`camera.width` is 0"),
        ({"camera": CAMERA_FIELDS | {"width": 33}}, "is 32x24; expected the camera's 33x24"),
        ({"depth_unit_m": KeyError}, "`depth_unit_m` is missing"),
        ({"depth_unit_m": 0}, "`depth_unit_m` is 0"),
        ({"depth_unit_m": True}, "`depth_unit_m` is a truth value"),
        ({"T_world_cam": KeyError}, "`T_world_cam` is missing"),
        ({"T_world_cam": np.eye(3).tolist()}, "`T_world_cam` is 3x3"),
        ({"T_world_cam": [[1, 2], [3]]}, "`T_world_cam` has rows of different lengths"),
        ({"T_world_cam": SHEARED.tolist()}, "`T_world_cam` is not a rotation"),
        ({"T_world_cam": np.diag([1, 1, -1, 1]).tolist()}, "is a reflection"),
        ({"T_world_cam": np.diag([1, 1, 1, 2]).tolist()}, "last row"),
        ({"stamps_s": KeyError}, "`stamps_s` is missing"),
        ({"stamps_s": [0, 0.2, 0.1]}, "does not grow from frame 1 (0.2) to 2 (0.1)"),
        ({"stamps_s": [0, None, 1]}, "`stamps_s` holds other things than numbers"),
        ({"stamps_s": [0]}, "lists 1 frame; expected at least 2 frames"),
        ({"stamps_s": []}, "lists 0 frames"),
        ({"stamps_s": [0, 1, 2, 3], "T_world_gripper": None}, "000003.png: is missing (`stamps_s`"),
        ({"T_world_gripper": [np.eye(4).tolist()]}, "`T_world_gripper` is 1x4x4"),
        ({"T_world_gripper": [SHEARED.tolist()] * 3}, "`T_world_gripper[0]` is not a rotation"),
        ({"grasp_frames": [0, 3]}, "`grasp_frames` is [0, 3]"),
        ({"grasp_frames": [2, 1]}, "`grasp_frames` is [2, 1]"),
        ({"grasp_frames": 3}, "`grasp_frames` is a number"),
    ],
)  # fmt: skip
def test_a_broken_description_is_named(
    folder: Path, changes: dict[str, object], message: str
) -> None:
    edit(folder, **changes)
    with pytest.raises(InputError) as caught:
        read_recording(folder)
    text = str(caught.value)
    assert message in text
    assert "expected" in text and "\n" not in text
    assert str(folder) in text


def test_images_far_beyond_the_stamps_are_a_contradiction(tmp_path: Path) -> None:
    write_recording(tmp_path / "a", make_recording(4))
    edit(tmp_path / "a", stamps_s=[0, 1], T_world_gripper=None, grasp_frames=None)
    with pytest.raises(InputError, match=r"holds images up to 000003\.png, but `stamps_s` lists 2"):
        read_recording(tmp_path / "a")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"schema": "akm-fg/recording/1",\n "camera": }', "line 2, column 12"),
        (b"", "line 1, column 1"),
        (b"[1, 2]", "holds a list"),
        (b"\xff\xfe\x00", "is not text"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_a_file_that_is_no_description_is_named(folder: Path, content: bytes, message: str) -> None:
    (folder / "recording.json").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_recording(folder)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("kind", "screw", "`truth.kind` is 'screw'"),
        ("kind", KeyError, "`truth.kind` is missing"),
        ("axis", [0, 0, 2], "`truth.axis` has length 2"),
        ("axis", None, "`truth.axis` is null"),
        ("pivot", None, "`truth.pivot` is missing"),
        ("pivot", [0, 1], "`truth.pivot` is 2"),
        ("states", [0, 1], "`truth.states` is 2"),
    ],
)
def test_a_broken_truth_is_named_and_does_not_stop_the_estimator(
    folder: Path, field: str, value: object, message: str
) -> None:
    truth = json.loads((folder / "recording.json").read_text())["truth"]
    truth[field] = value
    edit(folder, truth={k: v for k, v in truth.items() if v is not KeyError})
    with pytest.raises(InputError) as caught:
        read_truth(folder)
    assert message in str(caught.value)
    read_recording(folder)


def test_a_missing_folder_or_description_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_recording(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"recording\.json: is missing"):
        read_recording(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is not a folder"):
        read_recording(tmp_path / "file")


@pytest.mark.parametrize("channel", ["rgb", "depth", "mask"])
def test_a_missing_frame_is_named(folder: Path, channel: str) -> None:
    (folder / channel / "000001.png").unlink()
    with pytest.raises(InputError, match=rf"{channel}.000001\.png: is missing"):
        read_recording(folder)


def test_a_missing_channel_is_named(folder: Path) -> None:
    for file in (folder / "depth").iterdir():
        file.unlink()
    (folder / "depth").rmdir()
    with pytest.raises(InputError, match="depth: is missing"):
        read_recording(folder)


@pytest.mark.parametrize("channel", ["rgb", "depth", "mask"])
@pytest.mark.parametrize("keep", [0, 4, 20, 0.5, -13, -1])
def test_a_truncated_image_is_never_half_read(
    folder: Path, channel: str, keep: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = folder / channel / "000001.png"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if keep == 0.5 else int(keep)])
    with pytest.raises(InputError) as caught:
        read_recording(folder)
    assert str(path) in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_flipped_byte_is_noticed(folder: Path) -> None:
    path = folder / "depth/000001.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InputError, match="is damaged near byte"):
        read_recording(folder)


def test_a_short_pixel_stream_with_right_checksums_is_noticed(folder: Path) -> None:
    path = folder / "depth/000001.png"
    data = path.read_bytes()
    at = data.index(b"IDAT") - 4
    (length,) = struct.unpack_from(">I", data, at)
    content = b"IDAT" + data[at + 8 : at + 8 + length // 2]
    chunk = struct.pack(">I", length // 2) + content + struct.pack(">I", zlib.crc32(content))
    path.write_bytes(data[:at] + chunk + data[at + 12 + length :])
    with pytest.raises(InputError, match="stop early"):
        read_recording(folder)


def test_an_image_of_the_wrong_kind_is_named(folder: Path) -> None:
    depth = folder / "depth/000002.png"
    whole = depth.read_bytes()
    cv2.imwrite(str(depth), np.ones((24, 32), np.uint8))
    with pytest.raises(InputError, match="one channel of 8 bits; expected depth as one channel"):
        read_recording(folder)
    cv2.imwrite(str(depth), np.ones((24, 32, 3), np.uint16))
    with pytest.raises(InputError, match="several channels of 16 bits"):
        read_recording(folder)
    cv2.imwrite(str(depth), np.ones((12, 16), np.uint16))
    with pytest.raises(InputError, match=r"is 16x12; expected the camera's 32x24"):
        read_recording(folder)
    depth.write_bytes(b"GIF89a not a png at all")
    with pytest.raises(InputError, match="is not a PNG"):
        read_recording(folder)
    depth.write_bytes(whole)
    cv2.imwrite(str(folder / "rgb/000000.png"), np.ones((24, 32, 3), np.uint16))
    with pytest.raises(InputError, match="16 bits a channel"):
        read_recording(folder)


def test_a_mask_of_ones_is_refused(folder: Path) -> None:
    cv2.imwrite(str(folder / "mask/000000.png"), np.ones((24, 32), np.uint8))
    with pytest.raises(InputError, match="holds the value 1; expected a mask of 0 and 255"):
        read_recording(folder)


def _png(width: int, height: int, stream: bytes) -> bytes:
    """A 16 bit gray PNG with right checksums that claims this size."""
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(stream)), (b"IEND", b"")]
    packed = (
        struct.pack(">I", len(c)) + kind + c + struct.pack(">I", zlib.crc32(kind + c))
        for kind, c in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


@pytest.mark.parametrize("size", [(32, 24), (20000, 20000)])
def test_an_image_that_unpacks_to_more_than_its_place_takes_no_memory(
    folder: Path, size: tuple[int, int]
) -> None:
    path, bomb = folder / "depth/000001.png", 2**26
    path.write_bytes(_png(*size, bytes(bomb)))
    tracemalloc.start()
    try:
        if size != (32, 24):
            with pytest.raises(InputError, match="is 20000x20000; expected the camera's 32x24"):
                read_recording(folder)
        else:
            assert np.isnan(read_recording(folder).frames[1].depth_m).all()
        assert tracemalloc.get_traced_memory()[1] < bomb / 16
    finally:
        tracemalloc.stop()


def test_a_recording_that_claims_as_much_as_its_bomb_is_refused(folder: Path) -> None:
    camera = {"width": 20000, "height": 20000, "fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0}
    edit(folder, camera=camera)
    (folder / "rgb/000000.png").write_bytes(_png(20000, 20000, b""))
    with pytest.raises(InputError, match=r"claims 20000x20000 pixels; expected 67108864 at most"):
        read_recording(folder)


def test_a_gray_or_palette_image_is_read_as_colour_without_its_transparency(folder: Path) -> None:
    gray = np.random.default_rng(0).integers(0, 256, (24, 32), dtype=np.uint8)
    path = folder / "rgb/000000.png"
    want = np.repeat(gray[..., None], 3, axis=2)
    Image.fromarray(gray).save(path)
    np.testing.assert_array_equal(read_recording(folder).frames[0].rgb, want)
    palette = Image.fromarray(gray).convert("P")
    palette.save(path, transparency=0)
    np.testing.assert_array_equal(read_recording(folder).frames[0].rgb, want)
    cv2.imwrite(str(path), np.dstack([want, 255 - gray]))
    np.testing.assert_array_equal(read_recording(folder).frames[0].rgb, want)
