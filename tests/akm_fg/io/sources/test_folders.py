"""Folders of pictures: JPEG, stamps in names, trajectories of either kind, known cameras."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.sources.registry import open_prepared, read_source
from akm_fg.io.sources.source import SourceOptions
from akm_fg.records import PinholeCamera, Recording, RgbdFrame

CAMERA = PinholeCamera(48, 36, 45.0, 45.0, 23.5, 17.5)
WALK = [gtsam.Pose3(gtsam.Rot3.Ry(0.1 * i), np.array([0.1 * i, 0.0, 0.0])) for i in range(3)]


@pytest.fixture
def small() -> Recording:
    ramp = np.add.outer(np.arange(36), np.arange(48))
    rgb = np.stack([ramp, 2 * ramp, 255 - ramp], -1).astype(np.uint8)
    depth = np.full((36, 48), 1.0, np.float32)
    frames = [RgbdFrame(10 + 0.1 * i, rgb, depth, CAMERA, T) for i, T in enumerate(WALK)]
    return Recording("small", tuple(frames))


def test_colour_may_be_jpeg(write: dict, tmp_path: Path, small: Recording) -> None:
    got = read_source(write["tum"](tmp_path / "a", small, ending="jpg"))
    for frame, true in zip(got.frames, small.frames, strict=True):
        assert np.abs(frame.rgb.astype(int) - true.rgb).max() < 12
        np.testing.assert_array_equal(frame.depth_m, true.depth_m)


def test_a_folder_of_the_benchmark_has_its_camera(
    write: dict, tmp_path: Path, small: Recording
) -> None:
    camera = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    rgb, depth = np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32)
    large = [replace(f, rgb=rgb, depth_m=depth, camera=camera) for f in small.frames[:2]]
    for name, fx, bends in (("freiburg1", 517.3, True), ("freiburg3", 535.4, False)):
        path = tmp_path / f"rgbd_dataset_{name}_door"
        write["tum"](path, replace(small, frames=tuple(large)))
        (path / "camera.json").unlink()
        understood = open_prepared(path).understood
        assert understood.camera.fx == fx and (understood.bend_px > 1) == bends
    path.rename(tmp_path / "mine")
    with pytest.raises(InputError, match="does not say the camera's intrinsics"):
        open_prepared(tmp_path / "mine")
    said = SourceOptions(intrinsics=(525.0, 525.0, 319.5, 239.5))
    assert open_prepared(tmp_path / "mine", said).understood.camera == camera


def redwood(write: dict, folder: Path, recording: Recording) -> Path:
    """Without Open3D, from the pictures of the other format."""
    write["tum"](folder, recording)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        (folder / name).unlink()
    (folder / "rgb").rename(folder / "image")
    for channel in ("image", "depth"):
        for i, path in enumerate(sorted((folder / channel).iterdir())):
            path.rename(path.with_name(f"{i:05d}-{33_333 * i:012d}{path.suffix}"))
    return folder


@pytest.mark.parametrize("ending", ["log", "json"])
def test_stamps_of_names_scale_and_trajectory(
    ending: str, write: dict, tmp_path: Path, small: Recording
) -> None:
    path = redwood(write, tmp_path / "a", small)
    camera = json.loads((path / "camera.json").read_text())
    (path / "camera.json").write_text(json.dumps({**camera, "depth_scale": 5000.0, "fps": 15}))
    if ending == "log":
        rows = [f"{i} {i} {i + 1}\n" + _rows(T.matrix()) for i, T in enumerate(WALK)]
        (path / "trajectory.log").write_text("".join(rows))
    else:
        listed = [{"extrinsic": T.inverse().matrix().T.ravel().tolist()} for T in WALK]
        (path / "trajectory.json").write_text(json.dumps({"parameters": listed}))
    prepared = open_prepared(path)
    np.testing.assert_allclose(prepared.chosen.stamps_s, [0, 0.033333, 0.066666], atol=1e-9)
    for (frame, _), want in zip(prepared.frames(), WALK, strict=True):
        np.testing.assert_allclose(frame.depth_m, 1.0, rtol=1e-6)
        np.testing.assert_allclose(frame.T_world_cam.matrix(), want.matrix(), atol=1e-9)
    assert prepared.understood.depth_unit_from == "depth_scale of the camera file"


def _rows(matrix: np.ndarray) -> str:
    return "".join(" ".join(f"{x:.12f}" for x in row) + "\n" for row in matrix)
