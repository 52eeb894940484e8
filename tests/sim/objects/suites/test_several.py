"""Cabinets of which several fronts open: what is in the suites, and that each part opens alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError
from sim.bullet import p
from sim.objects.object_record import read_record, write_record
from sim.objects.part_spec import mechanisms
from sim.objects.published_place import place_as_published
from sim.objects.suites.catalogue import CABINETS, SUITES, find_suite, load_spec
from sim.objects.suites.furniture_body import make_body
from sim.objects.suites.furniture_build import build_furniture, measure_furniture
from sim.objects.suites.furniture_spec import DRAWER_BACK_M, RANGE_MIN_M
from sim.truth import distance_to_part_m, true_handles
from sim.world import SimWorld

DEV = [spec.name for spec in find_suite("furniture-multi-dev")]
PULL_N = 25.0  # what a child can do


def test_the_suites_have_their_objects_by_name() -> None:
    assert (len(find_suite("furniture-multi")), len(find_suite("furniture-multi-dev"))) == (12, 4)
    assert {spec.split for spec in find_suite("furniture-multi")} == {"test"}
    assert find_suite("furniture-multi").names()[-1] == "cabinet-012"
    with pytest.raises(InputError, match="cabinet-001 to cabinet-012"):
        load_spec("furniture-multi/cabinet-013", 0)


@pytest.mark.parametrize("suite", CABINETS)
def test_drawers_and_doors_open_on_every_cabinet(suite: str) -> None:
    for spec in find_suite(suite):
        parts = mechanisms(spec)
        assert 3 <= len(parts) <= 4
        assert {part.kind for part in parts} == {"prismatic", "revolute"}
        for part in parts:
            if part.kind == "prismatic":
                assert part.upper >= RANGE_MIN_M
                assert spec.own_m[1] >= part.upper + DRAWER_BACK_M
            else:
                assert part.upper >= np.deg2rad(40.0)
        freed = {front.front for front in spec.more}
        assert len(freed) == len(spec.more) and 0 not in freed


def test_the_name_fixes_which_fronts_open_and_the_seed_does_not() -> None:
    for name in (*DEV, "furniture-multi/cabinet-002"):
        first, again, other = (load_spec(name, seed) for seed in (0, 0, 4))
        assert repr(first) == repr(again)
        assert other.scale != first.scale and other.key == first.key
        for a, b in zip(first.more, other.more, strict=True):
            assert (a.front, a.kind, a.hinge, a.upper) == (b.front, b.kind, b.hinge, b.upper)


def test_the_same_name_builds_the_same_bytes(tmp_path: Path) -> None:
    written = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        spec = load_spec(DEV[0], 3)
        built = build_furniture(spec, folder)
        write_record(folder, built, place_as_published(built))
        written.append({file.name: file.read_bytes() for file in folder.iterdir()})
    assert written[0] == written[1]
    read, _ = read_record(tmp_path / "a", spec)
    np.testing.assert_array_equal(read.more_axes_object, built.more_axes_object)
    np.testing.assert_array_equal(read.more_pivots_object, built.more_pivots_object)


@pytest.mark.parametrize("name", DEV)
def test_freed_fronts_lie_where_the_closed_ones_did(name: str) -> None:
    """To the millimetre: nothing but a pull tells which fronts open."""
    spec = load_spec(name, 0)
    freed, closed = make_body(spec), make_body(replace(spec, more=()))
    np.testing.assert_allclose(np.array(freed.locked), np.array(closed.locked), atol=1e-3)
    places = freed.more_in_locked()
    assert len(set(places)) == len(spec.more)
    for place, part in zip(places, freed.more, strict=True):
        np.testing.assert_allclose(np.array(part.front()), np.array(freed.locked[place]))
    handles = [measure_furniture(s).p_object_handles for s in (spec, replace(spec, more=()))]
    assert len(handles[0]) == len(handles[1])


@pytest.mark.parametrize(
    "name", [DEV[2], *(pytest.param(n, marks=pytest.mark.slow) for n in DEV if n != DEV[2])]
)
def test_each_part_opens_alone_as_its_truth_says(name: str) -> None:
    with SimWorld(name, 0, placement="published") as world:
        assert world.parts == len(mechanisms(world.spec))
        _run(world, 0.3)
        assert max(abs(_states(world))) < 0.002  # none opens by itself
        for part in range(world.parts):
            handle = true_handles(world)[part]
            assert handle.free and distance_to_part_m(world, handle.p_world, part) < 0.03
            _run(world, 0.8, part)
            moved = np.abs(_states(world))
            assert moved[part] > 0.05 and np.delete(moved, part).max() < 0.005
            there = _moved(world, part, handle.p_world)
            assert distance_to_part_m(world, there, part) < 0.03
            joint = world.part_joints[part]
            p.resetJointState(world.object_id, joint, 0.0, physicsClientId=world.client)


def test_locked_none_opens() -> None:
    with SimWorld(DEV[2], 0, placement="published", locked=True) as world:
        for part in range(world.parts):
            _run(world, 0.2, part)
        assert max(abs(_states(world))) < 0.005


def test_objects_of_other_suites_have_one_part() -> None:
    assert all(not spec.more for suite in SUITES for spec in find_suite(suite))
    assert len(mechanisms(load_spec("household-dev/thing-001", 0))) == 1


def _states(world: SimWorld) -> np.ndarray:
    return np.array([world.part_state(part) for part in range(world.parts)])


def _moved(world: SimWorld, part: int, p_world: np.ndarray) -> np.ndarray:
    """Where the truth says that a point (3,) of a closed part is now."""
    truth, q = world.truth(part), world.part_state(part)
    if truth.pivot is None:
        return np.asarray(p_world + q * truth.axis)
    arm, u = p_world - truth.pivot, truth.axis
    turned = arm * np.cos(q) + np.cross(u, arm) * np.sin(q) + u * (u @ arm) * (1 - np.cos(q))
    return np.asarray(truth.pivot + turned)


def _run(world: SimWorld, seconds: float, part: int | None = None) -> None:
    """Steps the world while pulling at a part's handle, the way that it can go."""
    if part is not None:
        truth, closed = world.truth(part), true_handles(world)[part].p_world
        arm = np.zeros(3) if truth.pivot is None else closed - truth.pivot
        way = truth.axis if truth.pivot is None else np.cross(truth.axis, arm)
        way = way / np.linalg.norm(way)
    for _ in range(round(seconds / world.config.step_s)):
        if part is not None:
            p.applyExternalForce(
                world.object_id,
                world.part_joints[part],
                (PULL_N * way).tolist(),
                closed.tolist(),
                p.WORLD_FRAME,
                physicsClientId=world.client,
            )
        world.step()
