"""Pairs of pictures by stamps, poses between poses, and how much a stream claims to hold."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.sources.lzfse import inflated_size
from akm_fg.io.sources.matching import match
from akm_fg.io.sources.stamped_poses import StampedPoses


def test_each_picture_is_paired_with_the_nearest_and_once():
    colour = np.array([0.0, 0.1, 0.2, 0.3, 0.9])
    depth = np.array([0.004, 0.05, 0.108, 0.15, 0.195, 0.21, 0.301])
    got = match(colour, depth)
    assert got.pairs == ((0, 0), (1, 2), (2, 4), (3, 6))
    np.testing.assert_allclose(got.apart_s, [0.004, 0.008, -0.005, 0.001])
    assert got.alone == 1


def test_pictures_of_another_time_and_repeated_stamps_make_no_pairs():
    assert match(np.arange(3.0), np.arange(3.0) + 0.4).pairs == ()
    assert match(np.arange(0.0), np.arange(3.0)).pairs == ()
    twice = match(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.001, 0.1]))
    assert (np.diff(twice.stamps_s) > 0).all() and len(twice.pairs) == 2


def test_a_pose_between_two_is_on_the_way_and_beyond_them_unknown():
    a = gtsam.Pose3(gtsam.Rot3(), np.zeros(3))
    b = gtsam.Pose3(gtsam.Rot3.Rz(0.2), np.array([1.0, 0.0, 0.0]))
    poses = StampedPoses.ordered(np.array([10.1, 10.0, 10.1]), [b, a, a])
    middle = poses.at(10.05)
    np.testing.assert_allclose(middle.translation(), [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(gtsam.Rot3.Logmap(middle.rotation()), [0, 0, 0.1], atol=1e-12)
    assert poses.at(10.0).equals(a, 0) and poses.at(10.1).equals(b, 0)
    assert poses.at(10.14).equals(b, 0) and poses.at(10.2) is None and poses.at(9.9) is None
    far = StampedPoses(np.array([0.0, 1.0]), (a, b))
    assert far.at(0.5) is None
    assert StampedPoses(np.array([5.0]), (a,)).at(99.0) is a


def test_what_a_stream_claims_to_hold_is_what_it_holds(tmp_path: Path):
    liblzfse = pytest.importorskip("liblzfse")
    rng = np.random.default_rng(0)
    for data in (
        b"",
        b"abc",
        bytes(10**6),
        rng.bytes(10**5),
        rng.normal(size=20_000).astype("<f4").tobytes(),
        rng.integers(0, 4, 10**6, dtype=np.uint8).tobytes(),
    ):
        assert inflated_size(liblzfse.compress(data), tmp_path) == len(data)
    for broken in (b"", b"bvx2", b"hello there, hello there", liblzfse.compress(bytes(999))[:-2]):
        with pytest.raises(InputError, match=r"is empty|is damaged near byte"):
            inflated_size(broken, tmp_path)
