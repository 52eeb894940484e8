"""A door that stands edge-on shows nothing that its model knows, and is still somewhere."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.model.build import FittedRecording, build_model
from akm_fg.records import Recording
from akm_fg.relocalization.config import RelocalizationConfig
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.relocalization.silhouette import Silhouette
from tests.akm_fg.conftest import Cabinet, film, photograph


class Hollow(Cabinet):
    """A cabinet in which there is nothing behind its door."""

    def quads(self):
        rest, part = super().quads()
        return rest[:1] + rest[2:], part  # without the face towards +x


# The rendered cabinet's door stands edge-on at 63.8 deg.
TURNED_DEG = (59.0, 60.0, 67.0, 72.0, 76.0)  # nearer to it the edge is too thin


@pytest.fixture(scope="module")
def door():
    return film(Hollow("revolute", size=(480, 360), focal_px=510.0), np.deg2rad(35), 12)


@pytest.fixture(scope="module")
def model(door, fit_of):
    return build_model(FittedRecording.of(Recording("clip", door.frames), fit_of(door)))


def opens(model) -> float:
    return float(np.sign(model.parts[0].states.mean[-1]))


def seen(scene, q, stamp_s=0.0, gone=False, robot_y=None):
    """The door at q, or only what rests."""
    quads = list(scene.quads()[0]) if gone else scene.at(q, robot_y)
    rng = np.random.default_rng(round(1e3 * (1.0 + q)))
    frame = photograph(scene.camera, scene.T_world_cam, quads, rng)
    return replace(frame, stamp_s=stamp_s)


@pytest.mark.parametrize("deg", TURNED_DEG)
def test_a_door_whose_front_is_not_seen_is_where_its_outline_is(door, model, deg) -> None:
    q = np.deg2rad(deg)
    belief = Relocalizer(model).update(seen(door.scene, q))
    assert belief.mode == "tracking" and belief.by_outline and not belief.seen
    assert abs(opens(model) * belief.mean - q) < 2.0 * belief.sd
    assert np.deg2rad(0.5) < belief.sd < np.deg2rad(3.0)  # outlines are no surfaces
    low, high = (float(word) for word in belief.reason.split()[-4:-1:2])
    assert "its outline it can only stand between" in belief.reason and low < deg < high


def test_a_door_that_is_gone_stands_nowhere(door, model) -> None:
    """Though at some states little of it would be seen."""
    belief = Relocalizer(model).update(seen(door.scene, 0.0, gone=True))
    assert belief.mode == "searching" and belief.mean is None


def test_where_what_rests_is_not_in_its_place_nothing_is_told(door, model) -> None:
    frame = seen(door.scene, np.deg2rad(67.0))
    off = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.3, 0.2]))
    elsewhere = replace(frame, T_world_cam=off * frame.T_world_cam)
    assert Relocalizer(model).update(elsewhere).mean is None


def test_a_front_that_is_seen_is_measured_by_its_surface(door, model) -> None:
    belief = Relocalizer(model).update(seen(door.scene, np.deg2rad(20.0)))
    assert belief.seen and belief.sd < np.deg2rad(0.5)


def test_a_followed_door_that_turns_edge_on_is_not_lost(door, model) -> None:
    """And many frames that show the same outline make it no surer than one."""
    follower, q = Relocalizer(model), np.deg2rad(67.0)
    for k, deg in enumerate((40.0, 45.0, 50.0)):
        assert follower.update(seen(door.scene, np.deg2rad(deg), 0.2 * k)).seen
    beliefs = [follower.update(seen(door.scene, q, 2.0 + 1.0 * k)) for k in range(8)]
    least = follower.part.seen_state(1.0) * np.deg2rad(0.5)
    for belief in beliefs:
        assert belief.mode == "tracking"
        assert abs(opens(model) * belief.mean - q) < 3.0 * belief.sd and belief.sd > least
    assert beliefs[-1].sd < np.deg2rad(6.0)


def test_readings_that_what_rests_explains_are_no_evidence(door, model) -> None:
    """A closed door's cells hold what is around it, too; without the door nothing is on it."""
    config = RelocalizationConfig().silhouette
    silhouette = Silhouette(model.parts[0], model.static, config)
    states = np.linspace(-0.1, 1.8, 120) * opens(model)
    assert silhouette.stands(seen(door.scene, 0.0, gone=True), np.sort(states)) is None
    there = silhouette.stands(seen(door.scene, np.deg2rad(67.0)), np.sort(states))
    assert there is not None and there.shares.on > 0.8
