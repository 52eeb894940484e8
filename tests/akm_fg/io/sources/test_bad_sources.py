"""Bad inputs in other people's formats: one clear line each, the good ones among them done.

Together with tests/akm_fg/cli/test_bad_inputs.py they are more than two hundred.
"""

from __future__ import annotations

import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from tests.akm_fg.cli.test_bad_inputs import _all

pytest.importorskip("rosbags")
pytest.importorskip("av")
liblzfse = pytest.importorskip("liblzfse")

CAMERA = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
FRAMES = 3


def small() -> Recording:
    rng = np.random.default_rng(0)
    depth = np.full((24, 32), 1.0, np.float32)
    depth[6:18, 8:20] = 0.8
    frames = [
        RgbdFrame(
            10.0 + 0.1 * i,
            rng.integers(0, 255, (24, 32, 3), dtype=np.uint8),
            depth,
            CAMERA,
            gtsam.Pose3(),
        )
        for i in range(FRAMES)
    ]
    return Recording("small", tuple(frames))


Bad = dict[str, tuple[Callable[[Path], object], str]]


def text(name: str, content: str | bytes) -> Callable[[Path], object]:
    data = content if isinstance(content, bytes) else content.encode()
    return lambda folder: (folder / name).write_bytes(data)


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Callable[[Path], object]:
    """Change the rows of a list, its comments left out."""

    def edit(folder: Path) -> None:
        rows = [r for r in (folder / name).read_text().splitlines() if not r.startswith("#")]
        (folder / name).write_text("\n".join(change(rows)) + "\n")

    return edit


def camera(**values: object) -> Callable[[Path], object]:
    def edit(folder: Path) -> None:
        path = folder / "camera.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **values}))

    return edit


def cut(pattern: str, left_out: int = 30) -> Callable[[Path], object]:
    def edit(folder: Path) -> None:
        path = sorted(folder.glob(pattern))[1]
        path.write_bytes(path.read_bytes()[:-left_out])

    return edit


def put(pattern: str, data: bytes) -> Callable[[Path], object]:
    return lambda folder: sorted(folder.glob(pattern))[1].write_bytes(data)


def picture(pattern: str, image: np.ndarray) -> Callable[[Path], object]:
    import cv2

    return put(pattern, cv2.imencode(".png", image)[1].tobytes())


