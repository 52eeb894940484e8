"""A handle that crept away is noticed where it was, and taken where it is."""

from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import pytest

from akm_fg.errors import GraspFailed
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.explore import Explorer, explore
from akm_fg.exploration.records import Contact, Exploration
from akm_fg.exploration.seen_anew import SeenAnewConfig, changed, followed
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
LOOKING = gtsam.Pose3(gtsam.Rot3(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])), np.zeros(3))
CONFIG = SeenAnewConfig()
FRONT_M, HANDLE_M = 1.0, 0.96  # before the camera
NORMAL = np.array([-1.0, 0.0, 0.0])


def seen(y_m: float, stamp_s: float = 0.0) -> RgbdFrame:
    """A front with a handle of 3 cm by 12 cm on it."""
    depth = np.full((240, 320), FRONT_M, np.float32)
    u = CAMERA.cx + CAMERA.fx * (np.array([-0.015, 0.015]) - y_m) / HANDLE_M
    depth[100:138, round(u[0]) : round(u[1])] = HANDLE_M
    return RgbdFrame(stamp_s, np.zeros((240, 320, 3), np.uint8), depth, CAMERA, LOOKING)


def place(y_m: float, x_m: float = HANDLE_M) -> np.ndarray:
    return np.array([x_m, y_m, 0.0])


def handle(y_m: float, front: int = 0) -> Contact:
    return Contact(place(y_m), np.array([160.0, 120.0]), NORMAL, front, 0.5)


def test_a_handle_that_crept_aside_is_noticed_where_it_was_and_nowhere_else():
    before, after = seen(0.0), seen(0.06)
    assert changed(before, after, place(0.0), CONFIG)
    assert not changed(before, before, place(0.0), CONFIG)
    assert not changed(before, seen(0.002), place(0.0), CONFIG)
    assert not changed(before, after, place(0.2, FRONT_M), CONFIG)


def test_what_the_arm_hides_and_what_is_out_of_view_tells_nothing():
    before, after = seen(0.0), seen(0.06)
    hidden = replace(after, depth_m=np.full_like(after.depth_m, np.nan))
    assert not changed(before, hidden, place(0.0), CONFIG)
    for far in (place(0.0, -1.0), place(5.0), place(-5.0)):
        assert not changed(before, after, far, CONFIG)


@pytest.mark.parametrize(("y_m", "way"), [(-0.06, "left"), (0.06, "right")])
def test_it_is_followed_to_the_nearest_of_its_like_that_was_not_there(y_m, way):
    other = handle(0.04, front=1)
    exploration = Exploration(contacts=(handle(0.0), other))
    edge = replace(handle(0.02), what="edge")
    found = [handle(0.04), edge, handle(2 * y_m), handle(y_m)]
    assert followed(exploration, 0, found, CONFIG) == way
    assert exploration.contacts[0].p_world[1] == y_m
    assert exploration.contacts[0].front == 0
    assert exploration.contacts[1] is other


def test_where_nothing_like_it_is_near_it_stays():
    exploration = Exploration(contacts=(handle(0.0), handle(0.1)))
    assert followed(exploration, 0, [handle(0.1), handle(0.6), handle(0.005)], CONFIG) is None
    assert exploration.contacts[0].p_world[1] == 0.0


@dataclass
class Creeping:
    """Arm and camera before a door that slides when it is touched, and is never held."""

    y_m: float = 0.0
    clock: float = 0.0
    reached_m: list[float] = field(default_factory=list)
    goes_m: tuple[float, ...] = (0.08,)

    def capture(self):
        self.clock += 0.1
        return seen(self.y_m, self.clock)

    def T_world_gripper(self):
        return gtsam.Pose3(gtsam.Rot3(), place(0.0, 0.5))

    def see(self, frame):
        pass

    def step_aside(self, frame, tick_s, unseen=False):
        yield

    def holding(self):
        return False

    def grasp(self, T_world_grasp, tick_s, feel_m=0.0):
        yield
        self.reached_m.append(float(T_world_grasp.translation()[1]))
        self.y_m += sum(self.goes_m[:1])
        self.goes_m = self.goes_m[1:]
        raise GraspFailed("the fingers met with nothing between them")


class Unseeing:
    def add(self, frame, hand=None):
        pass


class Quiet:
    """Hears and says nothing."""

    def __getattr__(self, name):
        return lambda *_: None


@pytest.mark.parametrize("belief", ["bayes", "suppression"])
def test_the_next_grasp_is_where_the_handle_is_and_it_is_left_when_it_is_missed_on(belief):
    door, exploration = Creeping(), Exploration()
    explorer = Explorer(
        lambda frame: [handle(door.y_m)],
        lambda frame, contact: [
            gtsam.Pose3(gtsam.Rot3.Rx(0.3 * k), contact.p_world) for k in range(9)
        ],
        lambda number: Unseeing(),
        ExploreConfig(belief=belief, max_attempts=9),
    )
    explore(door, door, explorer, exploration, Quiet())
    assert door.reached_m[:3] == [0.0, 0.08, 0.08]
    if belief == "bayes":
        assert len(exploration.attempts) == 1 + explorer.config.bayes.most_missed
        assert exploration.failure is not None
        assert "opens with probability 1.00" in exploration.failure
