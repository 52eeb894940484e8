"""Objects that the camera does not see."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.rig.unseen import unseen_doubts
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(40, 30, 40.0, 40.0, 20.0, 15.0)


def _frame(missing):
    """The object in the middle; a share of its box has no depth."""
    depth = np.ones((30, 40), dtype=np.float32)
    depth[10 : 10 + round(10 * missing), 10:30] = np.nan
    rgb = np.zeros((30, 40, 3), dtype=np.uint8)
    return RgbdFrame(0.0, rgb, depth, CAMERA, gtsam.Pose3())


@pytest.mark.parametrize(("missing", "said"), [(0.1, False), (0.2, False), (0.5, True)])
def test_an_object_without_depth_is_said(missing, said):
    mask = np.zeros((30, 40), dtype=bool)
    mask[10, 10:30] = mask[19, 10:30] = True
    doubts = unseen_doubts([_frame(missing)] * 3, mask, 0.2)
    assert bool(doubts) is said
    assert not said or "50 % of the object's place has no depth" in doubts[0].text


def test_without_an_object_nothing_is_said():
    assert unseen_doubts([_frame(1.0)], np.zeros((30, 40), dtype=bool), 0.2) == []
