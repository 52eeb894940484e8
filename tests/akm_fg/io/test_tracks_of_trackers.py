"""Archives as trackers write them: the same tracks come out, and what was guessed is said."""

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.read_options import ReadOptions
from akm_fg.io.tracks import read_tracks

FRAMES, N = 30, 40


def _door(turn_rad: float = 1.0, frames: int = FRAMES, points: np.ndarray | None = None):
    rng = np.random.default_rng(0)
    shape = rng.uniform([0.1, -0.02, 0.2], [0.5, 0.02, 1.0], (N, 3)) if points is None else points
    a = np.linspace(0, turn_rad, frames)
    R = np.zeros((frames, 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(a)
    R[:, 1, 0], R[:, 0, 1], R[:, 2, 2] = np.sin(a), -np.sin(a), 1
    moved = np.einsum("tij,nj->tni", R, shape) + np.array([0.2, 0.9, 0.1])
    return moved + rng.normal(0, 1e-3, moved.shape)


POINTS = _door()
SEEN = np.random.default_rng(1).random((FRAMES, N)) > 0.2
LOST = np.where(SEEN[..., None], POINTS, np.nan)


def _save(tmp_path: Path, **arrays: object) -> Path:
    np.savez(tmp_path / "a.npz", **arrays)
    return tmp_path / "a.npz"


@pytest.mark.parametrize("name", ["points", "tracks", "trajectories", "tracks_XYZ"])
def test_names_of_trackers_are_taken(tmp_path: Path, name: str) -> None:
    got = read_tracks(_save(tmp_path, **{name: POINTS}))
    np.testing.assert_array_equal(got.tracks.p_world, POINTS)
    assert got.notes == ()


@pytest.mark.parametrize(
    "arrays",
    [
        {"visible": SEEN},
        {"visibility": SEEN.astype(np.uint8)},
        {"visibility": SEEN.T},
        {"visibility": SEEN[None]},
        {"visible": SEEN[..., None]},
        {"visibs": np.where(SEEN, 0.9, 0.3)},
        {"occluded": ~SEEN},
    ],
)
def test_what_is_not_visible_is_lost(tmp_path: Path, arrays: dict) -> None:
    got = read_tracks(_save(tmp_path, tracks=POINTS[None], **arrays))
    np.testing.assert_array_equal(got.tracks.p_world, LOST)
    assert f"{int((~SEEN).sum())} points that are not visible" in got.notes[-1]


@pytest.mark.parametrize("lost", [(0, 0, 0), (0, 0, -1), (-1, -1, -1)])
def test_zero_and_minus_one_stand_for_lost_points(tmp_path: Path, lost: tuple) -> None:
    got = read_tracks(_save(tmp_path, points=np.where(SEEN[..., None], POINTS, lost)))
    np.testing.assert_array_equal(got.tracks.p_world, LOST)
    assert got.notes == (f"{int((~SEEN).sum())} points at exactly 0 or -1 were taken as lost",)


def test_a_coordinate_that_is_zero_is_no_lost_point(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[3, 4] = [0.0, 0.0, 0.7]
    got = read_tracks(_save(tmp_path, points=points))
    assert got.tracks.observed.all() and got.notes == ()


@pytest.mark.parametrize("seen", [{}, {"visible": SEEN.T}, {"visible": SEEN}])
def test_points_first_is_turned_round_and_said(tmp_path: Path, seen: dict) -> None:
    sigma_m = np.random.default_rng(2).uniform(1e-3, 2e-3, (FRAMES, N))
    path = _save(tmp_path, points=POINTS.swapaxes(0, 1), sigma_m=sigma_m.T, **seen)
    got = read_tracks(path)
    np.testing.assert_array_equal(got.tracks.p_world, LOST if seen else POINTS)
    here = got.tracks.observed
    np.testing.assert_allclose(got.tracks.cov_world[..., 0, 0][here], sigma_m[here] ** 2)
    assert got.notes[0] == "`points` of shape (40, 30, 3) was read as 40 points through 30 frames"


def test_as_many_points_as_frames_are_told_apart_too(tmp_path: Path) -> None:
    points, seen = _door(frames=N), np.random.default_rng(1).random((N, N)) > 0.2
    path = _save(tmp_path, points=points.swapaxes(0, 1), visible=seen.T)
    want = np.where(seen[..., None], points, np.nan)
    np.testing.assert_array_equal(read_tracks(path).tracks.p_world, want)
    path = _save(tmp_path, points=points, visible=seen)
    np.testing.assert_array_equal(read_tracks(path).tracks.p_world, want)


def test_a_dense_grid_that_jumps_stays_as_it_is(tmp_path: Path) -> None:
    """Neighbours 2 mm apart, steps of 20 deg: nearer than times are, but the door is rigid."""
    line = np.stack([np.linspace(0.1, 0.5, 200), np.zeros(200), np.ones(200)], axis=1)
    points = _door(1.4, 5, line)
    got = read_tracks(_save(tmp_path, points=points))
    np.testing.assert_array_equal(got.tracks.p_world, points)
    assert got.notes == ()


def test_millimetres_are_read_as_such_and_said(tmp_path: Path) -> None:
    cov = np.broadcast_to(np.eye(3), (FRAMES, N, 3, 3))  # 1 mm^2
    got = read_tracks(_save(tmp_path, points=1000 * POINTS, cov=cov))
    np.testing.assert_allclose(got.tracks.p_world, POINTS)
    np.testing.assert_allclose(got.tracks.cov_world[0, 0], 1e-6 * np.eye(3))
    assert "likely millimetres" in got.notes[0]
    told = read_tracks(_save(tmp_path, points=1000 * POINTS), ReadOptions(unit="m"))
    np.testing.assert_allclose(told.tracks.p_world, 1000 * POINTS)
    assert told.notes == ()


def test_pixels_and_depth_are_refused_with_that_word(tmp_path: Path) -> None:
    uvd = POINTS / POINTS[..., 2:] * [600, 600, 0] + POINTS * [0, 0, 1]
    with pytest.raises(InputError, match="likely pixels and depth"):
        read_tracks(_save(tmp_path, points=uvd))
    with pytest.raises(InputError, match="looks like pixels without depth"):
        read_tracks(_save(tmp_path, points=uvd[..., :2]))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"visible": SEEN[:5]}, "`visible` has shape (5, 40)"),
        ({"visible": SEEN, "vis": SEEN}, "has both `visible` and `vis`"),
        ({"visible": 7.0 * SEEN}, "`visible` holds 7"),
        ({"visible": np.full((FRAMES, N), np.nan)}, "`visible` holds nan"),
        ({"visible": np.full((FRAMES, N), "yes")}, "`visible` is of type <U3"),
        ({"Points": POINTS}, "holds `points` twice"),
    ],
)
def test_masks_that_do_not_fit_are_named(tmp_path: Path, arrays: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_tracks(_save(tmp_path, points=POINTS, **arrays))
    assert message in str(caught.value) and "\n" not in str(caught.value)


def _npy_that_claims(shape: tuple[int, ...], data: bytes, dtype: str = "<f8") -> bytes:
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}}}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def _archive(tmp_path: Path, member: bytes) -> Path:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", member)
    (tmp_path / "a.npz").write_bytes(buffer.getvalue())
    return tmp_path / "a.npz"


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((10**6, 10**4, 3), "claims 3e+10 numbers"),
        ((2, 10**6, 3), "claims shape (2, 1000000, 3) (48000000 bytes) and holds 8"),
        ((10**18, 10**18, 3), "claims 3e+36 numbers"),
        ((-1, 4, 3), "is damaged|claims"),
    ],
)
def test_what_a_header_claims_is_checked_before_memory_is_taken(
    tmp_path: Path, shape: tuple[int, ...], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_tracks(_archive(tmp_path, _npy_that_claims(shape, b"\0" * 8)))
    assert any(words in str(caught.value) for words in message.split("|"))


def test_an_archive_that_inflates_beyond_the_limit_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("akm_fg.io.arrays.npz.MAX_NUMBERS", 10**6)
    path = tmp_path / "a.npz"
    zeros = bytes(2**20)
    header = _npy_that_claims((512, 32, 256), b"")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("points.npy", "w", force_zip64=True) as member:
            member.write(header)
            for _ in range(512 * 32 * 256 * 8 // 2**20):
                member.write(zeros)
    assert path.stat().st_size < 1e5
    tracemalloc.start()
    with pytest.raises(InputError, match=r"claims 4\.19e"):
        read_tracks(path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
