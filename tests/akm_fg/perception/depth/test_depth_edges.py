"""Depth edges: steps, however slanted the surfaces beside them."""

import numpy as np
import pytest

from akm_fg.perception.depth.depth_edges import near_depth_edge

STEP_M = 0.02


def slanted(tangent: float, step_m: float = 0.0) -> np.ndarray:
    """Depth (60, 80) of a plane at 1 m, 300 px focal length, with a step at column 40."""
    u = np.arange(80) - 40
    depth = 1 / (1 - tangent * u / 300)
    return np.tile(depth + np.where(u >= 0, step_m, 0.0), (60, 1)).astype(np.float32)


@pytest.mark.parametrize("tangent", [0.0, 1.0, 3.0])
def test_a_plane_has_no_edge_and_a_step_has_one(tangent: float) -> None:
    assert not near_depth_edge(slanted(tangent), STEP_M, 0).any()
    edge = near_depth_edge(slanted(tangent, 0.06), STEP_M, 0, reach_px=1)
    assert edge[:, 39:41].all()
    assert not edge[:, :39].any() and not edge[:, 41:].any()


def test_the_margin_widens_it() -> None:
    edge = near_depth_edge(slanted(0.5, 0.06), STEP_M, 3, reach_px=1)
    np.testing.assert_array_equal(np.flatnonzero(edge[30]), np.arange(36, 44))


def test_an_edge_is_found_past_a_lost_pixel() -> None:
    depth = slanted(0.5, 0.06)
    depth[:, 40] = np.nan
    assert near_depth_edge(depth, STEP_M, 0).any(axis=1).all()


def test_holes_are_no_edges() -> None:
    depth = slanted(0.5)
    depth[20:30, 20:30] = np.nan
    assert not near_depth_edge(depth, STEP_M, 2).any()
