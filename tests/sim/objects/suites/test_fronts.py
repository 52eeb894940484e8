"""All fronts look as if they opened, one is free, and nothing but a pull tells which."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import gtsam
import numpy as np
import pytest

from sim.bullet import p
from sim.camera.views import FixedViewConfig, fixed_view
from sim.objects.part_spec import BuiltObject
from sim.objects.published_place import place_as_published
from sim.objects.suites.catalogue import SUITES, find_suite, load_spec
from sim.objects.suites.families import APPLIANCES
from sim.objects.suites.fronts import dress
from sim.objects.suites.furniture_body import make_body
from sim.objects.suites.furniture_build import build_furniture, measure_furniture
from sim.objects.suites.manners import LEVER_MIN_M, SHARES, Spot, lever_m, spot_of
from sim.objects.textures import TILE_M
from sim.robot.contacts import nearby
from sim.truth import distance_to_part_m, true_handles
from sim.world import SimWorld

DEV = list(find_suite("furniture-dev"))
OF_EACH_FAMILY = sorted({spec.family: spec.name for spec in DEV}.values())
TRIES = 2.5  # of an explorer that knows every handle but not which part is free, at least


def tries(suite: str) -> float:
    """(n + 1) / 2 of n handles, over a suite: each is as likely to be the free one."""
    return float(np.mean([(spec.handles + 1) / 2 for spec in find_suite(suite)]))


@pytest.mark.parametrize("suite", SUITES)
def test_who_knows_every_handle_but_not_the_free_part_needs_two_and_a_half_tries(suite: str):
    assert tries(suite) >= TRIES
    fronts = [spec.fronts for spec in find_suite(suite)]
    assert max(fronts) == 8


@pytest.mark.parametrize("suite", SUITES)
def test_handles_sit_in_every_manner_and_some_fronts_are_decoys(suite: str):
    specs = list(find_suite(suite))
    assert {spec.looks.manner for spec in specs} == set(SHARES)
    kinds = Counter(
        kind for spec in specs for kind in ("blind", "rails", "knobs") if getattr(spec.looks, kind)
    )
    assert all(kinds[kind] >= 0.05 * len(specs) for kind in ("blind", "rails", "knobs"))


@pytest.mark.parametrize("name", OF_EACH_FAMILY)
def test_what_is_built_has_the_fronts_and_handles_that_the_spec_counts(name: str):
    spec = load_spec(name, 0)
    body = make_body(spec)
    assert len(body.locked) + 1 == spec.fronts
    found = dress(spec, body).p_handles
    assert np.isfinite([*found, np.zeros(3)]).all(axis=1).sum() == spec.handles


@pytest.mark.parametrize("name", [s.name for s in DEV if s.family not in (*APPLIANCES, "sliding")])
def test_a_locked_front_is_the_board_that_a_free_one_is(name: str):
    spec = load_spec(name, 0)
    body = make_body(spec)
    lower, upper = (corner + body.origin for corner in body.front())
    for other_lower, other_upper in body.locked:
        np.testing.assert_allclose(other_lower[1], lower[1], atol=1e-6)
        np.testing.assert_allclose(other_upper[1], upper[1], atol=1e-6)


def test_the_grain_of_the_free_front_goes_on_where_its_neighbours_ends(tmp_path: Path):
    """Same texture coordinates at the same place: the part's frame cannot be seen."""
    spec = load_spec("furniture-dev/drawer-006", 0)
    build_furniture(spec, tmp_path)
    origin = make_body(spec).origin
    offsets = []
    for mesh, at in (("part_front.obj", origin), ("corpus_front.obj", np.zeros(3))):
        corners, uvs, normals = read_faces(tmp_path / mesh)
        seen = normals[:, 1] < -0.99
        offsets.append((uvs[seen] * TILE_M - (corners[seen] + at)[:, [0, 2]]).round(5))
    assert len(np.unique(np.concatenate(offsets), axis=0)) == 1


def read_faces(path: Path) -> list[np.ndarray]:
    """Corners (N, 3), texture coordinates (N, 2) and normals (N, 3), as faces use them."""
    lists: dict[str, list] = {"v": [], "vt": [], "vn": []}
    triples = set()
    for line in path.read_text().splitlines():
        key, *rest = line.split() or [""]
        if key in lists:
            lists[key].append([float(x) for x in rest])
        elif key == "f":
            triples |= {tuple(int(i) - 1 for i in corner.split("/")) for corner in rest}
    chosen = np.array(sorted(triples))
    return [np.array(values)[chosen[:, k]] for k, values in enumerate(lists.values())]


@pytest.mark.parametrize(
    ("hinge", "spot", "expected_m"),
    [
        ("left", Spot(True, 1.0, 0.0), 0.45),
        ("right", Spot(True, 1.0, 0.0), 0.05),
        ("left", Spot(True, 0.0, 0.0), 0.25),
        ("bottom", Spot(False, 0.0, 1.0), 0.25),
        ("top", Spot(False, 0.0, 1.0), 0.05),
        (None, Spot(False, 0.0, 0.0), np.inf),
    ],
)
def test_the_lever_is_from_the_hinge_to_the_handle(hinge, spot: Spot, expected_m: float):
    assert lever_m(spot, hinge, (0.5, 0.3), 0.05) == pytest.approx(expected_m)


