"""Grasps of bars and boards in one noisy picture."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("coal", reason="the arm's packages are not installed")

from akm_fg.grasping.antipodal import AntipodalSampler
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter

OUT = np.array([-1.0, 0.0, 0.0])  # of the chest's fronts


@pytest.fixture(scope="module")
def sampler():
    return AntipodalSampler()


@pytest.fixture(scope="module")
def chest(make_chest):
    return make_chest()


@pytest.fixture(scope="module")
def mask(chest):
    return DepthObjectSegmenter().segment(chest.frame())


def test_the_best_grasp_of_a_bar_is_across_it_in_its_middle(sampler, chest, mask):
    for bar in chest.bars:
        grasps = sampler.sample(chest.frame(), mask, bar + chest.bar_m / 2 * OUT, OUT)
        assert 2 <= len(grasps) <= 30
        qualities = [g.quality for g in grasps]
        assert qualities == sorted(qualities, reverse=True)
        R, p = grasps[0].T_world_grasp.rotation().matrix(), grasps[0].T_world_grasp.translation()
        assert abs(R[:, 1] @ [0.0, 0.0, 1.0]) > 0.9  # fingers open across the bar
        assert R[:, 2] @ OUT < -0.85  # towards the front
        assert np.linalg.norm((p - bar)[[0, 2]]) < 0.008
        assert abs(grasps[0].width_m - chest.bar_m) < 0.008


def test_both_ways_up_are_offered(sampler, chest, mask):
    grasps = sampler.sample(chest.frame(), mask, chest.bars[1] + chest.bar_m / 2 * OUT, OUT)
    first = grasps[0].T_world_grasp.rotation().matrix()
    assert any(g.T_world_grasp.rotation().matrix()[:, 1] @ first[:, 1] < -0.95 for g in grasps)


def test_no_two_grasps_are_the_same(sampler, chest, mask):
    grasps = sampler.sample(chest.frame(), mask, chest.bars[0] + chest.bar_m / 2 * OUT, OUT)
    for i, one in enumerate(grasps):
        for other in grasps[:i]:
            between = one.T_world_grasp.between(other.T_world_grasp)
            turn = np.linalg.norm(between.rotation().logmap(between.rotation().Identity()))
            assert np.linalg.norm(between.translation()) > 0.003 or turn > 0.15


def test_a_board_that_stands_over_is_pinched_at_its_edge(sampler, make_chest):
    chest = make_chest(rows=1, handles=False, over_m=0.06)
    mask = DepthObjectSegmenter().segment(chest.frame())
    edge = np.array([chest.front_x, chest.half_width_m + 0.06, 0.36])
    grasps = sampler.sample(chest.frame(), mask, edge - [0.0, 0.018, 0.0], OUT)
    assert grasps
    leans = []
    for grasp in grasps:
        R, p = grasp.T_world_grasp.rotation().matrix(), grasp.T_world_grasp.translation()
        assert abs(R[:, 1] @ OUT) > 0.8  # a finger on either side of the board, within friction
        assert R[1, 2] < -0.8  # comes from beside it
        leans.append(float(R[:, 2] @ OUT))  # against the way out of the front: from before it
        assert np.linalg.norm(p - edge - [0.01, -0.018, 0.0]) < 0.012
        assert grasp.quality < 0.6  # nobody has seen that there is room behind
    assert np.abs(leans).min() < 0.05  # straight along it, too
    assert min(leans) < -0.5 and max(leans) < 0.05  # never with the hand behind the front


def test_a_board_that_seems_to_end_in_a_shadow_is_pinched_at_its_edge_all_the_same(
    sampler, make_chest
):
    """The arm hides all of it but a strip as wide as a bar."""
    chest = make_chest(rows=1, handles=False, over_m=0.06)
    frame = chest.frame()
    mask = DepthObjectSegmenter().segment(frame)
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
    p_cam = frame.camera.back_project(np.stack([u, v], axis=-1), frame.depth_m.astype(float))
    y = frame.T_world_cam.transformFrom(p_cam.reshape(-1, 3).T)[1].reshape(mask.shape)
    end = chest.half_width_m + 0.06
    hidden = np.where((y > end - 0.15) & (y < end - 0.035), np.nan, frame.depth_m)
    seen = replace(frame, depth_m=hidden.astype(np.float32))
    contact = np.array([chest.front_x, end - 0.018, 0.36])
    as_bar = sampler.sample(seen, mask, contact, OUT)
    assert abs(as_bar[0].T_world_grasp.rotation().matrix()[:, 1] @ OUT) < 0.5
    for grasp in sampler.sample(seen, mask, contact, OUT, at_edge=True):
        assert abs(grasp.T_world_grasp.rotation().matrix()[:, 1] @ OUT) > 0.8


def test_the_middle_of_a_bare_front_offers_nothing(sampler, chest, mask):
    p_world = np.array([chest.front_x, 0.15, 0.36])
    assert sampler.sample(chest.frame(), mask, p_world, OUT) == ()


@pytest.mark.parametrize("place", [[0.62, 0.0, 5.0], [-3.0, 0.0, 0.5], [0.3, 0.0, 0.9]])
def test_a_contact_where_nothing_is_seen_offers_nothing(sampler, chest, mask, place):
    assert sampler.sample(chest.frame(), mask, np.array(place), OUT) == ()


def test_without_depth_nothing_is_offered(sampler, chest, mask):
    blind = replace(chest.frame(), depth_m=np.full_like(chest.frame().depth_m, np.nan))
    assert sampler.sample(blind, mask, chest.bars[0], OUT) == ()


def test_what_is_no_place_or_direction_is_refused(sampler, chest, mask):
    with pytest.raises(ValueError, match="contact"):
        sampler.sample(chest.frame(), mask, np.full(3, np.nan), OUT)
    with pytest.raises(ValueError, match="normal"):
        sampler.sample(chest.frame(), mask, chest.bars[0], np.zeros(3))
    with pytest.raises(ValueError, match="mask"):
        sampler.sample(chest.frame(), mask[:5], chest.bars[0], OUT)
