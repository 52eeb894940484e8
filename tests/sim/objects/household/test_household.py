"""The household suites: what is in them, that their solids are sound, and that they move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError
from sim.bullet import p
from sim.objects.household.household_build import build_household, textures
from sim.objects.household.household_spec import FAMILIES, LOOKS, SMALL_SHARE
from sim.objects.household.household_suites import HOUSEHOLD
from sim.objects.household.shapes import shapes_of
from sim.objects.suites.catalogue import find_suite, load_spec
from sim.world import SimWorld

DEV = list(HOUSEHOLD["household-dev"])
OF_EACH_FAMILY = sorted({spec.family: spec.name for spec in DEV}.values())
PUSH_N = 4.0  # on things of a pound, at the grip


@pytest.mark.parametrize(
    ("name", "count", "split"), [("household-60", 60, "test"), ("household-dev", 24, "dev")]
)
def test_a_suite_has_every_family_and_look(name: str, count: int, split: str):
    specs = list(find_suite(name))
    assert len(find_suite(name)) == len(specs) == count
    assert {spec.split for spec in specs} == {split}
    assert {spec.family for spec in specs} == set(FAMILIES)
    assert {spec.finish for spec in specs} == set(LOOKS)
    assert {spec.kind for spec in specs} == {"prismatic", "revolute"}
    assert 0 < np.mean([spec.small for spec in specs]) < 2 * SMALL_SHARE


def test_the_suites_share_no_object():
    masses = {name: {round(spec.mass_kg, 9) for spec in suite} for name, suite in HOUSEHOLD.items()}
    assert not masses["household-60"] & masses["household-dev"]


def test_a_bad_name_gets_one_clear_line():
    with pytest.raises(InputError, match="thing-001 to thing-024"):
        load_spec("household-dev/thing-025", 0)


@pytest.mark.parametrize("spec", DEV, ids=lambda spec: spec.name)
def test_solids_are_closed_and_part_and_corpus_do_not_meet(spec):
    shapes = shapes_of(spec)
    for solid in [*shapes.corpus, *shapes.part]:
        assert solid.mesh.is_watertight and solid.mesh.volume > 0
        assert all(piece.is_convex for piece in solid.hard)
    axis, grip = shapes.axis, shapes.grip - shapes.origin
    np.testing.assert_allclose(np.linalg.norm(axis), 1.0)
    if spec.kind == "revolute":  # opening lifts the grip, or brings it to the front
        way = np.cross(axis, grip)
        assert way[2] > 0 or way[1] < 0


def test_the_same_name_builds_the_same_bytes(tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        build_household(load_spec("household-dev/thing-003", 3), folder)
    files = sorted(f.name for f in folders[0].iterdir())
    assert {"object.urdf", "part_0.obj", "part.png"} <= set(files)
    for file in files:
        assert (folders[0] / file).read_bytes() == (folders[1] / file).read_bytes(), file


def test_dark_things_are_dark_and_glossy_ones_shine(tmp_path: Path):
    by_look = {spec.finish: spec for spec in DEV}
    assert textures(by_look["dark"])["part"].mean() < 50 < textures(by_look["plain"])["part"].mean()
    build_household(by_look["glossy"], tmp_path)
    assert (tmp_path / "part_0_metal.obj").exists()


@pytest.mark.parametrize("name", OF_EACH_FAMILY)
def test_a_thing_settles_opens_when_pushed_and_keeps_to_its_range(name: str):
    with SimWorld(name, 0) as world:
        little, enough = (0.002, 0.02) if world.spec.kind == "prismatic" else (0.01, 0.1)
        _run(world, 0.3)
        assert abs(world.part_state()) < little
        _run(world, 1.5, PUSH_N)
        assert enough < world.part_state() < 1.05 * world.spec.upper


def _run(world: SimWorld, seconds: float, push_n: float = 0.0) -> None:
    """Steps the world while pushing at the grip, along the way that it can go."""
    built, T = world.built, world.placement.T_world_object
    arm = built.T_object_handle.translation() - built.pivot_object
    for _ in range(round(seconds / world.config.step_s)):
        if push_n > 0.0:
            turn = world.part_state() if world.spec.kind == "revolute" else 0.0
            out = arm * np.cos(turn) + np.cross(built.axis_object, arm) * np.sin(turn)
            turns = world.spec.kind == "revolute"
            way = np.cross(built.axis_object, out) if turns else built.axis_object
            at = built.pivot_object + (out if turns else arm)
            force = push_n * T.rotation().matrix() @ (way / np.linalg.norm(way))
            p.applyExternalForce(
                world.object_id,
                world.part_joint,
                force.tolist(),
                T.transformFrom(at).tolist(),
                p.WORLD_FRAME,
                physicsClientId=world.client,
            )
        world.step()
