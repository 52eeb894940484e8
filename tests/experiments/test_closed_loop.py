"""The paper's tasks, and what is counted of them."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import closed_loop, relocalization
from experiments.closed_loop import BIN, ClosedLoopRow, tasks_of
from experiments.relocalization import RelocalizationRow

ROW = ClosedLoopRow(
    name="furniture-dev/drawer-001", method="covariance", seed=1, task=0, kind_true="prismatic",
    start=0.05, target=0.25, explored=True, kind="prismatic", claimed=True, probability=0.97,
    final=0.251, tolerance=0.005, rounds=2, looks=1, regrasps=0, after_round=[0.2, 0.251],
    found=0.001, found_sd=0.001, nees=1.0, learned=None, pressed_n=0.0, limit_shares={"jerk": 0.5},
    cpu_s=10.0, failure=None,
)  # fmt: skip


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_tasks_go_between_bins_by_ten_twenty_or_thirty(kind):
    tasks = tasks_of("furniture-dev/door-001", kind, 3, 12)
    ways = np.array([(task.target - task.start) / BIN[kind] for task in tasks])
    assert np.abs(ways) == pytest.approx(np.abs(ways).round())
    assert sorted(np.abs(ways).round()) == [1] * 6 + [2] * 4 + [3] * 2
    assert (ways > 0).sum() == 6  # half of them close
    assert all(0.0 <= each <= 4 * BIN[kind] for task in tasks for each in (task.start, task.target))
    assert tasks == tasks_of("furniture-dev/door-001", kind, 3, 12)
    assert tasks != tasks_of("furniture-dev/door-002", kind, 3, 12)


def test_a_task_that_never_began_has_gone_nowhere():
    assert ROW.off == pytest.approx(0.005)
    assert ROW.within
    failed = replace(ROW, final=None, claimed=False, probability=0.0, explored=False)
    assert failed.off == 1.0
    assert not failed.within


def test_tables_say_what_the_rows_do():
    failed = replace(ROW, task=1, final=None, claimed=False, probability=0.0, after_round=[],
                     explored=False, failure="exploration made no model")  # fmt: skip
    lines = closed_loop.table([ROW, failed]).splitlines()
    assert lines[2].startswith("| covariance | prismatic | 2 | 50.0 ")
    rounds = closed_loop.by_rounds([ROW, failed]).splitlines()[-1]
    assert rounds == "| covariance | 0 | 50 | 50 | 50 | 50 |"
    assert "| 0.95 to 0.99 | 1 | 0.970 | 100.0" in closed_loop.reliability([ROW])
    assert "exploration made no model" in closed_loop.failures([ROW, failed])
    wrong = replace(ROW, final=0.27)
    assert "claimed" in closed_loop.failures([wrong])


def test_relocalization_counts_hypotheses_errors_and_times():
    row = RelocalizationRow("x", 1, 0, False, 0.2, "tracking", 0.201, 0.001, 0.1, 0.01, 0.2, 0.001,
                            0.23, 4.0)  # fmt: skip
    line = relocalization.table([row, replace(row, found=None, sd=None)]).splitlines()[-1]
    assert line.startswith("| slides, mm | 2 | 50.0")
    assert line.endswith("| 40 | 400 |")
