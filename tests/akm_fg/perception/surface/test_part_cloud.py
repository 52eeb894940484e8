"""Clouds of a keyframe: on the part, spread over it, reproducible."""

import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.part_cloud import part_cloud

PART = 2
NOISE = DepthNoiseModel()


def door_panel_error(clip, frame: int, p_world: np.ndarray) -> np.ndarray:
    """Signed distance (N,) to the front face of the door (x = 0.02 when closed)."""
    back = clip.scene.motion(clip.states[frame]).inverse()
    return np.array([back.transformFrom(p)[0] for p in p_world]) - 0.02


def test_points_lie_on_the_part_within_their_noise(door) -> None:
    frame = 10
    cloud = part_cloud(
        door.frames[frame], door.labels[frame] == PART, frame, NOISE, np.random.default_rng(0), 800
    )
    assert len(cloud.uv) == 800 and cloud.frame == frame
    e = door_panel_error(door, frame, cloud.p_world)
    panel = np.abs(e) < 0.015  # the handle stands out farther
    assert panel.mean() > 0.95
    whitened = e[panel] / cloud.sigma_normal_m[panel]
    assert 0.2 < whitened.std() < 1.0  # smoothed: better than a single reading
    assert abs(np.median(whitened)) < 0.3
    normal = door.scene.motion(door.states[frame]).rotation().matrix()[:, 0]
    assert np.median(cloud.normal_world[panel] @ normal) > 0.985


def test_all_points_lie_in_the_mask_on_the_grid(door) -> None:
    mask = door.labels[5] == PART
    cloud = part_cloud(door.frames[5], mask, 5, NOISE, np.random.default_rng(1), stride_px=4)
    u, v = cloud.uv.astype(int).T
    assert mask[v, u].all()
    assert len(np.unique(u % 4)) == len(np.unique(v % 4)) == 1
    assert len(u) > 0.7 * mask.sum() / 16


def test_one_seed_gives_one_cloud(door) -> None:
    mask = door.labels[5] == PART
    a, b, c = (
        part_cloud(door.frames[5], mask, 5, NOISE, np.random.default_rng(s), 50).uv
        for s in (4, 4, 5)
    )
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_an_empty_mask_gives_an_empty_cloud(door) -> None:
    none = np.zeros_like(door.labels[0], dtype=bool)
    cloud = part_cloud(door.frames[0], none, 0, NOISE, np.random.default_rng(0), 10)
    assert cloud.p_world.shape == (0, 3) and cloud.sigma_normal_m.shape == (0,)


@pytest.mark.parametrize(("points", "stride"), [(0, 1), (10, 0)])
def test_no_points_and_no_stride_are_refused(door, points: int, stride: int) -> None:
    mask = door.labels[0] == PART
    with pytest.raises(ValueError, match="at least 1"):
        part_cloud(door.frames[0], mask, 0, NOISE, np.random.default_rng(0), points, stride)
