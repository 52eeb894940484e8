"""The object in later frames: what opened belongs to it, the robot and the wall do not."""

import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.object_now import object_now

NOISE = DepthNoiseModel()


@pytest.mark.parametrize("name", ["door", "drawer", "door_behind_robot"])
def test_what_has_opened_is_part_of_the_object(name: str, request) -> None:
    clip = request.getfixturevalue(name)
    t = len(clip.frames) - 3
    first = np.isin(clip.labels[0], (1, 2))
    mask = object_now(clip.frames[0], first, clip.frames[t], NOISE)
    truth = np.isin(clip.labels[t], (1, 2)) & np.isfinite(clip.frames[t].depth_m)
    opened = truth & ~first
    assert opened.sum() > 300
    assert mask[opened].mean() > 0.85
    assert mask[truth].mean() > 0.97
    assert not (mask & ~first & (clip.labels[t] == 3)).any()  # the robot
    assert (mask & ~first & (clip.labels[t] == 0)).sum() < 0.02 * truth.sum()  # floor and wall


def test_where_nothing_has_moved_the_mask_stays(still) -> None:
    first = np.isin(still.labels[0], (1, 2))
    np.testing.assert_array_equal(object_now(still.frames[0], first, still.frames[9], NOISE), first)


def test_something_new_beside_the_object_is_none_of_it(still) -> None:
    first = np.isin(still.labels[0], (1, 2))
    frame = still.frames[5]
    frame.depth_m[200:220, 5:40] -= 0.3
    try:
        mask = object_now(still.frames[0], first, frame, NOISE)
    finally:
        frame.depth_m[200:220, 5:40] += 0.3
    np.testing.assert_array_equal(mask, first)
