"""Claimed and observed shares of grasps that hold, and grasps of rendered furniture."""

import numpy as np
import pytest

from experiments.hands.grasp_quality import (
    SUITE,
    GraspRow,
    look_with_the_arm_aside,
    proposals_at_the_handle,
    report,
    run_object,
)
from sim.episode import open_world

ACROSS_M = 0.010  # of the handle's middle, across the bar and along the approach
ALONG_M = 0.06  # anywhere on the bar
TURNED_RAD = 0.3


def _row(quality: float, holds: bool | None) -> GraspRow:
    return GraspRow("drawer-001", 0, "bar", "protrusion", 0, quality, [quality] * 8, holds, "", 1.0)


def test_the_report_compares_claims_with_what_held_and_leaves_out_what_was_not_tried():
    rows = [_row(0.6, True), _row(0.6, True), _row(0.6, False), _row(0.9, True), _row(0.2, None)]
    text = report(rows)
    assert "5 rows, 4 grasps tried, 0.75 held" in text
    assert "0.50..0.70:    3 grasps  claimed 0.60  held 0.67" in text
    assert "fitted" in text
    assert report([_row(0.2, None)]) == "no grasp was tried"


@pytest.mark.slow
def test_a_grasp_of_the_smallest_configuration_is_tried():
    rows = run_object("drawer-002", seed=0, grasps=1)
    assert rows[-1].holds is not None
    assert len(rows[-1].features) == 8


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "door-002", "door-005", "door-006", "door-009", "door-013",
        "drawer-001", "drawer-005", "drawer-006", "drawer-008", "drawer-013",
    ],
)  # fmt: skip
def test_a_grasp_near_the_true_one_is_found_from_the_fixed_camera(name):
    with open_world(f"{SUITE}/{name}", 0, "d455", placement="published") as episode:
        found = proposals_at_the_handle(episode, look_with_the_arm_aside(episode))
        world = episode.world
        true = (world.placement.T_world_object * world.built.T_object_handle).matrix()
    assert found is not None and found[0] == "protrusion"
    assert any(_near(grasp.T, true) for grasp in found[1])


def _near(T: np.ndarray, true: np.ndarray) -> bool:
    off = true[:3, :3].T @ (T[:3, 3] - true[:3, 3])
    if abs(off[0]) > ALONG_M or max(abs(off[1]), abs(off[2])) > ACROSS_M:
        return False
    flips = (np.eye(3), np.diag([-1.0, -1.0, 1.0]))
    turns = [np.trace(true[:3, :3].T @ T[:3, :3] @ flip) for flip in flips]
    return bool(np.arccos(np.clip((max(turns) - 1) / 2, -1, 1)) < TURNED_RAD)
