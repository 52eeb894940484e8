"""All parts of a model are followed, and none is taken for another."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.io.recording_writer import write_recording
from akm_fg.model.write import write_model
from akm_fg.records import PinholeCamera, Recording
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.relocalization.several import FollowedPart, PartsRelocalizer
from tests.akm_fg.conftest import ASIDE, Cabinet, look_at, photograph

CAMERA = PinholeCamera(400, 260, 340.0, 340.0, 199.5, 129.5)
T_WORLD_CAM = look_at(np.array([1.9, 0.55, 1.0]), np.array([0.0, 0.35, 0.33]))


def seen(door_q: float, drawer_q: float, stamp_s: float = 0.0):
    """A frame of both cabinets, the door and the drawer open so far."""
    beside = gtsam.Pose3(gtsam.Rot3(), ASIDE)
    quads = Cabinet("revolute").at(door_q)
    quads += [
        replace(quad, T_world_quad=beside * quad.T_world_quad)
        for quad in Cabinet("prismatic", floor=False, wall=False).at(drawer_q)
    ]
    rng = np.random.default_rng(round(1e3 * (1.0 + door_q + drawer_q)))
    return replace(photograph(CAMERA, T_WORLD_CAM, quads, rng), stamp_s=stamp_s)


def signs(model) -> list[float]:
    """Of the states by which the parts of a model open."""
    return [float(np.sign(part.states.mean[-1])) for part in model.parts]


@pytest.mark.parametrize(("door_q", "drawer_q"), [(0.0, 0.0), (0.5, 0.0), (0.3, 0.15)])
def test_each_part_is_found_wherever_the_others_are(two_part_model, door_q, drawer_q) -> None:
    beliefs = PartsRelocalizer(two_part_model).update(seen(door_q, drawer_q))
    for belief, q, sign in zip(beliefs, (door_q, drawer_q), signs(two_part_model), strict=True):
        assert belief.mode == "tracking" and belief.sd < 0.01
        assert abs(sign * belief.mean - q) < 4.0 * belief.sd


def test_the_hand_moves_the_part_that_it_holds_and_no_other(two_part_model) -> None:
    follower = PartsRelocalizer(two_part_model)
    follower.update(seen(0.0, 0.0))
    dark = seen(0.0, 0.0, 0.1)
    dark = replace(dark, depth_m=np.full_like(dark.depth_m, np.nan))
    way = 0.05 * signs(two_part_model)[1]
    door, drawer = follower.update(dark, None, 1, way)
    assert abs(door.mean) < 0.02 and drawer.mean == pytest.approx(way, abs=0.01)
    with pytest.raises(ValueError, match="part 2 of 2"):
        follower.update(replace(dark, stamp_s=0.2), None, 2)


def test_the_parts_beside_the_one_that_is_moved_are_known_and_whether_they_moved(two_part_model):
    follower = FollowedPart(two_part_model, 0)
    (_, name) = (part.name for part in two_part_model.parts)
    assert follower.beside == {name: None}  # nobody has looked yet
    door = follower.update(seen(0.0, 0.1))
    for k in (1, 2):
        door = follower.update(seen(0.02 * k, 0.1, 0.1 * k))
    assert abs(door.mean) == pytest.approx(0.04, abs=0.01)
    assert abs(follower.beside[name].last.mean) == pytest.approx(0.1, abs=0.005)
    assert not follower.beside[name].moved
    for k in range(3, 9):  # found again after a few frames that contradict what was believed
        follower.update(seen(0.04, 0.13, 0.1 * k))
    assert abs(follower.beside[name].last.mean) == pytest.approx(0.13, abs=0.005)
    assert follower.beside[name].moved


def test_what_one_part_shows_is_not_taken_for_another(door_model, drawer_aside) -> None:
    """A second drawer, behind the first: opened to where that one is, it would look the same."""
    (drawer,) = drawer_aside.parts
    behind = replace(drawer.surface, p_world=drawer.surface.p_world - np.array([0.1, 0.0, 0.0]))
    hidden = replace(drawer, name="part-1", surface=behind)
    model = replace(drawer_aside, parts=(drawer, hidden))
    frame = seen(0.0, 0.0)
    alone = Relocalizer(model, 1).update(frame)
    assert alone.mode == "tracking" and abs(alone.mean) == pytest.approx(0.1, abs=0.01)
    first, second = PartsRelocalizer(model).update(frame)
    assert first.mode == "tracking" and abs(first.mean) < 0.01
    assert second.mode == "searching" and second.mean is None


def test_the_command_tells_of_every_part(two_part_model, tmp_path, capfd) -> None:
    (tmp_path / "model").mkdir()
    write_model(tmp_path / "model", two_part_model)
    frames = [seen(0.02 * k, 0.01 * k, 0.1 * k) for k in range(3)]
    write_recording(tmp_path / "later", Recording("later", tuple(frames)))
    words = ["relocalize", str(tmp_path / "model"), str(tmp_path / "later"), "--json", "-"]
    assert main(words) == 0
    told = json.loads(capfd.readouterr().out)
    assert [part["part"] for part in told["parts"]] == ["part-0", "part-1"]
    assert [part["unit"] for part in told["parts"]] == ["rad", "m"]
    assert len(told["stamps_s"]) == len(told["parts"][0]["mean"]) == 3
    assert abs(told["parts"][1]["mean"][-1]) == pytest.approx(0.02, abs=0.005)
    assert main([*words, "--part", "1"]) == 0
    alone = json.loads(capfd.readouterr().out)
    assert alone["part"] == "part-1" and alone["mean"] == told["parts"][1]["mean"]
    for name in ("3", "lid", "12,13"):
        assert main([*words, "--part", name]) == 2
        error = capfd.readouterr().err.strip()
        assert "--part" in error and "\n" not in error
