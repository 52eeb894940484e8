from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from akm_fg.arm.body.collision import ArmCollisions
from akm_fg.arm.motion.surroundings import KnownScene, Surroundings
from experiments.hands import approaches
from experiments.hands.approaches import ApproachRow, reason, report, run_trial
from sim.robot.franka import SimFranka


def test_one_approach_touches_nothing_but_with_its_fingers_at_the_handle():
    row = run_trial(0)
    assert row.infeasible is None and row.blocked is None
    assert row.touched == []
    assert row.closest_mm is not None and row.closest_mm > 5.0  # the palm, of the handle
    assert row.off_mm is not None and row.off_mm < 4.0
    assert row.limits_used is not None and row.limits_used["position_margin_rad"] > 0.0
    assert row.limits_used["velocity"] < 1.0


class Unchecked(ArmCollisions):
    """Says that nothing is ever touched."""

    def touched(self, q):
        return None

    def free_along(self, q, step_m):
        return True


class Careless(KnownScene):
    """Sees, and minds nothing."""

    def around(self, T_world_grasp, margin_m):
        return Surroundings(Unchecked([], margin_m), Unchecked([], margin_m), None)


class CarelessFranka(SimFranka):
    def __init__(self, world):
        super().__init__(world)
        self._scene = Careless(world.placement.floor_m)


@pytest.mark.slow
def test_the_same_approach_without_collision_checks_is_seen_to_touch():
    assert any(run_trial(trial, make_arm=CarelessFranka).touched for trial in range(16, 28))


def test_the_report_counts_touches_and_reasons():
    clear = ApproachRow(0, "a", None, [], None, 21.0, 0.5, None, 0.03, 0.2)
    hit = dataclasses.replace(clear, touched=["link 5 and the object"], closest_mm=-0.3)
    stuck = dataclasses.replace(
        clear, infeasible="the grasp at [1 2 3] m is out of the arm's reach"
    )
    text = report([clear, hit, stuck])
    assert "3 approaches, 2 executed" in text
    assert "at the handle: 1" in text
    assert "but for the fingers: -0.3 mm" in text
    assert "infeasible: out of the arm's reach: 1" in text
    assert "link 5 and the object" in text
    assert reason("no free way to the goal was found") == "no free way"


def test_a_run_goes_on_where_it_was_ended(tmp_path: Path):
    out, ran = tmp_path / "rows.jsonl", []

    def trial_without_arm(trial: int, seed: int) -> ApproachRow:
        ran.append(trial)
        return ApproachRow(trial, "a", None, [], None, 21.0, 0.5, None, 0.03, 0.2)

    assert approaches.main(["--trials", "2", "--out", str(out)], trial_without_arm) == 0
    assert approaches.main(["--trials", "4", "--out", str(out)], trial_without_arm) == 0
    assert ran == [0, 1, 2, 3]
    assert [row.trial for row in approaches.read_rows(out)] == ran


@pytest.mark.slow
def test_two_hundred_random_approaches_touch_nothing(capsys: pytest.CaptureFixture[str]):
    rows = [approaches.run_trial(trial, seed=1) for trial in range(200)]
    with capsys.disabled():
        print("\n" + report(rows))
    assert not [row for row in rows if row.touched]
    executed = [row for row in rows if row.infeasible is None]
    assert len(executed) >= 150
    assert all(row.blocked is None for row in executed)
