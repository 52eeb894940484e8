from __future__ import annotations

import dataclasses

import pytest

from experiments import approaches
from experiments.approaches import ApproachRow, reason, report, run_trial
from sim.collision import ArmCollisions


def test_one_approach_touches_nothing_but_with_its_fingers_at_the_handle():
    row = run_trial(0)
    assert row.infeasible is None and row.blocked is None
    assert row.touched == []
    assert row.off_mm is not None and row.off_mm < 4.0
    assert row.limits_used is not None and row.limits_used["position_margin_rad"] > 0.0
    assert row.limits_used["velocity"] < 1.0


@pytest.mark.slow
def test_the_same_approach_without_collision_checks_is_seen_to_touch(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(ArmCollisions, "touched", lambda self, q: None)
    monkeypatch.setattr(ArmCollisions, "free_along", lambda self, q, step_m: True)
    assert run_trial(0).touched


def test_the_report_counts_touches_and_reasons():
    clear = ApproachRow(0, "a", None, [], None, 0.5, None, 0.03, 0.2)
    hit = dataclasses.replace(clear, touched=["link 5 and the object"])
    stuck = dataclasses.replace(
        clear, infeasible="the grasp at [1 2 3] m is out of the arm's reach"
    )
    text = report([clear, hit, stuck])
    assert "3 approaches, 2 executed" in text
    assert "at the handle: 1" in text
    assert "infeasible: out of the arm's reach: 1" in text
    assert "link 5 and the object" in text
    assert reason("no free way to the goal was found") == "no free way"


@pytest.mark.slow
def test_two_hundred_random_approaches_touch_nothing(capsys: pytest.CaptureFixture[str]):
    rows = [approaches.run_trial(trial, seed=1) for trial in range(200)]
    with capsys.disabled():
        print("\n" + report(rows))
    assert not [row for row in rows if row.touched]
    executed = [row for row in rows if row.infeasible is None]
    assert len(executed) >= 150
    assert all(row.blocked is None for row in executed)
