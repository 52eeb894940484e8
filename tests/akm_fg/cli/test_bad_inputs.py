"""A list of bad inputs: one clear line each, in one command, and the good ones among them done."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from akm_fg.cli.main import main

FRAMES, WIDTH, HEIGHT = 3, 32, 24
RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.2, 0.2, (12, 3)) + np.linspace(0.0, 0.15, 8)[:, None, None] * np.array(
    [0.0, 0.0, 1.0]
)
STILL = POINTS[:1] + RNG.normal(0, 1e-3, (20, 12, 3))
COV = np.broadcast_to(1e-6 * np.eye(3), (8, 12, 3, 3))
SEEN = np.ones((8, 12), bool)


def changed(array: np.ndarray, index: tuple, value: object) -> np.ndarray:
    array = np.array(array)
    array[index] = value
    return array


LOGS: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "has no rows"),
    "comments": ("# nothing\n#\n", "has no rows"),
    "blank": ("\n \n\t\n", "has no rows"),
    "names alone": ("x y z\n", "has no rows"),
    "one row": ("1 2 3\n", "has only one row"),
    "one row that is a number": ("1 2 3\nnan nan nan\n", "1 with NaN left out"),
    "all NaN": ("nan nan nan\n" * 5, "5 with NaN left out"),
    "one column": ("1\n2\n", "1 column"),
    "two columns": ("1 2\n3 4\n", "2 columns, looks like pixels"),
    "four columns": ("9 1 2 3\n1 1 2 3\n", "4 columns, looks like"),
    "five columns": ("1 2 3 4 5\n" * 2, "5 columns"),
    "six columns": ("1 2 3 .1 .2 .3\n" * 2, "6 columns, looks like"),
    "nine columns": ("1 0 0 0 1 0 0 0 1\n" * 2, "a rotation without a position"),
    "ten columns": ("1 2 3 4 5 6 7 8 9 10\n" * 2, "10 columns"),
    "ragged": ("1 2 3\n1 2 3 4\n", "line 2: 4 columns"),
    "row cut off": ("1 2 3 0 0 0 1\n1 2 3 0 0\n", "line 2: 5 columns"),
    "word": ("1 2 3\n1 b 3\n", "line 2: 'b' is not a number"),
    "infinite": ("1 2 3\n1 inf 3\n", "line 2: 'inf' is not finite"),
    "beyond doubles": ("1 2 3\n1 1e999 3\n", "line 2: '1e999' is not finite"),
    "astronomic": ("1 2 3\n1 1e30 3\n", "line 2: '1e30' is too large"),
    "far away": ("1 2 3\n1 1e15 3\n", "line 2: holds a position that is too large"),
    "hexadecimal": ("0x1 2 3\n" * 2, "'0x1' is not a number"),
    "underscore": ("1_0 2 3\n" * 2, "'1_0' is not a number"),
    "bars": ("1|2|3\n" * 2, "'1|2|3' is not a number"),
    "brackets": ("[1 2 3]\n" * 2, "'[1' is not a number"),
    "assignments": ("x=1 y=2 z=3\n1 2 3\n1 2\n", "line 3: 2 columns"),
    "two points in a number": ("1.2.3 1 1\n" * 2, "'1.2.3' is not a number"),
    "thousands": ("1.000,5;2;3\n" * 2, "'1.000.5' is not a number"),
    "decimal commas between commas": ("0,1,0,2,0,3\n" * 2, "looks like positions with decimal"),
    "zero quaternion": ("1 2 3 0 0 0 0\n" * 2, "the quaternion is zero"),
    "angles": ("1 2 3 .1 .2 .3 .4\n" * 2, "are no unit quaternion"),
    "stamp and angles": ("1 1 2 3 .1 .2 .3\n2 1 2 3 .1 .2 .3\n", "are no unit quaternion"),
    "no rotation": ("2 0 0 1 0 2 0 1 0 0 2 1\n" * 2, "no rotation matrix"),
    "mirror": ("1 0 0 1 0 1 0 1 0 0 -1 1\n" * 2, "no rotation matrix"),
    "JSON": ('{"poses": [1, 2]}\n', "looks like JSON"),
    "XML": ("<a/>\n<b/>\n", "looks like XML"),
    "web page": ("<!DOCTYPE html><html>\n", "has no rows, looks like XML"),
    "zip": (b"PK\x03\x04\xff\xfe", "looks like a zip archive"),
    "picture": (b"\x89PNG\r\n\x1a\n\xff", "looks like a PNG"),
    "bag": (b"#ROSBAG V2.0\n\xff\xff", "looks like a ROS 1 bag"),
    "database": (b"SQLite format 3\0\x10", "looks like an SQLite file"),
    "zero bytes": (b"1 2 3\0\n1 2 3\n", "holds zero bytes"),
    "Latin-1": ("x [\xb0]\n1 2 3\n".encode("latin-1"), "is not text (byte 3)"),
    "half of UTF-16": (b"\xff\xfe1", "is not text"),
}

ARRAYS: dict[str, tuple[dict[str, object], str]] = {
    "no arrays": ({}, "has no `points`, it holds nothing"),
    "other names": ({"xyz": POINTS}, "has no `points`, it holds `xyz`"),
    "two names": ({"points": POINTS, "tracks": POINTS}, "has both `points` and `tracks`"),
    "name twice": ({"points": POINTS, "Points": POINTS}, "`points` twice"),
    "a number": ({"points": 1.0}, "`points` has shape ()"),
    "a path": ({"points": POINTS[:, 0]}, "`points` has shape (8, 3)"),
    "pixels": ({"points": POINTS[..., :2]}, "looks like pixels without depth"),
    "four coordinates": ({"points": np.ones((8, 12, 4))}, "has shape (8, 12, 4)"),
    "axes last": ({"points": POINTS.transpose(2, 0, 1)}, "has shape (3, 8, 12)"),
    "a batch of two": ({"points": np.stack([POINTS] * 2)}, "has shape (2, 8, 12, 3)"),
    "one frame": ({"points": POINTS[:1]}, "has 1 frame(s)"),
    "no frame": ({"points": POINTS[:0]}, "has 0 frame(s)"),
    "no point": ({"points": POINTS[:, :0]}, "has shape (8, 0, 3)"),
    "text": ({"points": np.full((2, 2, 3), "a")}, "is of type <U1"),
    "complex": ({"points": POINTS.astype(complex)}, "is of type complex128"),
    "times": ({"points": np.zeros((2, 2, 3), "M8[s]")}, "is of type datetime64"),
    "numbers cut off": ({"points": (1e3 * POINTS).astype(int).astype(np.uint8)}, "of type uint8"),
    "objects": ({"points": np.array([{}], dtype=object)}, "holds Python objects"),
    "infinite": ({"points": changed(POINTS, (3, 4, 1), np.inf)}, "infinite in frame 3, point 4"),
    "astronomic": ({"points": changed(POINTS, (3, 4, 1), 1e12)}, "is 1e+12 in frame 3, point 4"),
    "pixels and depth": ({"points": POINTS * [3e3, 3e3, 1] + [0, 0, 1]}, "likely pixels and depth"),
    "all lost": ({"points": np.full((5, 4, 3), np.nan)}, ""),
    "all zero": ({"points": np.zeros((5, 4, 3))}, ""),
    "nothing visible": ({"points": POINTS, "visible": ~SEEN}, ""),
    "stands still": ({"points": STILL, "sigma_m": 1e-3}, "nothing moved"),
    "mask of another size": (
        {"points": POINTS, "visible": SEEN[:5]},
        "`visible` has shape (5, 12)",
    ),
    "mask of numbers": ({"points": POINTS, "visible": 3 * SEEN}, "`visible` holds 3"),
    "mask of NaN": ({"points": POINTS, "visible": np.nan * SEEN}, "`visible` holds nan"),
    "mask of text": ({"points": POINTS, "visible": np.full((8, 12), "y")}, "`visible` is of type"),
    "two masks": ({"points": POINTS, "visible": SEEN, "occluded": ~SEEN}, "both `visible`"),
    "zero noise": ({"points": POINTS, "sigma_m": 0.0}, "`sigma_m` is 0 in frame 0"),
    "negative noise": ({"points": POINTS, "sigma_m": -1.0}, "`sigma_m` is -1"),
    "NaN noise": ({"points": POINTS, "sigma_m": np.nan}, "`sigma_m` is nan"),
    "huge noise": ({"points": POINTS, "sigma_m": 1e9}, "`sigma_m` is 1e+09"),
    "noise of another size": (
        {"points": POINTS, "sigma_m": np.ones(8)},
        "`sigma_m` has shape (8,)",
    ),
    "noise of text": ({"points": POINTS, "sigma_m": "a"}, "`sigma_m` is of type"),
    "two noises": ({"points": POINTS, "sigma_m": 1.0, "cov": COV}, "both `cov` and `sigma_m`"),
    "cov of one frame": ({"points": POINTS, "cov": COV[0]}, "`cov` has shape (12, 3, 3)"),
    "cov not symmetric": (
        {"points": POINTS, "cov": changed(COV, (1, 2, 0, 1), 1e-6)},
        "not symmetric in frame 1, point 2",
    ),
    "cov indefinite": (
        {"points": POINTS, "cov": changed(COV, (1, 2, 0, 0), -1e-6)},
        "not positive definite in frame 1",
    ),
    "cov NaN": (
        {"points": POINTS, "cov": changed(COV, (1, 2, 0, 0), np.nan)},
        "not finite in frame 1, point 2",
    ),
}

EYE = np.eye(4).tolist()
CAMERA = {"width": WIDTH, "height": HEIGHT, "fx": 30.0, "fy": 30.0, "cx": 15.5, "cy": 11.5}
DESCRIBED: dict[str, object] = {
    "schema": "akm-fg/recording/1",
    "camera": CAMERA,
    "depth_unit_m": 0.001,
    "T_world_cam": EYE,
    "stamps_s": [0.0, 0.1, 0.2],
}
GONE = object()
FIELDS: dict[str, tuple[str, object, str]] = {
    "no schema": ("schema", GONE, "`schema` is missing"),
    "another schema": ("schema", "akm-fg/recording/9", "`schema` is 'akm-fg/recording/9'"),
    "schema a number": ("schema", 1, "`schema` is a number"),
    "no camera": ("camera", GONE, "`camera` is missing"),
    "camera a list": ("camera", [1], "`camera` is a list"),
    "no fx": ("camera", {k: v for k, v in CAMERA.items() if k != "fx"}, "`camera.fx` is missing"),
    "fx zero": ("camera", {**CAMERA, "fx": 0}, "`camera.fx` is 0"),
    "fx NaN": ("camera", {**CAMERA, "fx": float("nan")}, "`camera.fx` holds NaN"),
    "width a fraction": ("camera", {**CAMERA, "width": 32.5}, "`camera.width` is 32.5"),
    "width negative": ("camera", {**CAMERA, "width": -32}, "`camera.width` is -32"),
    "width true": ("camera", {**CAMERA, "width": True}, "`camera.width` is True"),
    "camera of another size": ("camera", {**CAMERA, "width": 64}, "000000.png: is 32x24"),
    "no depth unit": ("depth_unit_m", GONE, "`depth_unit_m` is missing"),
    "depth unit zero": ("depth_unit_m", 0, "`depth_unit_m` is 0"),
    "depth unit text": ("depth_unit_m", "mm", "`depth_unit_m` is a string"),
    "no pose": ("T_world_cam", GONE, "`T_world_cam` is missing"),
    "pose of three rows": ("T_world_cam", EYE[:3], "`T_world_cam` is 3x4"),
    "pose scaled": ("T_world_cam", (2 * np.eye(4)).tolist(), "`T_world_cam"),
    "pose mirrored": ("T_world_cam", np.diag([1.0, 1, -1, 1]).tolist(), "`T_world_cam"),
    "pose of text": ("T_world_cam", [["a"] * 4] * 4, "`T_world_cam` holds other things"),
    "no stamps": ("stamps_s", GONE, "`stamps_s` is missing"),
    "stamps empty": ("stamps_s", [], "`stamps_s`"),
    "one stamp": ("stamps_s", [0.0], "`stamps_s` lists 1 frame"),
    "stamps back": ("stamps_s", [0.0, 0.2, 0.1], "`stamps_s` does not grow from frame 1"),
    "stamps equal": ("stamps_s", [0.0, 0.0, 0.1], "`stamps_s` does not grow from frame 0"),
    "stamps nested": ("stamps_s", [[0.0], [0.1, 0.2]], "`stamps_s` has rows of different"),
    "stamps beyond": ("stamps_s", [0, 1, 1e300], "`stamps_s` holds a number beyond"),
    "too many stamps": ("stamps_s", [0, 1, 2, 3], "000003.png: is missing"),
    "too few gripper poses": ("T_world_gripper", [EYE] * 2, "`T_world_gripper` is 2x4x4"),
    "gripper pose no rotation": (
        "T_world_gripper",
        [np.ones((4, 4)).tolist()] * 3,
        "T_world_gripper[0]` is not",
    ),
    "grasp after the end": ("grasp_frames", [0, 3], "`grasp_frames` is [0, 3]"),
    "grasp back": ("grasp_frames", [2, 1], "`grasp_frames` is [2, 1]"),
    "grasp one number": ("grasp_frames", 1, "`grasp_frames`"),
}


def _write_recording(folder: Path, **changes: object) -> Path:
    described = {k: v for k, v in {**DESCRIBED, **changes}.items() if v is not GONE}
    rgb = RNG.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    for channel, image in (("rgb", rgb), ("depth", np.full((HEIGHT, WIDTH), 900, np.uint16))):
        (folder / channel).mkdir(parents=True)
        for i in range(FRAMES):
            cv2.imwrite(str(folder / channel / f"{i:06d}.png"), image)
    (folder / "recording.json").write_text(json.dumps(described))
    return folder


def _cut(folder: Path, name: str, keep: int) -> None:
    (folder / name).write_bytes((folder / name).read_bytes()[:keep])


def _image(name: str, *shape: int, dtype: type = np.uint16) -> Callable[[Path], object]:
    """Puts another picture there."""
    return lambda folder: cv2.imwrite(str(folder / name), np.zeros(shape, dtype))


def _text(name: str, text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(text)


def _to_jpeg(folder: Path) -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    (folder / "rgb/000001.png").write_bytes(cv2.imencode(".jpg", image)[1])


def _to_folder(folder: Path) -> None:
    (folder / "rgb/000001.png").unlink()
    (folder / "rgb/000001.png").mkdir()


def _to_file(folder: Path) -> None:
    shutil.rmtree(folder / "rgb")
    (folder / "rgb").write_text("")


SPOILT: dict[str, tuple[Callable[[Path], object], str]] = {
    "no description": (lambda f: (f / "recording.json").unlink(), "recording.json: is missing"),
    "empty description": (
        lambda f: _cut(f, "recording.json", 0),
        "recording.json: line 1, column 1",
    ),
    "half a description": (lambda f: _cut(f, "recording.json", 60), "recording.json: line 1"),
    "a list described": (_text("recording.json", "[]"), "recording.json: holds a list"),
    "binary description": (
        lambda f: (f / "recording.json").write_bytes(b"\xff\xfe{"),
        "is not text",
    ),
    "nested description": (_text("recording.json", "[" * 10**5), "nested too deeply"),
    "no rgb": (lambda f: shutil.rmtree(f / "rgb"), "rgb: is missing"),
    "no depth": (lambda f: shutil.rmtree(f / "depth"), "depth: is missing"),
    "rgb a file": (_to_file, "rgb: is missing"),
    "image gone": (lambda f: (f / "rgb/000001.png").unlink(), "rgb/000001.png: is missing"),
    "image empty": (lambda f: _cut(f, "rgb/000001.png", 0), "000001.png: is empty"),
    "image cut": (lambda f: _cut(f, "rgb/000001.png", 200), "000001.png: is truncated after 200"),
    "image text": (_text("rgb/000001.png", "hello"), "000001.png: is not a PNG"),
    "image JPEG": (_to_jpeg, "is not a PNG"),
    "image of 16 bits": (_image("rgb/000001.png", HEIGHT, WIDTH, 3), "has 16 bits a channel"),
    "depth of 8 bits": (
        _image("depth/000001.png", HEIGHT, WIDTH, dtype=np.uint8),
        "depth/000001.png: has one channel of 8 bits",
    ),
    "depth in colour": (
        _image("depth/000001.png", HEIGHT, WIDTH, 3),
        "has several channels of 16 bits",
    ),
    "depth of another size": (_image("depth/000001.png", 9, 9), "is 9x9"),
    "image too many": (
        lambda f: shutil.copy(f / "rgb/000001.png", f / "rgb/000009.png"),
        "holds images up to 000009.png",
    ),
    "image a folder": (_to_folder, "000001.png: is not a regular file"),
    "empty mask folder": (lambda f: (f / "mask").mkdir(), "mask/000000.png: is missing"),
    "stands still": (lambda f: None, ""),
}


def _others(folder: Path) -> dict[str, tuple[Path, str]]:
    """Paths that are none of the three, or only by name."""
    whole = folder / "whole.npz"
    np.savez(whole, points=POINTS)
    data = whole.read_bytes()
    files: dict[str, tuple[str, bytes, str]] = {
        "half an archive": ("half.npz", data[: len(data) // 2], "is truncated"),
        "an empty archive": ("empty.npz", b"", "is not an .npz archive"),
        "text as archive": ("text.npz", b"1 2 3\n", "is not an .npz archive"),
        "an array as archive": ("array.npz", b"\x93NUMPY\x01\x00", "looks like a NumPy array"),
        "HDF5 as archive": ("hdf.npz", b"\x89HDF\r\n", "looks like an HDF5 file"),
        "a spoilt archive": ("spoilt.npz", data[:200] + b"\xff" * 9 + data[209:], "is damaged"),
        "a bag": ("a.bag", b"#ROSBAG", "does not begin as a .bag file does"),
        "a film": ("a.mp4", b"\0\0\0 ftyp", "has no a.npz beside it"),
        "no ending": ("README", b"1 2 3\n", "has no ending"),
        "an array": ("a.npy", b"\x93NUMPY", "ends in '.npy'"),
        "a name with a newline": ("a\nb.log", b"", "has no rows"),
    }
    made = {}
    for name, (file, content, words) in files.items():
        (folder / file).write_bytes(content)
        made[name] = (folder / file, words)
    with zipfile.ZipFile(folder / "junk.npz", "w") as archive:
        archive.writestr("points.npy", b"junk")
    os.mkfifo(folder / "pipe.log")
    (folder / "loop.log").symlink_to(folder / "loop.log")
    (folder / "folder.npz").mkdir()
    made["junk in an archive"] = (folder / "junk.npz", "is damaged")
    made["a pipe"] = (folder / "pipe.log", "is not a regular file")
    made["a link to itself"] = (folder / "loop.log", "")
    made["a folder"] = (folder / "folder.npz", "recording.json: is missing")
    made["nothing"] = (folder / "nothing.log", "does not exist")
    made["a device"] = (Path("/dev/null"), "has no ending")
    made["a long name"] = (folder / ("x" * 300), "is not a usable path")
    return made


def _all(folder: Path) -> dict[str, tuple[Path, str]]:
    made: dict[str, tuple[Path, str]] = {}
    for kind in ("logs", "arrays", "fields", "spoilt", "others"):
        (folder / kind).mkdir()
    for name, (text, words) in LOGS.items():
        path = folder / "logs" / f"{name}.log"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        made[f"log: {name}"] = (path, words)
    for name, (arrays, words) in ARRAYS.items():
        np.savez(folder / "arrays" / f"{name}.npz", **arrays)
        made[f"tracks: {name}"] = (folder / "arrays" / f"{name}.npz", words)
    for name, (field, value, words) in FIELDS.items():
        path = _write_recording(folder / "fields" / name, **{field: value})
        made[f"recording: {name}"] = (path, words)
    for name, (spoil, words) in SPOILT.items():
        path = _write_recording(folder / "spoilt" / name)
        spoil(path)
        made[f"spoilt: {name}"] = (path, words)
    return made | {f"other: {k}": v for k, v in _others(folder / "others").items()}


def _is_clear(line: str, path: Path, words: str) -> bool:
    """Whether it names the input, what is wrong and what is expected, and no type of error."""
    named = str(path).replace("\n", "\\n") in line
    return (
        line.startswith("akm-fg: ")
        and words in line
        and named
        and "; expected " in line
        and "could not be fitted" not in line
    )


def test_each_of_many_bad_inputs_is_one_clear_line_and_nothing_is_lost(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = _all(tmp_path)
    assert len(bad) > 150
    good, out = tmp_path / "good.npz", tmp_path / "out.jsonl"
    np.savez(good, points=POINTS + RNG.normal(0, 1e-3, POINTS.shape), sigma_m=1e-3)
    inputs = [good, *(path for path, _ in bad.values()), good]
    assert main(["fit", *map(str, inputs), "--json", str(out)]) == 2
    lines = capfd.readouterr().err.splitlines()
    unclear = [
        (name, line)
        for (name, (path, words)), line in zip(bad.items(), lines, strict=True)
        if not _is_clear(line, path, words)
    ]
    assert not unclear
    done = [json.loads(line)["input"] for line in out.read_text().splitlines()]
    assert done[0] == done[-1] == str(good)
