import numpy as np
import pytest

from akm_fg.records import PixelTracks
from akm_fg.report.summary import Goal, PartTracks


def test_a_track_cannot_both_move_and_rest():
    pixels = PixelTracks(np.zeros((1, 2, 2)), np.ones((1, 2), bool), np.ones((1, 2, 2, 2)))
    with pytest.raises(ValueError, match="both moving and static"):
        PartTracks(pixels, np.array([True, False]), np.array([True, True]))
    with pytest.raises(ValueError, match="moving"):
        PartTracks(pixels, np.array([True]), np.array([True, True]))


@pytest.mark.parametrize(("target", "tolerance"), [(np.nan, 0.01), (0.3, 0.0)])
def test_a_goal_is_finite_and_can_be_met(target, tolerance):
    with pytest.raises(ValueError, match=r"target|tolerance"):
        Goal(target, tolerance, "m")


def test_the_closed_loop_begins_inside_the_recording(scenes):
    with pytest.raises(ValueError, match="closed_loop_frame 12"):
        scenes.summary("revolute", closed_loop_frame=12)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "reached"),
        ({"failure": "lost"}, "not reached"),
        ({"final_state_true": None}, "reached"),
        ({"final_state_true": 0.0}, "not reached"),
        ({"rounds": ()}, "not reached"),
        ({"goal": None}, "modelled"),
        ({"goal": None, "posterior": None}, "failed"),
    ],
)
def test_the_verdict(scenes, changes, verdict):
    assert scenes.summary("revolute", **changes).verdict == verdict


def test_an_undecided_or_wrong_model_is_not_a_found_joint(scenes):
    undecided = scenes.posterior("prismatic", "undecided")
    assert scenes.summary("prismatic", goal=None, posterior=undecided).verdict == "undecided"
    wrong = scenes.posterior("prismatic")
    assert scenes.summary("revolute", goal=None, posterior=wrong).verdict == "wrong"
