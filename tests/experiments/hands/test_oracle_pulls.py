from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.arm.body.limits import LimitUsage
from experiments.hands.oracle_pulls import (
    PullRow,
    append_row,
    failures,
    read_rows,
    run_trial,
    table,
)

USED = LimitUsage(0.2, 0.1, 0.4, 1.2, 0.3, 0.4)
OPENED = PullRow(
    name="furniture-dev/door-001",
    way="arc",
    kind="revolute",
    hinge="left",
    handle="arch",
    state=0.36,
    opened=True,
    reason=None,
    slip_m=0.002,
    slip_rad=0.03,
    touched=(),
    usage=USED,
    usage_filtered=replace(USED, jerk=0.5),
    cpu_s=7.0,
)
FAILED = replace(
    OPENED,
    name="furniture-dev/door-002",
    state=np.deg2rad(11.0),
    opened=False,
    reason="motion: a pose of the path is out of the arm's reach",
    touched=("panda_link5",),
)


def test_rows_come_back_as_written_and_an_unfinished_line_is_left_out(tmp_path):
    file = tmp_path / "rows.jsonl"
    append_row(file, OPENED)
    with file.open("a") as stream:
        stream.write('{"name": "furn')
    append_row(file, FAILED)
    assert read_rows(file) == [OPENED, FAILED]
    assert read_rows(tmp_path / "none.jsonl") == []


def test_the_tables_count_what_opened_and_name_the_rest():
    text = table([OPENED, FAILED])
    assert "1 of 2" in text and "50.0 (" in text and "1.20 / 0.50" in text
    rest = failures([OPENED, FAILED])
    assert "door-001" not in rest
    assert "door-002 | arc | arch | 11.0 deg | motion: a pose" in rest and "panda_link5" in rest


@pytest.mark.slow
@pytest.mark.parametrize("way", ["arc", "pull"])
def test_a_drawer_is_opened_by_ten_centimetres(way):
    row = run_trial("furniture-dev/drawer-001", way)
    assert row.opened and row.reason is None and 0.10 <= row.state < 0.13
    assert row.slip_m is not None and row.slip_m < 0.01
    assert row.usage_filtered is not None and row.usage_filtered.within


@pytest.mark.slow
def test_what_cannot_be_reached_is_a_row_with_a_reason():
    from sim.robot.franka_config import FrankaConfig
    from sim.robot.gripper import GripperConfig

    empty = FrankaConfig(gripper=GripperConfig(nothing_m=0.1))  # whatever it holds counts as none
    row = run_trial("furniture-dev/drawer-001", "arc", franka=empty)
    assert not row.opened and row.reason is not None
    assert row.reason.startswith("grasp: ") and row.slip_m is None
