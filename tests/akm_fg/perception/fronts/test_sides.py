"""How an outline is turned."""

import numpy as np
import pytest

from akm_fg.perception.fronts.sides import turn_of_sides


def outline(corners_m, turn_rad, noise_m=0.001):
    """Points every 2 mm along a closed polygon, turned."""
    corners = np.asarray(corners_m, dtype=float)
    points = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        steps = max(int(np.linalg.norm(b - a) / 0.002), 1)
        points.append(a + np.linspace(0.0, 1.0, steps, endpoint=False)[:, None] * (b - a))
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    noise = np.random.default_rng(3).normal(scale=noise_m, size=(sum(map(len, points)), 2))
    return np.concatenate(points) @ [[c, s], [-s, c]] + noise


RECTANGLE = [(0, 0), (0.4, 0), (0.4, 0.7), (0, 0.7)]
STEPS = [(0, 0), (0.3, 0), (0.3, 0.35), (0.34, 0.35)]
STEPS += [(0.34, 0.7), (0.04, 0.7), (0.04, 0.35), (0, 0.35)]


@pytest.mark.parametrize("turn_deg", [-44.0, -12.0, 0.0, 2.9, 30.0])
@pytest.mark.parametrize("shape", [RECTANGLE, STEPS], ids=["rectangle", "steps"])
def test_the_turn_is_found(shape, turn_deg):
    found = np.rad2deg(turn_of_sides(outline(shape, np.deg2rad(turn_deg))))
    off = (found - turn_deg + 45.0) % 90.0 - 45.0
    assert abs(off) < 0.5


def test_nothing_is_turned_by_nothing():
    assert turn_of_sides(np.zeros((0, 2))) == 0.0
