"""Where the paper puts objects: inside its ranges, without regard to joint or arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.arm.body.kinematics import FrankaKinematics
from sim.objects.part_spec import BuiltObject
from sim.objects.published_place import PublishedPlaceConfig, place_as_published
from sim.objects.staging import find_spec, stage


def built_with(seed: int, size_m: tuple[float, float, float] = (0.5, 0.4, 0.6)) -> BuiltObject:
    """An object of which nothing is known but its name, seed and size."""
    spec = replace(find_spec("door", seed), size_m=np.array(size_m))
    nothing = np.full(3, np.nan)
    return BuiltObject(spec, Path(), nothing, nothing, None, nothing, 0.0)  # type: ignore[arg-type]


def test_over_many_seeds_the_place_fills_the_papers_ranges_and_never_leaves_them():
    fronts, yaws, rolls, heights = [], [], [], []
    for seed in range(300):
        T = place_as_published(built_with(seed)).T_world_object
        corners = np.array([[x, y, 0.0] for x in (-0.25, 0.25) for y in (-0.2, 0.2)])
        front = T.transformFrom(np.array([0.0, -0.2, 0.0]))
        assert abs(front[1]) < 1e-9  # straight before the base
        out = -T.rotation().matrix()[:, 1]
        assert out[2] == pytest.approx(0.0, abs=1e-9)  # rolled, not pitched
        fronts.append(front[0])
        yaws.append(np.arctan2(out[1], -out[0]))
        rolls.append(np.arcsin(T.rotation().matrix()[2, 0]))
        heights.append(min(T.transformFrom(corner)[2] for corner in corners))
    c = PublishedPlaceConfig()
    ranges = (c.front_x_m, c.yaw_rad, c.roll_rad, c.above_m)
    for values, (low, high) in zip((fronts, yaws, rolls, heights), ranges, strict=True):
        assert low - 1e-9 < min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) < high + 1e-9


def test_the_same_object_stands_in_the_same_place_and_no_grasp_is_given():
    first, again, other = (place_as_published(built_with(seed)) for seed in (3, 3, 4))
    assert first.T_world_object.equals(again.T_world_object, 0.0)
    assert not first.T_world_object.equals(other.T_world_object, 1e-3)
    with pytest.raises(ValueError, match="no grasp is given"):
        first.given_grasp()


def test_an_unknown_placement_is_refused():
    with pytest.raises(ValueError, match="'reachable', 'published'"):
        stage(find_spec("door", 0), FrankaKinematics(), "somewhere")  # type: ignore[arg-type]


def test_the_cache_keeps_both_placements_apart():
    spec, kinematics = find_spec("drawer", 0), FrankaKinematics()
    for _ in range(2):
        _, published = stage(spec, kinematics, "published")
        _, reachable = stage(spec, kinematics)
        assert published.T_world_grasp is None and reachable.T_world_grasp is not None
