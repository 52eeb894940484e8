"""Tracks as .npz: round trip, and one clear line for every broken file."""

from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.tracks import NOMINAL_SIGMA_M, read_tracks, write_tracks
from akm_fg.records import PointTracks

POINTS = np.random.default_rng(0).normal(size=(4, 5, 3))
POINTS[2, 1] = np.nan
COV = np.broadcast_to(np.diag([1e-6, 2e-6, 3e-6]), (4, 5, 3, 3)).copy()


def save(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)
    return path


def test_tracks_come_back_as_written(tmp_path: Path) -> None:
    cov = COV.copy()
    cov[2, 1] = np.nan
    write_tracks(tmp_path / "a.npz", PointTracks(POINTS, cov))
    got = read_tracks(tmp_path / "a.npz")
    assert got.noise_known
    np.testing.assert_array_equal(got.tracks.p_world, POINTS)
    np.testing.assert_array_equal(got.tracks.cov_world, cov)


@pytest.mark.parametrize("sigma_m", [0.002, np.full((4, 5), 0.002)])
def test_sigma_becomes_an_isotropic_covariance(tmp_path: Path, sigma_m: object) -> None:
    got = read_tracks(save(tmp_path / "a.npz", points=POINTS, sigma_m=sigma_m))
    assert got.noise_known
    np.testing.assert_allclose(got.tracks.cov_world[0, 0], 4e-6 * np.eye(3))
    assert np.isnan(got.tracks.cov_world[2, 1]).all()


def test_without_a_noise_level_it_says_so(tmp_path: Path) -> None:
    got = read_tracks(save(tmp_path / "a.npz", points=POINTS.astype(np.float32)))
    assert not got.noise_known
    np.testing.assert_allclose(got.tracks.cov_world[0, 0], NOMINAL_SIGMA_M**2 * np.eye(3))


def test_a_point_with_one_unknown_coordinate_is_lost(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[0, 0, 1] = np.nan
    got = read_tracks(save(tmp_path / "a.npz", points=points))
    assert np.isnan(got.tracks.p_world[0, 0]).all()
    assert not got.tracks.observed[0, 0]


def with_entry(cov: np.ndarray, index: tuple[int, ...], value: float) -> np.ndarray:
    changed = cov.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"positions": POINTS}, "has no `points`, it holds `positions`"),
        ({"points": POINTS, "tracks": POINTS}, "has both `points` and `tracks`"),
        ({"points": POINTS[0]}, "`points` has shape (5, 3)"),
        ({"points": POINTS[..., :2]}, "`points` has shape (4, 5, 2)"),
        ({"points": POINTS[:, :0]}, "`points` has shape (4, 0, 3)"),
        ({"points": POINTS[:1]}, "`points` has 1 frame(s)"),
        ({"points": np.array([["a"]])}, "`points` is of type <U1"),
        ({"points": POINTS.astype(complex)}, "`points` is of type complex128"),
        ({"points": np.array([{}], dtype=object)}, "`points` holds Python objects"),
        ({"points": with_entry(POINTS, (3, 4, 0), np.inf)}, "infinite in frame 3, point 4"),
        ({"points": POINTS, "sigma_m": 0.0}, "`sigma_m` is 0 in frame 0, point 0"),
        ({"points": POINTS, "sigma_m": np.nan}, "`sigma_m` is nan"),
        ({"points": POINTS, "sigma_m": np.ones(4)}, "`sigma_m` has shape (4,)"),
        ({"points": POINTS, "cov": COV[0]}, "`cov` has shape (5, 3, 3)"),
        ({"points": POINTS, "cov": with_entry(COV, (1, 2, 0, 1), 1e-6)}, "not symmetric in"),
        ({"points": POINTS, "cov": with_entry(COV, (1, 2, 2, 2), 0)}, "not positive definite in"),
        ({"points": POINTS, "cov": with_entry(COV, (1, 2, 2, 2), -1)}, "not positive definite in"),
        ({"points": POINTS, "cov": with_entry(COV, (1, 2, 2, 2), np.nan)}, "not finite in frame 1"),
        ({"points": POINTS, "cov": COV, "sigma_m": 1e-3}, "both `cov` and `sigma_m`"),
    ],
)  # fmt: skip
def test_broken_tracks_are_named(tmp_path: Path, arrays: dict, message: str) -> None:
    path = save(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError) as caught:
        read_tracks(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"not an archive", b"\x80\x04K\x01.", b"PK\x03\x04junk"])
def test_a_file_that_is_no_archive_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"is not an \.npz archive"):
        read_tracks(tmp_path / "a.npz")


def test_a_truncated_or_damaged_archive_is_named(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", points=POINTS)
    data = bytearray(path.read_bytes())
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="truncated"):
        read_tracks(path)
    data[300] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InputError, match="is damaged"):
        read_tracks(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_tracks(tmp_path / "a.npz")
    with pytest.raises(InputError, match="is a folder"):
        read_tracks(tmp_path)