def claiming(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header + bytes(4)


TUM: Bad = {
    "no rows": (text("rgb.txt", "# nothing\n"), "lists no picture"),
    "empty list": (text("depth.txt", ""), "lists no picture"),
    "binary list": (text("rgb.txt", b"\xff\xfe\x00"), "is not text"),
    "a word for a stamp": (lines("rgb.txt", lambda r: ["a b", *r]), "line 1: 'a' is no stamp"),
    "a stamp alone": (lines("rgb.txt", lambda r: ["1.0", *r]), "line 1: 1 columns"),
    "a stamp that is NaN": (lines("rgb.txt", lambda r: ["nan rgb/a.png", *r]), "line 1"),
    "a file elsewhere": (lines("rgb.txt", lambda r: ["1.0 ../../a.png", *r]), "'../../a.png'"),
    "an absolute path": (lines("rgb.txt", lambda r: ["1.0 /etc/passwd", *r]), "'/etc/passwd'"),
    "a picture that is missing": (
        lambda f: sorted((f / "rgb").iterdir())[1].unlink(),
        "is missing",
    ),
    "a picture that is a folder": (
        lambda f: (sorted((f / "rgb").iterdir())[0].unlink(), (f / "rgb/10.000000.png").mkdir()),
        "is not a regular file",
    ),
    "a picture that is empty": (put("rgb/*", b""), "is empty"),
    "a picture that is text": (put("rgb/*", b"hello"), "is neither JPEG nor PNG"),
    "a picture cut off": (cut("rgb/*"), "is truncated"),
    "a picture of another size": (
        picture("rgb/*", np.zeros((12, 16, 3), np.uint8)),
        "holds 16x12 pixels",
    ),
    "a damaged JPEG": (put("rgb/*", b"\xff\xd8\xff\xe0" + bytes(50)), "is a damaged JPEG"),
    "16 bits of colour": (picture("rgb/*", np.zeros((24, 32, 3), np.uint16)), "has 16 bits"),
    "depth cut off": (cut("depth/*"), "is truncated"),
    "depth of 8 bits": (
        picture("depth/*", np.zeros((24, 32), np.uint8)),
        "8 bits, likely depth painted for the eye",
    ),
    "depth in colours": (
        picture("depth/*", np.zeros((24, 32, 3), np.uint8)),
        "several channels of 8 bits",
    ),
    "depth that claims gigabytes": (put("depth/*", claiming(60000, 60000)), "claims 60000x60000"),
    "depth of another size": (
        lambda f: [picture("depth/*", np.zeros((12, 16), np.uint16))(f)],
        "holds 16x12 pixels",
    ),
    "no intrinsics": (lambda f: (f / "camera.json").unlink(), "--intrinsics"),
    "a camera that is not JSON": (text("camera.json", "{"), "camera.json: line 1"),
    "a camera of another size": (camera(width=640, height=480), "is of a camera of 640x480"),
    "a camera of words": (camera(intrinsic_matrix="K"), "`intrinsic_matrix`"),
    "a camera of two numbers": (camera(intrinsic_matrix=[1, 2]), "has shape (2,)"),
    "a camera without focal length": (
        camera(intrinsic_matrix=[0, 0, 0, 0, 0, 0, 16, 12, 1]),
        "must be > 0",
    ),
    "a camera of NaN": (camera(intrinsic_matrix=[float("nan")] * 9), "has shape (9,)"),
    "a camera of other pictures": (
        camera(intrinsic_matrix=[600, 0, 0, 0, 600, 0, 320, 240, 1]),
        "are of no picture of 32x24",
    ),
    "poses without rows": (text("groundtruth.txt", "#\n"), "has no rows"),
    "poses of words": (text("groundtruth.txt", "a b c\n"), "line 1"),
    "poses of positions alone": (text("groundtruth.txt", "10 1 2 3\n"), "line 1: 4 columns"),
    "poses with a zero quaternion": (
        text("groundtruth.txt", "10 1 2 3 0 0 0 0\n"),
        "no unit quaternion",
    ),
    "poses of NaN": (text("groundtruth.txt", "10 nan 2 3 0 0 0 1\n"), "not finite"),
    "poses at another time": (
        text("groundtruth.txt", "1 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n"),
        "3 without a pose",
    ),
    "colour and depth at other times": (
        lines("depth.txt", lambda r: [f"{float(x.split()[0]) + 99} {x.split()[1]}" for x in r]),
        "no two together",
    ),
    "one frame": (lines("rgb.txt", lambda r: r[:1]), "holds 1 pairs of colour and depth"),
}

ROW = "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
REDWOOD: Bad = {
    "no pictures": (
        lambda f: [p.unlink() for p in (f / "color").iterdir()],
        "holds no pictures",
    ),
    "no depth": (lambda f: [p.unlink() for p in (f / "depth").iterdir()], "holds no pictures"),
    "one depth missing": (lambda f: (f / "depth/000001.png").unlink(), "3 colour and 2 depth"),
    "no camera": (lambda f: (f / "camera.json").unlink(), "`intrinsic_matrix`"),
    "a log of words": (text("trajectory.log", "a\n" * 5), "pose 0"),
    "a log cut off": (text("trajectory.log", ROW[:-9]), "has 4 rows"),
    "an empty log": (text("trajectory.log", ""), "has 0 rows"),
    "rows of three": (text("trajectory.log", "0 0 1\n" * 5), "pose 0: has shape (4, 3)"),
    "too few poses": (text("trajectory.log", ROW * 2), "holds 2 poses of 3"),
    "a mirror": (text("trajectory.log", ROW.replace("0 0 1 0", "0 0 -1 0")), "a reflection"),
    "no rotation": (text("trajectory.log", ROW.replace("1 0 0 0", "2 0 0 0")), "no rotation"),
    "two trajectories": (text("other.log", ROW), "holds several trajectories"),
    "a trajectory without poses": (
        lambda f: ((f / "trajectory.log").unlink(), text("trajectory.json", '{"a": 1}')(f)),
        "`extrinsic`",
    ),
    "a trajectory of words": (
        lambda f: (
            (f / "trajectory.log").unlink(),
            text("trajectory.json", '{"parameters": [{"extrinsic": "x"}]}')(f),
        ),
        "`extrinsic`",
    ),
    "depth as JPEG": (put("depth/*", b"\xff\xd8\xff"), "is not a PNG"),
    "colour that is empty": (put("color/*", b""), "is empty"),
}


def member(name: str, data: bytes | None) -> Callable[[Path], object]:
    """Put another member into a .r3d, or leave it out."""

    def edit(path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            held = {n: archive.read(n) for n in archive.namelist()}
        held.pop(name, None)
        with zipfile.ZipFile(path, "w") as archive:
            for n, content in {**held, **({} if data is None else {name: data})}.items():
                archive.writestr(n, content)

    return edit


def metadata(**values: object) -> Callable[[Path], object]:
    def edit(path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            found = json.loads(archive.read("metadata"))
        member("metadata", json.dumps({**found, **values}).encode())(path)

    return edit


R3D: Bad = {
    "empty": (lambda p: p.write_bytes(b""), "is not a zip archive"),
    "text": (lambda p: p.write_bytes(b"hello"), "is not a zip archive"),
    "cut off": (lambda p: p.write_bytes(p.read_bytes()[:-100]), "is not a zip archive"),
    "no metadata": (member("metadata", None), "`metadata` cannot be read"),
    "metadata of words": (member("metadata", b"{"), "`metadata` is not JSON"),
    "metadata of a list": (member("metadata", b"[]"), "is no JSON object"),
    "no pictures": (
        lambda p: [member(f"rgbd/{i}.jpg", None)(p) for i in range(FRAMES)],
        "holds no rgbd/0.jpg",
    ),
    "no depth": (member("rgbd/1.depth", None), "rgbd/1.jpg without its .depth"),
    "no K": (metadata(K=None), "`K`"),
    "K of four": (metadata(K=[1, 2, 3, 4]), "`K` of `metadata` has 4 numbers"),
    "K of words": (metadata(K=["a"] * 9), "no numbers as `K`"),
    "another size": (metadata(w=640), "`metadata` says 640x24"),
    "depth of another size": (metadata(dw=10, dh=10), "`metadata` says 10x10"),
    "a damaged picture": (member("rgbd/1.jpg", b"\xff\xd8\xff" + bytes(40)), "is a damaged JPEG"),
    "depth of words": (member("rgbd/1.depth", b"hello world, hello"), "is damaged near byte 0"),
    "depth that is empty": (member("rgbd/1.depth", b""), "is empty"),
    "depth that inflates to gigabytes": (
        member("rgbd/1.depth", b"bvxn" + struct.pack("<II", 2**31, 4) + bytes(4) + b"bvx$"),
        "holds 2147483648 bytes",
    ),
    "depth without its payload": (
        member("rgbd/1.depth", b"bvxn" + struct.pack("<II", 3072, 4) + bytes(4) + b"bvx$"),
        "is damaged",
    ),
    "poses of three": (metadata(poses=[[1, 2, 3]] * FRAMES), "`poses` of `metadata` has shape"),
    "too few poses": (metadata(poses=[[0, 0, 0, 1, 0, 0, 0]]), "`poses` holds 1 of 3"),
    "poses of zeros": (metadata(poses=[[0] * 7] * FRAMES), "holds no rotation"),
    "stamps that fall": (metadata(frameTimestamps=[3, 2, 1]), "`frameTimestamps`"),
}


def arrays(**values: object) -> Callable[[Path], object]:
    def edit(folder: Path) -> None:
        with np.load(folder / "depth.npz") as found:
            held = {**found, **values}
        np.savez(folder / "depth.npz", **{k: v for k, v in held.items() if v is not None})

    return edit


DEPTH = np.full((FRAMES, 24, 32), 1000, np.uint16)
VIDEO: Bad = {
    "no picture": (text("colour.mkv", b""), "cannot be decoded"),
    "text": (text("colour.mkv", b"hello" * 100), "cannot be decoded"),
    "an archive of words": (text("depth.npz", b"hello"), "is not an .npz archive"),
    "two videos": (text("other.mp4", b""), "holds 2 videos"),
    "no depth": (arrays(depth=None), "holds no `depth`"),
    "depth of one picture": (arrays(depth=DEPTH[0]), "`depth` has shape (24, 32)"),
    "depth of words": (arrays(depth=np.full((3, 2, 2), "a")), "and type <U1"),
    "depth of 8 bits": (arrays(depth=DEPTH.astype(np.uint8)), "painted for the eye"),
    "depth of objects": (arrays(depth=np.array([{}], dtype=object)), "holds Python objects"),
    "depth without pixels": (arrays(depth=DEPTH[:, :0]), "has shape (3, 0, 32)"),
    "depth of another shape": (arrays(depth=DEPTH[:, :, :9]), "`depth` is 9x24"),
    "depth of more pictures": (arrays(depth=np.repeat(DEPTH, 2, 0)), "`depth` holds 6 pictures"),
    "no K": (arrays(K=None), "holds no `K`"),
    "K of two": (arrays(K=np.eye(2)), "`K` has shape (2, 2)"),
    "K of zeros": (arrays(K=np.zeros((3, 3))), "must be > 0"),
    "a unit of nothing": (arrays(depth_unit_m=0.0), "`depth_unit_m` is no length"),
    "a place that is no rotation": (arrays(T_world_cam=2 * np.eye(4)), "no rigid transform"),
    "a place of two rows": (arrays(T_world_cam=np.eye(2)), "`T_world_cam` has shape (2, 2)"),
    "stamps that fall": (arrays(stamps_s=np.array([3.0, 2.0, 1.0])), "`stamps_s`"),
}


def spoilt_entries(write: dict, spoil: Callable) -> Callable:
    """The entries of a small bag, each (topic, stamp, message) changed or left out."""
    plain = write["entries"](small())

    def entries(make):
        for entry in plain(make):
            changed = spoil(make, *entry)
            if changed is not None:
                yield changed
            if spoil is elsewhere and entry[0].endswith("camera_info"):
                yield "/camera/depth/camera_info", *entry[1:]

    return entries


def without(word: str) -> Callable:
    return lambda make, topic, s, message: None if word in topic else (topic, s, message)


def changing(word: str, **values: object) -> Callable:
    def spoil(make, topic, s, message):
        return (topic, s, replace(message, **values) if word in topic else message)

    return spoil


def elsewhere(make, topic, s, message):
    """Depth of a camera that nobody says where it is."""
    if ALIGNED in topic:
        topic = topic.replace("aligned_depth_to_color", "depth")
        message = replace(message, header=make.header(s, "elsewhere"))
    return topic, s, message


def compressed(word: str, data: bytes, how: str) -> Callable:
    def spoil(make, topic, s, message):
        if topic.endswith("image_raw") and word in topic:
            frame = message.header.frame_id
            return f"{topic}/compressed", s, make.compressed(s, frame, data, how)
        return topic, s, message

    return spoil


COLOUR, ALIGNED = "color/image_raw", "aligned_depth"
BAGS: dict[str, tuple[Callable, str]] = {
    "no pictures at all": (without("image"), "has no colour pictures"),
    "no depth": (without(ALIGNED), "has no depth pictures"),
    "no colour": (without(COLOUR), "has no colour pictures"),
    "no camera": (without("camera_info"), "has no CameraInfo of 32x24"),
    "a camera that is not calibrated": (
        changing("camera_info", k=np.zeros(9)),
        "a calibrated camera",
    ),
    "a camera of another size": (changing("camera_info", width=64), "has no CameraInfo of 32x24"),
    "an unknown distortion": (
        changing("camera_info", distortion_model="magic", d=np.ones(3)),
        "distortion 'magic' with 3 coefficients",
    ),
    "an unknown encoding": (changing(COLOUR, encoding="64FC9"), "has no colour pictures"),
    "pictures cut off": (changing(COLOUR, data=np.zeros(9, np.uint8)), "in 9 bytes"),
    "rows too short": (changing(ALIGNED, step=3), "3 a row"),
    "pictures of nothing": (changing(COLOUR, height=0), "claims 32x0 pixels"),
    "a damaged JPEG": (compressed("/color/", b"\xff\xd8\xff\x00", "jpeg"), "is a damaged JPEG"),
    "compressed by RVL": (
        compressed("aligned", bytes(40), "16UC1; compressedDepth rvl"),
        "compressed by RVL",
    ),
    "compressed depth of nothing": (
        compressed("aligned", bytes(4), "16UC1; compressedDepth png"),
        "of 4 bytes",
    ),
    "depth in an unknown place": (
        elsewhere,
        "no transform between colour's frame",
    ),
    "depth at another time": (
        lambda make, topic, s, message: (
            topic,
            s,
            replace(message, header=make.header(s + 99, message.header.frame_id))
            if ALIGNED in topic
            else message,
        ),
        "no two together",
    ),
    "one frame": (
        lambda make, topic, s, message: None if s > 10.05 else (topic, s, message),
        "holds 1 pairs",
    ),
}


def _files(folder: Path) -> dict[str, tuple[Path, str]]:
    """Files that are no bags."""
    made = {
        "an empty bag": ("a.bag", b"", "is empty"),
        "a bag of words": ("b.bag", b"hello", "does not begin as a .bag"),
        "a bag that only begins": ("c.bag", b"#ROSBAG V2.0\n", "cannot be read"),
        "an MCAP that only begins": ("d.mcap", b"\x89MCAP0\r\n", "cannot be read"),
        "an MCAP of words": ("e.mcap", b"hello", "does not begin as a .mcap"),
        "a database that only begins": (
            "f.db3",
            b"SQLite format 3\0" + bytes(90),
            "cannot be read",
        ),
        "a video alone": ("g.mp4", b"", "has no g.npz beside it"),
        "a RealSense bag that only begins": (
            "h.bag",
            b"#ROSBAG V2.0\n" + bytes(99) + b"/file_version" + bytes(99),
            "cannot be played",
        ),
    }
    found = {}
    for name, (file, data, words) in made.items():
        (folder / file).write_bytes(data)
        found[name] = (folder / file, words)
    for name, content in (("empty", ""), ("of words", "hello"), ("of nothing", "a: [")):
        place = folder / f"ros2 {name}"
        place.mkdir()
        (place / "metadata.yaml").write_text(content)
        found[f"a ROS 2 bag whose metadata are {name}"] = (place, "cannot be read")
    (folder / "i.r3d").mkdir()
    found["a folder called .r3d"] = (folder / "i.r3d", "recording.json: is missing")
    (folder / "j.bag").mkdir()
    found["a folder called .bag"] = (folder / "j.bag", "")
    return found


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory, write: dict) -> dict[str, tuple[Path, str]]:
    """All of them, with the words that their line should hold."""
    root, made = tmp_path_factory.mktemp("bad"), {}
    sound = {
        "tum": (write["tum"](root / "sound-tum", small()), TUM),
        "video": (write["video"](root / "sound-video", small()), VIDEO),
        "r3d": (write["r3d"](root / "sound", small()), R3D),
    }
    redwood = root / "sound-redwood"
    shutil.copytree(sound["tum"][0], redwood)
    (redwood / "rgb").rename(redwood / "color")
    for path in redwood.glob("*.txt"):
        path.unlink()
    for channel in ("color", "depth"):
        for i, path in enumerate(sorted((redwood / channel).iterdir())):
            path.rename(path.with_name(f"{i:06d}.png"))
    (redwood / "trajectory.log").write_text(ROW * FRAMES)
    sound["redwood"] = (redwood, REDWOOD)
    for kind, (path, entries) in sound.items():
        for name, (spoil, words) in entries.items():
            copy = root / kind / re.sub(r"\W", "-", name) / path.name
            copy.parent.mkdir(parents=True)
            (shutil.copytree if path.is_dir() else shutil.copy)(path, copy)
            spoil(copy)
            made[f"{kind}: {name}"] = (copy, words)
    for name, (spoil, words) in BAGS.items():
        path = root / f"bag {name}"
        made[f"bag: {name}"] = (
            write["bag"](path, "ros2", spoilt_entries(write, spoil)),
            words,
        )
    whole = write["bag"](root / "sound.bag", "ros1", write["entries"](small()))
    (root / "cut.bag").write_bytes(whole.read_bytes()[:-200])
    made["bag: cut off"] = (root / "cut.bag", "cannot be read")
    return made | {f"file: {k}": v for k, v in _files(root).items()}


def _unclear(name: str, line: str, path: Path, words: str) -> tuple[str, str] | None:
    clear = (
        line.startswith("akm-fg: ")
        and str(path) in line
        and words in line
        and "; expected " in line
        and "could not be fitted" not in line
    )
    return None if clear else (name, line)


def test_each_bad_source_is_one_clear_line_and_nothing_is_lost(
    bad: dict[str, tuple[Path, str]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert len(bad) > 110
    good, out = tmp_path / "good.npz", tmp_path / "out.jsonl"
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.2, (12, 3)) + np.linspace(0, 0.15, 8)[:, None, None] * [0, 0, 1.0]
    np.savez(good, points=points + rng.normal(0, 1e-3, points.shape), sigma_m=1e-3)
    inputs = [good, *(path for path, _ in bad.values()), good]
    assert main(["fit", *map(str, inputs), "--json", str(out)]) == 2
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("akm-fg")]
    found = [
        _unclear(name, line, path, words)
        for (name, (path, words)), line in zip(bad.items(), said, strict=True)
    ]
    assert [entry for entry in found if entry is not None] == []
    done = [json.loads(line)["input"] for line in out.read_text().splitlines()]
    assert done == [str(good)] * 2


def test_what_cannot_be_converted_leaves_nothing(
    bad: dict[str, tuple[Path, str]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, (path, _) in list(bad.items())[::3]:
        assert main(["convert", str(path), str(tmp_path / "out")]) == 2, name
        captured = capfd.readouterr()
        said = [line for line in captured.err.splitlines() if line.startswith("akm-fg")]
        assert len(said) == 1 and "wrote" not in captured.out, (name, captured.err)
        assert list(tmp_path.iterdir()) == [], name


@pytest.mark.slow
def test_each_alone_is_one_line_and_exit_code_2(
    bad: dict[str, tuple[Path, str]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    ours = _all(tmp_path)
    assert len(ours) + len(bad) > 200
    for name, (path, _) in {**ours, **bad}.items():
        assert main(["fit", str(path)]) == 2, name
        assert len(capfd.readouterr().err.splitlines()) == 1, name
