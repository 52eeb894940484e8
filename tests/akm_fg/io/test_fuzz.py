"""Readers on anything: what they should give, or one line that says why not."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from akm_fg.errors import InputError
from akm_fg.io.config_file import read_config
from akm_fg.io.png import read_depth_raw, read_mask, read_rgb
from akm_fg.io.pose_log import read_pose_log
from akm_fg.io.recording import read_recording, read_truth
from akm_fg.io.tracks import read_tracks

# A warning would be a second line on standard error.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

# The file is written anew for each example, so that one folder serves them all.
FUZZ = settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _refused(read: Callable[[], object]) -> object | None:
    """What a reader gives; None where it refuses in one line."""
    try:
        return read()
    except InputError as error:
        text = str(error)
        assert "\n" not in text.replace(error.place, "") and "; expected " in text, text
        return None


NUMBERS = st.one_of(
    st.floats(width=32).map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(
        ["nan", "", "1e400", "-", "1,5", "0x10", "1_0", "\ufeff", "∞", '"1"', "#", "1e-400"]
    ),
)
ROWS = st.lists(st.lists(NUMBERS, min_size=1, max_size=18), max_size=6)
SEPARATORS = st.sampled_from([" ", ",", ";", "\t", ", ", " ;", "|"])
HEADERS = st.sampled_from(
    ["", "x y z\n", "#timestamp, p_x [m], p_y [m], p_z [m], q_w, q_x, q_y, q_z\n", "x,y,z,x\n"]
)


@FUZZ
@given(HEADERS, ROWS, SEPARATORS)
@example("", [["1e400", "2", "3"]] * 2, " ")
@example("", [["1e308", "2", "3"], ["-1e308", "2", "3"]], " ")
@example("", [["3e38"] * 7] * 2, " ")
@example("", [["1e200"] * 12] * 2, " ")
def test_any_rows_are_poses_or_refused(
    tmp_path: Path, header: str, rows: list[list[str]], separator: str
) -> None:
    path = tmp_path / "a.log"
    path.write_text(header + "\n".join(separator.join(row) for row in rows), encoding="utf-8")
    track = _refused(lambda: read_pose_log(path))
    if track is not None:
        assert np.isfinite(track.p_world).all() and track.p_world.shape[1:] == (3,)
        if track.R_world_part is not None:
            np.testing.assert_allclose(
                track.R_world_part @ track.R_world_part.swapaxes(1, 2),
                np.broadcast_to(np.eye(3), track.R_world_part.shape),
                atol=1e-6,
            )


@FUZZ
@given(st.one_of(st.binary(max_size=200), st.text(max_size=100).map(str.encode)))
@example(b"\xff\xfe")
@example(b"\xff\xfe1")
@example("1 2 3\x0b4 5 6\x1c7 8 9\u20281 1 1".encode())
def test_any_bytes_are_poses_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(data)
    _refused(lambda: read_pose_log(path))


ARRAYS = hnp.arrays(
    st.sampled_from(
        [np.float64, np.float32, np.int16, np.uint8, np.bool_, np.complex64, "<U2", "<M8[s]"]
    ),
    hnp.array_shapes(min_dims=0, max_dims=5, min_side=0, max_side=4),
)
NAMES = st.sampled_from(
    ["points", "tracks", "Points", "visible", "occluded", "cov", "sigma_m", "x"]
)


@FUZZ
@given(st.dictionaries(NAMES, ARRAYS, max_size=4))
@example({"points": np.zeros((2, 1, 3))})
@example({"points": np.full((2, 2, 3), 3e38, np.float32)})
@example({"points": np.ones((3, 2, 3)), "visible": np.ones((1, 1, 1))})
@example({"points": np.ones((2, 2, 3)), "sigma_m": np.float64(1e300)})
@example({"points": np.full((2, 2, 3), 1e308) * np.array([1.0, -1.0])[:, None, None]})
def test_any_arrays_are_tracks_or_refused(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    path = tmp_path / "a.npz"
    with path.open("wb") as file:
        np.savez(file, **arrays)
    got = _refused(lambda: read_tracks(path))
    if got is not None:
        seen = got.tracks.observed
        assert np.isfinite(got.tracks.cov_world[seen]).all()
        assert np.isnan(got.tracks.p_world[~seen]).all()


def _spoilt(data: bytes, changes: list[tuple[int, int]], cut: int) -> bytes:
    spoilt = bytearray(data)
    for where, value in changes:
        spoilt[where % len(spoilt)] = value
    return bytes(spoilt[: len(spoilt) - cut])


SPOIL = (
    st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 255)), max_size=4),
    st.integers(0, 90),
)


def _archive() -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, points=np.arange(36.0).reshape(4, 3, 3), sigma_m=0.1)
    return buffer.getvalue()


@FUZZ
@given(*SPOIL)
def test_a_spoilt_archive_is_tracks_or_refused(
    tmp_path: Path, changes: list[tuple[int, int]], cut: int
) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(_spoilt(_archive(), changes, cut))
    _refused(lambda: read_tracks(path))


@FUZZ
@given(st.binary(max_size=120))
@example(b"\x93NUMPY\x01\x00\x06\x00[1]   ")
@example(b"\x93NUMPY\x01\x00\x02\x00((")
@example(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}")
@example(
    b"\x93NUMPY\x01\x00\x46\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1, 2, 3.5)}     "
)
@example(
    b"\x93NUMPY\x01\x00\x46\x00{'descr': [('a','<f8')], 'fortran_order': False, 'shape': (1,)}    "
)
def test_any_member_of_an_archive_is_refused(tmp_path: Path, member: bytes) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("points.npy", member)
    assert _refused(lambda: read_tracks(path)) is None


RGB = np.random.default_rng(0).integers(0, 255, (6, 8, 3), dtype=np.uint8)
IMAGES = {
    "rgb": (RGB, read_rgb),
    "depth": (RGB[..., 0].astype(np.uint16) * 200, read_depth_raw),
    "mask": ((RGB[..., 0] > 128).astype(np.uint8) * 255, read_mask),
}


@pytest.mark.parametrize("channel", IMAGES)
@FUZZ
@given(*SPOIL)
def test_a_spoilt_picture_is_one_of_its_size_or_refused(
    tmp_path: Path, channel: str, changes: list[tuple[int, int]], cut: int
) -> None:
    image, read = IMAGES[channel]
    data = cv2.imencode(".png", image)[1].tobytes()
    path = tmp_path / "a.png"
    path.write_bytes(_spoilt(data, changes, cut))
    got = _refused(lambda: read(path, 8, 6))
    assert got is None or got.shape == image.shape


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)
PLACES = st.sampled_from(
    (
        "schema camera camera.width camera.fx depth_unit_m T_world_cam stamps_s T_world_gripper "
        "grasp_frames truth truth.kind truth.axis truth.pivot truth.states"
    ).split()
)


def _described() -> dict:
    return {
        "schema": "akm-fg/recording/1",
        "camera": {"width": 8, "height": 6, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 3.0},
        "depth_unit_m": 0.001,
        "T_world_cam": np.eye(4).tolist(),
        "stamps_s": [0.0, 1.0],
        "T_world_gripper": [np.eye(4).tolist()] * 2,
        "grasp_frames": [0, 1],
        "truth": {"kind": "revolute", "axis": [0, 0, 1], "pivot": [0, 0, 0], "states": [0, 1]},
    }


@FUZZ
@given(PLACES, JSON)
@example("camera.width", 10**30)
@example("stamps_s", [0.0, 1e308])
@example("stamps_s", [-1e308, 1e308])
@example("depth_unit_m", 1e308)
@example("depth_unit_m", 1e-320)
@example("camera.fx", 1e-320)
@example("grasp_frames", [0, 1e300])
@example("T_world_cam", (1e200 * np.eye(4)).tolist())
@example("truth.axis", [1e200, 0, 0])
@example("schema", "a\nb")
def test_any_description_is_a_recording_or_refused(
    tmp_path: Path, place: str, value: object
) -> None:
    folder = tmp_path / "recording"
    described = _described()
    inner, names = described, place.split(".")
    for name in names[:-1]:
        inner = inner[name]
    inner[names[-1]] = value
    for channel in ("rgb", "depth"):
        (folder / channel).mkdir(parents=True, exist_ok=True)
        for i in range(2):
            cv2.imwrite(str(folder / channel / f"{i:06d}.png"), IMAGES[channel][0])
    (folder / "recording.json").write_text(json.dumps(described))
    _refused(lambda: read_recording(folder))
    _refused(lambda: read_truth(folder))


@FUZZ
@given(*SPOIL)
def test_a_spoilt_description_is_refused_or_read(
    tmp_path: Path, changes: list[tuple[int, int]], cut: int
) -> None:
    folder = tmp_path / "recording"
    folder.mkdir(exist_ok=True)
    data = json.dumps(_described()).encode()
    (folder / "recording.json").write_bytes(_spoilt(data, changes, cut))
    _refused(lambda: read_truth(folder))


@FUZZ
@given(st.one_of(st.binary(max_size=60), st.text(max_size=60).map(str.encode)))
@example(b"fit.dof = nan")
@example(b"fit.dof = 1e999")
@example(b"fit = 3")
@example(b"fit.prior = []")
@example(b"a." * 2000 + b"b = 1")
@example(b"a = " + b"[" * 2000)
def test_any_settings_are_taken_or_refused(tmp_path: Path, data: bytes) -> None:
    from akm_fg.config import AkmConfig

    path = tmp_path / "a.toml"
    path.write_bytes(data)
    _refused(lambda: read_config(path, AkmConfig()))
