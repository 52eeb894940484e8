"""When a point that looks the same is not the same: by its depth."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.tracking.flow_tracker import FlowTracker
from akm_fg.records import PinholeCamera, RgbdFrame

W, H = 160, 120
CAMERA = PinholeCamera(W, H, 150.0, 150.0, (W - 1) / 2, (H - 1) / 2)
UV = np.array([[60.0, 50.0], [90.0, 70.0]])


def picture() -> np.ndarray:
    coarse = np.random.default_rng(0).integers(40, 215, (H // 4, W // 4))
    return np.repeat(np.kron(coarse, np.ones((4, 4)))[..., None], 3, axis=2).astype(np.uint8)


def frame(stamp_s: float, depth_m: np.ndarray | float) -> RgbdFrame:
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), (H, W)).copy()
    return RgbdFrame(stamp_s, picture(), depth, CAMERA, gtsam.Pose3())


def seen_then(depth_m: np.ndarray | float) -> list[int]:
    """Of two points on a wall at 1 m, those that are found in a second frame of other depth."""
    session = FlowTracker().begin()
    session.advance(frame(0.0, 1.0))
    assert session.follow(UV).index.tolist() == [0, 1]
    return session.advance(frame(0.1, depth_m)).index.tolist()


@pytest.mark.parametrize(("step_m", "found"), [(0.08, [0, 1]), (0.2, []), (-0.2, [])])
def test_a_point_does_not_jump_in_depth(step_m: float, found: list[int]):
    """At 8 Hz a part at 1 m/s comes nearer by 12 cm: what jumps farther covers it, or is behind."""
    assert seen_then(1.0 - step_m) == found


@pytest.mark.parametrize(("known", "found"), [(0.5, [0, 1]), (0.2, [1])])
def test_where_most_depth_is_lost_something_covers_the_point(known: float, found: list[int]):
    """The robot's pixels carry no depth; about the first point a share of the rows has some."""
    depth = np.ones((H, W), np.float32)
    rows = round(9 * (1 - known))
    depth[46 : 46 + rows, 54:67] = np.nan
    assert seen_then(depth) == found


def test_a_point_that_was_covered_is_found_again_at_its_place_and_only_there():
    """After ten frames at most it is given up; where the wall has moved it is another place."""
    for behind_m, found in ((1.0, [0, 1]), (1.05, [])):
        session = FlowTracker().begin()
        session.advance(frame(0.0, 1.0))
        session.follow(UV)
        assert session.advance(frame(0.1, np.nan)).index.tolist() == []
        assert session.advance(frame(0.2, behind_m)).index.tolist() == found
