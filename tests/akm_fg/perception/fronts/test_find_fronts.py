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


def test_boards_that_stand_over_on_different_sides_do_not_make_the_fronts_lean(make_chest):
    chest = make_chest(rows=2, handles=False, step_m=0.05)
    frame = chest.frame(1)
    drawers = _facing_robot(find_fronts(frame, DepthObjectSegmenter().segment(frame)))
    assert len(drawers) == chest.rows
    for front in drawers:
        assert _leans_deg(front) < 1.0
        np.testing.assert_allclose(front.extent_m, [0.51, 0.354], atol=0.03)


def test_an_arm_before_two_corners_of_a_front_does_not_make_it_lean(make_chest):
    """What is left is longer across than along its sides."""
    chest = make_chest(rows=1, handles=False)
    frame = chest.frame(1)
    mask = DepthObjectSegmenter().segment(frame)
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
    p_cam = frame.camera.back_project(np.stack([u, v], axis=-1), frame.depth_m.astype(float))
    p = frame.T_world_cam.transformFrom(p_cam.reshape(-1, 3).T).T.reshape(p_cam.shape)
    across = p[..., 1] / (2.0 * chest.half_width_m) + 0.5 + p[..., 2] / chest.height_m
    corners = (np.abs(p[..., 0] - chest.front_x) < 0.03) & (np.abs(across - 1.0) > 0.5)
    seen = replace(frame, depth_m=np.where(corners, np.nan, frame.depth_m).astype(np.float32))
    (front,) = _facing_robot(find_fronts(seen, mask))
    assert _leans_deg(front) < 1.0


def _leans_deg(front):
    return abs(np.rad2deg(np.arcsin(front.frame.axes_world[2, 0])))


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


def test_a_long_bare_edge_may_be_held_all_along_as_boards_side_by_side_look_like_one(make_chest):
    chest = make_chest(rows=1, handles=False)
    frame = chest.frame()
    contacts = contact_candidates(frame, DepthObjectSegmenter().segment(frame))
    z = chest.height_m - 0.03
    upper = [c for c in contacts if c.what == "edge" and c.normal_world[0] < -0.9]
    upper = [c for c in upper if c.p_world[2] > z]
    assert np.ptp([c.p_world[1] for c in upper]) > 0.3 and len(upper) >= 3
    assert {round(c.serves, 6) for c in upper} == {0.56}


def test_edges_of_a_front_with_a_handle_are_held_in_their_middle_alone(chest, mask):
    contacts = contact_candidates(chest.frame(), mask)
    edges = [c for c in contacts if c.what == "edge" and c.normal_world[0] < -0.9]
    assert edges and {c.serves for c in edges} == {0.8}
    for front in {c.front for c in edges}:
        assert sum(c.front == front for c in edges) <= 4


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
