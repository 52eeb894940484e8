"""The furniture suites: what is in them, that it is built soundly, and that it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.arm.body.collision import ArmCollisions
from akm_fg.arm.body.model import FINGERS
from akm_fg.arm.motion.reaching import ReachConfig, choose_grasp_configuration
from akm_fg.errors import InputError
from sim.bullet import p
from sim.episode import open_world
from sim.objects.suites.catalogue import SUITES, find_suite, load_spec
from sim.objects.suites.finishes import textures
from sim.objects.suites.furniture_body import make_body
from sim.objects.suites.furniture_build import build_furniture
from sim.objects.suites.furniture_spec import DRAWER_BACK_M, RANGE_MIN_M, SLIDING_DOOR
from sim.objects.suites.handles import edge_strip, handle_boxes, handle_pose
from sim.robot.franka_config import FrankaConfig
from sim.robot.true_obstacles import true_obstacles
from sim.world import SimWorld, WorldConfig

ALL = [spec.name for suite in SUITES.values() for spec in suite]
SAMPLE = ["furniture-dev/drawer-004", "furniture-dev/slide-001", "furniture-dev/door-012"]
HANDLED = [s for s in find_suite("furniture-dev") if s.handle.style != "edge"]
OF_EACH_FAMILY = sorted({s.family: s.name for s in HANDLED}.values())
HANDLELESS = [s.name for s in find_suite("furniture-dev") if s.handle.style == "edge"]
PULL_N = 25.0  # what a child can do


@pytest.mark.parametrize(
    ("name", "prismatic", "doors", "slides", "split"),
    [("furniture-116", 60, 56, 4, "test"), ("furniture-dev", 20, 20, 2, "dev")],
)
def test_a_suite_has_its_objects_by_name(
    name: str, prismatic: int, doors: int, slides: int, split: str
):
    suite = find_suite(name)
    specs = list(suite)
    assert len(suite) == len(specs) == prismatic + doors
    assert [s.kind for s in specs] == ["prismatic"] * prismatic + ["revolute"] * doors
    assert sum(s.name.startswith(f"{name}/slide-") for s in specs) == slides
    assert specs[0].name == f"{name}/drawer-001" and specs[-1].name == f"{name}/door-{doors:03d}"
    assert {s.split for s in specs} == {split}
    assert {s.hinge for s in specs} == {None, "left", "right", "top", "bottom"}
    assert {s.handle.style for s in specs} == {"bar", "rod", "arch", "knob", "lip", "edge"}


@pytest.mark.parametrize("suite", SUITES)
def test_a_third_of_each_kind_is_plain(suite: str):
    for kind in ("prismatic", "revolute"):
        plain = [spec.plain for spec in find_suite(suite) if spec.kind == kind]
        assert abs(sum(plain) - len(plain) / 3.0) <= 0.5


@pytest.mark.parametrize("suite", SUITES)
def test_ranges_hold_the_benchmark_and_drawers_stay_in_their_cabinets(suite: str):
    for spec in find_suite(suite):
        if spec.kind == "prismatic":
            assert spec.upper >= RANGE_MIN_M
            room = spec.size_m[0] * SLIDING_DOOR if spec.family == "sliding" else spec.size_m[1]
            back = 0.0 if spec.family == "sliding" else DRAWER_BACK_M
            assert room >= spec.upper + back - 1e-9
        else:
            assert spec.upper >= np.deg2rad(40.0)
        assert 0.9 <= spec.scale <= 1.1


@pytest.mark.parametrize("suite", SUITES)
def test_a_share_of_the_objects_is_caught_or_closes_itself_and_a_child_can_open_all(suite: str):
    specs = list(find_suite(suite))
    assert 0.25 < np.mean([s.catch is not None for s in specs]) < 0.55
    assert 0.08 < np.mean([s.closer is not None for s in specs]) < 0.32
    for spec in specs:
        to_beat = spec.friction + (spec.catch.force if spec.catch else 0.0)
        to_beat += spec.closer.pulls(0.0) if spec.closer else 0.0
        # At the handle of a door, which is at most 8 cm from the free edge.
        lever = spec.front_m[0 if spec.hinge in ("left", "right") else 1]
        assert to_beat < PULL_N * (1.0 if spec.hinge is None else lever - 0.08), spec.name


@pytest.mark.parametrize("suite", SUITES)
def test_rubber_pads_slide_on_handles_as_on_metal_and_lacquer(suite: str):
    """Dry rubber on smooth hard surfaces: 0.5 to 1.1 (Avallone, Baumeister, Marks' Standard
    Handbook, table 3.2.1: coefficients of friction). The contact's is the product of both.
    """
    mu = np.array([spec.handle_mu for spec in find_suite(suite)]) * WorldConfig().finger_mu
    assert mu.min() >= 0.5 and mu.max() <= 1.1
    assert len(np.unique(mu)) == mu.size


def test_the_suites_share_no_object():
    sizes = {s: {round(float(o.mass_kg), 9) for o in find_suite(s)} for s in SUITES}
    assert not sizes["furniture-116"] & sizes["furniture-dev"]


def test_the_name_fixes_the_object_and_the_seed_its_scale():
    first, again, other = (load_spec("furniture-dev/door-005", seed) for seed in (0, 0, 1))
    assert repr(first) == repr(again)
    assert other.scale != first.scale
    np.testing.assert_allclose(other.size_m / other.scale, first.size_m / first.scale)
    assert other.handle == first.handle and other.friction == first.friction


@pytest.mark.parametrize("name", ["furniture-dev/drawer-005", "furniture-dev/door-016"])
def test_the_same_name_builds_the_same_bytes(name: str, tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        build_furniture(load_spec(name, 3), folder)
    files = sorted(f.name for f in folders[0].iterdir())
    assert {"object.urdf", "part_handle.obj", "front.png"} <= set(files)
    for file in files:
        assert (folders[0] / file).read_bytes() == (folders[1] / file).read_bytes(), file


@pytest.mark.parametrize("plain", [True, False])
def test_plain_surfaces_have_one_or_two_grey_levels_and_others_more(plain: bool):
    spec = next(s for s in find_suite("furniture-dev") if s.plain is plain)
    images = textures(spec)
    for surface in ("front", "carcass"):
        spread = images[surface].astype(float).std(axis=(0, 1)).max()
        assert spread < 1.5 if plain else spread > 4.0


@pytest.mark.parametrize("name", OF_EACH_FAMILY)
def test_the_handle_stands_on_the_front_and_leaves_room_for_fingers(name: str):
    spec = load_spec(name, 0)
    body = make_body(spec)
    lower, upper = body.front()
    T_part_handle = handle_pose(spec, lower, upper)
    boxes = handle_boxes(spec.handle, T_part_handle)
    corners = np.concatenate([_corners(box.size_m, box.T_link_box.matrix()) for box in boxes])
    assert corners[:, 1].max() > lower[1] - 1e-3  # touches the front
    assert lower[1] - T_part_handle.translation()[1] >= 0.025  # stands off it
    assert (corners[:, [0, 2]] > lower[[0, 2]] - 1e-3).all()
    assert (corners[:, [0, 2]] < upper[[0, 2]] + 1e-3).all()
    T_object_handle = body.origin + T_part_handle.translation()
    assert 0.0 < T_object_handle[2] < spec.size_m[2]


@pytest.mark.parametrize("name", HANDLELESS)
def test_without_a_handle_the_board_stands_over_its_carcass_where_fingers_pinch_it(name: str):
    spec = load_spec(name, 0)
    body = make_body(spec)
    lower, upper = body.front()
    strip = edge_strip(spec, spec.hinge, lower, upper)
    T_part_handle = handle_pose(spec, lower, upper)
    assert handle_boxes(spec.handle, T_part_handle) == []
    p_strip = strip.T_link_box.transformTo(T_part_handle.translation())
    assert (np.abs(p_strip) < strip.size_m / 2.0).all()  # between the fingers is the board
    pads = T_part_handle.rotation().matrix()[:, 1]
    np.testing.assert_allclose(np.abs(pads), [0.0, 1.0, 0.0])  # across its thickness
    # Behind the board is room for a finger whose tip goes a centimetre past the grip.
    p_object = body.origin + T_part_handle.translation()
    T_past = T_part_handle.rotation().matrix()[:, 2]
    corpus = [(b.T_link_box.translation(), b.size_m / 2.0) for b in body.corpus]
    for behind_m in (0.02, 0.04):
        at = p_object + [0.0, behind_m, 0.0] + 0.010 * T_past
        assert not any((np.abs(at - c) < half).all() for c, half in corpus)


@pytest.mark.parametrize("suite", SUITES)
def test_nothing_stands_beside_the_free_edge_of_a_front_without_handle(suite: str):
    bare = [spec for spec in find_suite(suite) if spec.handle.style == "edge"]
    assert len(bare) >= 4
    for spec in bare:
        upright = spec.hinge in ("left", "right")
        beside = len(spec.face.columns) if upright else spec.face.fronts[0].top + 1
        assert beside == 1, spec.name  # alone in its row, or the topmost


def test_a_sliding_door_opens_away_from_the_column_beside_it():
    for spec in find_suite("furniture-dev"):
        if spec.family != "sliding":
            continue
        body = make_body(spec)
        lower, upper = body.front()
        column = min(body.corpus, key=lambda b: b.T_link_box.y() - b.size_m[1] / 2.0)
        to_column = column.T_link_box.translation() - (lower + upper) / 2.0
        assert abs(body.axis[0]) == 1.0 and body.axis @ to_column < 0.0


def _corners(size_m: np.ndarray, T: np.ndarray) -> np.ndarray:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return (signs * size_m / 2.0) @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("name", SAMPLE)
def test_an_object_settles_moves_when_pulled_and_stays_where_it_is_left(name: str):
    settles_moves_and_stays(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_every_object_settles_moves_when_pulled_and_stays_where_it_is_left(name: str):
    settles_moves_and_stays(name)


def settles_moves_and_stays(name: str) -> None:
    with SimWorld(name, 0) as world:
        prismatic = world.spec.kind == "prismatic"
        little, enough = (0.001, 0.03) if prismatic else (0.005, np.deg2rad(5.0))
        assert world.placement.T_world_object.z() >= world.placement.floor_m - 1e-9
        run(world, 0.3)
        assert abs(world.part_state()) < little  # did not open by itself, or explode
        run(world, 1.0, PULL_N)
        opened = world.part_state()
        assert enough < opened <= world.spec.upper + 0.01
        # Halfway, where the weight of a lying hinge's door is felt.
        middle = world.spec.upper / 2.0
        p.resetJointState(world.object_id, world.part_joint, middle, physicsClientId=world.client)
        run(world, 0.3)
        closer = world.spec.closer
        if closer is not None and closer.pulls(middle) > 0.0:  # may shut it, and nothing else
            assert -little < world.part_state() < middle + 4.0 * little
        else:
            assert abs(world.part_state() - middle) < 4.0 * little


def run(world: SimWorld, seconds: float, pull_n: float = 0.0) -> None:
    """Steps the world while pulling at the handle, along the way that it can go."""
    built, T = world.built, world.placement.T_world_object
    arm = built.T_object_handle.translation() - built.pivot_object
    axis = built.axis_object
    way = axis if world.spec.kind == "prismatic" else np.cross(axis, arm)
    way = T.rotation().matrix() @ (way / np.linalg.norm(way))
    at = T.transformFrom(built.T_object_handle.translation())
    for _ in range(round(seconds / world.config.step_s)):
        if pull_n > 0.0:
            p.applyExternalForce(
                world.object_id,
                world.part_joint,
                (pull_n * way).tolist(),
                at.tolist(),
                p.WORLD_FRAME,
                physicsClientId=world.client,
            )
        world.step()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("attic/door-001", "furniture-116, furniture-dev"),
        ("furniture-dev/door-021", "drawer-001 to drawer-018, slide-001 to slide-002"),
        ("furniture-dev/slide-003", "door-001 to door-020"),
        ("furniture-dev/door-1", "door-001 to door-020"),
        ("furniture-dev/", "door-001 to door-020"),
    ],
)
def test_a_bad_name_gets_one_clear_line(name: str, told: str):
    with pytest.raises(InputError, match=told) as caught, open_world(name):
        pass
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", [0, 2])
def test_the_palm_stays_clear_of_the_board_whose_edge_is_pinched(seed: int):
    """By as much as the hand may be off when it arrives: `arrival_m`."""
    with SimWorld("furniture-dev/door-014", seed) as world:
        boards = [replace(shape, spared=FINGERS) for shape in true_obstacles(world)]
        choice = choose_grasp_configuration(
            world.kinematics, world.placement.given_grasp(), ReachConfig(starts=4)
        )
        assert choice is not None
        assert ArmCollisions(boards, FrankaConfig().arrival_m).touched(choice.q_grasp) is None
