from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.kinematics import FrankaKinematics
from experiments.hands.published_reach import ReachRow, failures, read_rows, run_trial, table
from experiments.rows.json_lines import append_line
from experiments.trials.oracle_grasps import enough, followable_grasps
from sim.objects.placement import Placement
from sim.objects.published_place import place_as_published
from sim.objects.suites.catalogue import load_spec
from sim.objects.suites.furniture_build import measure_furniture

NEAR = ReachRow("furniture-dev/door-001", 0, "revolute", "cabinet", "rod", 5, 2, True, None, None)
FAR = ReachRow("furniture-dev/door-002", 0, "revolute", "fridge", "bar", 3, 0, False, None, "far")


def test_a_drawer_before_the_arm_is_within_reach_and_a_metre_farther_it_is_not():
    row = run_trial("furniture-dev/drawer-001")
    assert row.grasps > 0 and row.opened is None and row.reason is None
    spec, kinematics = load_spec("furniture-dev/drawer-001", 0), FrankaKinematics()
    built = measure_furniture(spec)
    placement = place_as_published(built)
    into = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 0.0]))
    away = Placement(placement.T_world_object * into, None)
    assert followable_grasps(built, spec, away, kinematics, 0.06) == []


def test_the_table_counts_what_is_out_of_reach_and_names_it(tmp_path: Path):
    file = tmp_path / "rows.jsonl"
    for row in (NEAR, FAR):
        append_line(file, json.dumps(asdict(row)))
    rows = read_rows(file)
    assert rows == [NEAR, FAR]
    assert "50.0" in table(rows) and "2.50" in table(rows)  # tries: (5 + 1) / 2 and (3 + 1) / 2
    assert "door-002" in failures(rows) and "door-001" not in failures(rows)


def test_enough_is_in_metres_or_radians():
    assert enough("prismatic", 5.0) == pytest.approx(0.05)
    assert enough("revolute", 5.0) == pytest.approx(np.deg2rad(5.0))


@pytest.mark.slow
def test_the_simulated_arm_opens_what_is_within_reach():
    assert run_trial("furniture-dev/drawer-001", simulate=True).opened
