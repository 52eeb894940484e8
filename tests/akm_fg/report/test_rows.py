"""The table of a run, each figure worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.posterior import StatePosterior
from akm_fg.records import JointTruth, RoundSummary
from akm_fg.report.rows import score_rows
from akm_fg.report.summary import Goal


def _rows(summary):
    return {row.quantity: row for row in score_rows(summary)}


def _final(scenes, true=0.301, mean=0.307, sd=0.002):
    goal, rounds = Goal(0.30, 0.01, "m"), (RoundSummary(0.30, mean, sd, 0.9),)
    changes = {"goal": goal, "rounds": rounds, "final_state_true": true}
    return _rows(scenes.summary("prismatic", **changes))


def test_the_final_state_has_its_bound_and_the_error_of_the_belief(scenes):
    """Twice 0.98 sd of 2 mm are 3.9 mm; the belief is 6 mm too far, so outside."""
    row = _final(scenes)["final state (target 30 cm ± 1 cm)"]
    assert (row.estimate, row.bound, row.error) == ("30.70 cm", "0.39 cm", "+0.60 cm")
    assert row.good is False
    inside = _final(scenes, mean=0.3045)["final state (target 30 cm ± 1 cm)"]
    assert (inside.error, inside.good) == ("+0.35 cm", True)  # 1.75 sd


def test_the_end_is_told_by_the_parts_own_distance_from_the_target(scenes):
    short, far = (_final(scenes, true)["within tolerance"] for true in (0.296, 0.312))
    assert (short.error, short.good) == ("−0.40 cm from the target", True)
    assert (far.error, far.good) == ("+1.2 cm from the target", False)
    assert short.estimate == "probability 90.0 %"


@pytest.mark.parametrize(("error_m", "good"), [(0.0019, True), (-0.0019, True), (0.0021, False)])
def test_the_last_state_seen_has_its_bound(scenes, error_m, good):
    """A drawer at 20 cm that is not seen in the last of four frames; sd 1 mm, so 1.96 mm."""
    true = np.array([0.0, 0.1, 0.2, 0.3])
    mean = true + np.array([0.0, 0.0, error_m, np.nan])
    states = StatePosterior("m", mean, np.array([0.0, 0.001, 0.001, np.nan]))
    truth = JointTruth("prismatic", np.array([-1.0, 0.0, 0.0]), None, true)
    rows = _rows(scenes.summary("prismatic", states=states, truth=truth))
    row = rows["state, frame 2"]
    assert row.bound == "0.20 cm" and row.good is good
    assert row.error == f"{'+' if error_m > 0 else '−'}{100 * abs(error_m):.2f} cm"
    over = rows["state, all frames"]
    share = "100" if good else "50"  # frame 0 is zero by definition and does not count
    assert over.estimate == "3 of 4 frames seen"
    assert over.error.endswith(f"{share} % of frames inside")


def test_an_axis_and_a_pivot_outside_their_bounds_are_said_to_be(scenes):
    """The scene's hinge is off by 0.57 deg and 0.3 cm; the bounds follow from 0.01 rad, 4 mm."""
    rows = _rows(scenes.summary("revolute"))
    # Of two directions of equal sd, 95 % lie within sqrt(-2 ln 0.05) = 2.448 sd.
    assert rows["axis direction"].bound == "1.4°" and rows["axis direction"].good is True
    assert rows["pivot"].bound == "0.98 cm" and rows["pivot"].good is True
    joint = scenes.summary("revolute").posterior.best.joint
    sharp = replace(joint, cov=joint.cov / 100)
    posterior = scenes.summary("revolute").posterior
    best = replace(posterior.alternatives["revolute"], joint=sharp)
    wrong = replace(posterior, alternatives={**posterior.alternatives, "revolute": best})
    rows = _rows(scenes.summary("revolute", posterior=wrong))
    assert rows["axis direction"].good is False and rows["pivot"].good is False
