"""Fronts, gaps and handles of a chest of drawers in one noisy picture."""

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.perception.fronts.contacts import contact_candidates
from akm_fg.perception.fronts.find_fronts import find_fronts


@pytest.fixture(scope="module")
def chest(make_chest):
    return make_chest()


@pytest.fixture(scope="module")
def mask(chest):
    return DepthObjectSegmenter().segment(chest.frame())


@pytest.fixture(scope="module")
def found(chest, mask):
    return find_fronts(chest.frame(), mask)


def _facing_robot(found):
    return [f for f in found.fronts if f.normal_world @ [-1.0, 0.0, 0.0] > 0.98]


def test_every_drawer_is_a_front_of_its_own(found, chest):
    drawers = _facing_robot(found)
    assert len(drawers) == chest.rows
    for front, bar in zip(
        sorted(drawers, key=lambda f: f.middle_world[2]), chest.bars, strict=True
    ):
        assert abs(front.middle_world[0] - chest.front_x) < 0.005
        assert front.holds(front.frame.local(bar)[:2], 0.0)
        np.testing.assert_allclose(front.extent_m, [0.51, 0.234], atol=0.03)


def test_every_bar_is_found_on_its_own_drawer(found, chest):
    bars = found.protrusions
    assert len(bars) == chest.rows
    for bar in bars:
        off = np.linalg.norm(chest.bars - bar.p_world, axis=1)
        assert off.min() < 0.012
        front = found.fronts[bar.front]
        assert front.normal_world @ [-1.0, 0.0, 0.0] > 0.98
        assert front.holds(front.frame.local(chest.bars[off.argmin()])[:2], 0.0)
        assert abs(bar.axis_world @ [0.0, 1.0, 0.0]) > 0.98
        assert abs(bar.length_m - 0.14) < 0.02
        assert abs(bar.height_m - chest.reach_m - chest.bar_m / 2) < 0.008


def test_a_front_without_gaps_is_one(make_chest):
    chest = make_chest(rows=1, handles=False, contrast=40.0)
    frame = chest.frame(3)
    found = find_fronts(frame, DepthObjectSegmenter().segment(frame))
    assert len(_facing_robot(found)) == 1
    assert not found.protrusions


def test_handles_are_the_most_promising_contacts_and_lie_on_what_is_seen(chest, mask):
    frame = chest.frame()
    contacts = contact_candidates(frame, mask)
    assert 5 <= len(contacts) <= 60
    assert all(0.0 < c.prior < 1.0 for c in contacts)
    best = contacts[: chest.rows]
    assert {c.what for c in best} == {"protrusion"}
    assert len({c.front for c in best}) == chest.rows
    for contact in contacts:
        p_cam = frame.T_world_cam.transformTo(contact.p_world)
        assert np.linalg.norm(frame.camera.project(p_cam) - contact.uv) < 8.0


@pytest.mark.parametrize("blind", ["mask", "depth", "speck"])
def test_where_nothing_is_seen_nothing_is_found(chest, mask, blind):
    frame, chosen = chest.frame(), np.zeros_like(mask)
    if blind == "depth":
        frame, chosen = replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)), mask
    if blind == "speck":
        v, u = np.argwhere(mask)[len(np.argwhere(mask)) // 2]
        chosen[v : v + 3, u : u + 3] = True
    found = find_fronts(frame, chosen)
    assert found.fronts == () and found.protrusions == ()
    assert contact_candidates(frame, chosen) == ()


def test_a_mask_of_another_size_is_refused(chest):
    with pytest.raises(ValueError, match="mask"):
        find_fronts(chest.frame(), np.zeros((3, 3), dtype=bool))