def test_the_usual_handle_is_far_from_its_hinge_and_the_wrong_one_is_not():
    front = (0.5, 0.4)
    for hinge in ("left", "right", "top", "bottom"):
        levers = [
            lever_m(spot_of(manner, hinge, 0.3, 1.0), hinge, front, 0.05)
            for manner in ("usual", "middle_lying", "wrong")
        ]
        assert levers[0] > levers[1] > levers[2] >= LEVER_MIN_M


@pytest.mark.parametrize("suite", SUITES)
def test_a_child_can_pull_at_every_free_handle_wherever_it_sits(suite: str):
    """What resists, at the handle itself, and not only at the free edge."""
    for spec in find_suite(suite):
        if spec.kind == "prismatic" or spec.handle.style in ("edge", "lip"):
            continue
        spot = spot_of(spec.looks.manner, spec.hinge, spec.handle.along, spec.looks.side)
        lever = lever_m(spot, spec.hinge, spec.front_m, spec.handle.edge_m)
        to_beat = spec.friction + (spec.catch.force if spec.catch else 0.0)
        to_beat += spec.closer.pulls(0.0) if spec.closer else 0.0
        assert to_beat < 25.0 * lever, spec.name


# A thick door, a flap among others, a sliding door and a drawer.
PASSING = [f"furniture-dev/{name}" for name in ("door-009", "door-008", "slide-001", "drawer-016")]


@pytest.mark.parametrize("name", PASSING)
def test_the_free_part_opens_past_its_neighbours_and_their_handles(name: str):
    passes_its_neighbours(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", [spec.name for suite in SUITES.values() for spec in suite])
def test_every_free_part_opens_past_its_neighbours_and_their_handles(name: str, seed: int):
    passes_its_neighbours(name, seed)


def passes_its_neighbours(name: str, seed: int) -> None:
    """Nothing opens by itself in the paper's place, and all the range is free of the corpus."""
    with SimWorld(name, seed, placement="published") as world:
        for _ in range(200):
            world.step()
        assert abs(world.part_state()) < 2e-3
        where = {"physicsClientId": world.client}
        for state in np.linspace(0.0, world.spec.upper, 25):
            p.resetJointState(world.object_id, world.part_joint, state, **where)
            near = nearby(
                world.client,
                world.object_id,
                world.object_id,
                0.01,
                link=world.part_joint,
                other_link=-1,
            )
            assert min((x.distance_m for x in near), default=1.0) > -1e-3, state


def test_the_free_handle_is_the_one_that_the_part_carries():
    with SimWorld("furniture-dev/door-001", 0, placement="published") as world:
        handles = true_handles(world)
        assert len(handles) == world.spec.handles and [h.free for h in handles].count(True) == 1
        away = [distance_to_part_m(world, handle.p_world) for handle in handles]
        assert away[0] < 1e-3 and min(away[1:]) > 0.03
        closed = handles[0].p_world
        where = {"physicsClientId": world.client}
        p.resetJointState(world.object_id, world.part_joint, np.deg2rad(40.0), **where)
        assert distance_to_part_m(world, closed) > 0.03  # it went away with the door


@pytest.mark.parametrize("suite", SUITES)
def test_every_object_is_in_view_as_a_whole_wherever_it_stands(suite: str):
    """The eight corners of its box, between the borders of 640 x 480 pixels, less four."""
    view = FixedViewConfig()
    T_world_cam, focal = fixed_view(view), view.focal_px(480)
    for name in find_suite(suite).names():
        for seed in range(3):
            spec = find_suite(suite).load(name, seed)
            nothing = np.full(3, np.nan)
            built = BuiltObject(spec, Path(), nothing, nothing, gtsam.Pose3(), nothing, 0.0)
            T = T_world_cam.inverse() * place_as_published(built).T_world_object
            for x in (-0.5, 0.5):
                for y in (-0.5, 0.5):
                    for z in (0.0, 1.0):
                        x_cam, y_cam, depth = T.transformFrom(spec.size_m * [x, y, z])
                        assert abs(focal * x_cam / depth) < 316.0, (name, seed)
                        assert abs(focal * y_cam / depth) < 236.0, (name, seed)


def test_measuring_an_object_gives_what_building_it_does(tmp_path: Path):
    spec = load_spec("furniture-dev/door-004", 0)
    built, measured = build_furniture(spec, tmp_path), measure_furniture(spec)
    assert built.T_object_handle.equals(measured.T_object_handle, 0.0)
    for name in ("axis_object", "pivot_object", "p_object_front", "p_object_handles"):
        np.testing.assert_array_equal(getattr(built, name), getattr(measured, name))
