from dataclasses import replace

import numpy as np

from akm_fg.exploration.records import Bounds, Stretch
from akm_fg.exploration.stopping import StopConfig, by_threshold, enough, moved_enough
from akm_fg.records import PointTracks

RULES = StopConfig()


def known(axis_deg: float, pivot_m: float | None) -> Bounds:
    axis_rad = float(np.deg2rad(axis_deg))
    return Bounds(axis_rad, pivot_m, axis_rad / 2.4, None if pivot_m is None else pivot_m / 2.4)


def stretch(
    bounds: Bounds, then: Bounds | None, state: float = 0.3, sd: float = 0.002, p: float = 0.995
) -> Stretch:
    kinds = {"revolute": p, "prismatic": 1 - p}
    return Stretch(0.1, 20, "revolute", kinds, state, sd, bounds, then, 0.2)


def sliding(state: float) -> Stretch:
    kinds = {"rigid": 0.0, "prismatic": 0.995, "revolute": 0.005}
    return replace(stretch(GOOD, None, state=state), kind="prismatic", kind_probability=kinds)


GOOD, VAGUE, BETTER = known(0.8, 0.008), known(3.0, 0.02), known(1.5, 0.01)


def test_a_joint_that_the_task_can_use_ends_the_pull():
    assert enough([stretch(GOOD, None)], RULES) is not None
    assert enough([stretch(known(1.2, 0.008), known(0.5, 0.004))], RULES) is None
    assert enough([stretch(known(0.8, 0.012), known(0.4, 0.004))], RULES) is None


def test_a_kind_that_is_not_sure_goes_on():
    assert enough([stretch(GOOD, None, p=0.98)], RULES) is None


def test_what_has_surely_moved_five_degrees_or_centimetres_and_no_less_counts_as_opened():
    five = float(np.deg2rad(5.0))
    assert enough([stretch(GOOD, None, state=five + 0.01, sd=0.002)], RULES) is not None
    assert enough([stretch(GOOD, None, state=five + 0.01, sd=0.005)], RULES) is None
    assert enough([sliding(0.049)], RULES) is None
    assert enough([sliding(-0.06)], RULES) is not None


def test_an_angle_is_none_of_the_way_that_a_later_stretch_takes_it_for():
    """A hand that slides: first 4.4 deg of a door, then 2.4 cm of a drawer; 0.076 is no 7.6 cm."""
    turned = stretch(VAGUE, BETTER, state=0.076, sd=0.005)
    assert enough([turned, sliding(0.024)], RULES) is None
    assert turned.turns and not sliding(0.024).turns
    unknown = replace(turned, kind_probability={})
    assert not unknown.turns


def test_a_vague_joint_goes_on_while_a_further_stretch_is_expected_to_tell_more():
    assert enough([stretch(VAGUE, BETTER)], RULES) is None
    reason = enough([stretch(VAGUE, known(2.9, 0.0199))], RULES)
    assert reason == "a further stretch is not expected to tell more"


def test_two_stretches_that_brought_nothing_end_the_pull_whatever_is_expected():
    same = [stretch(VAGUE, BETTER) for _ in range(3)]
    assert enough(same, RULES) == "the last stretches have told no more"
    assert enough(same[:2], RULES) is None
    falling = [stretch(known(d, 0.03), BETTER) for d in (5.0, 4.0, 3.0)]
    assert enough(falling, RULES) is None


def test_the_papers_threshold_asks_for_half_the_pulled_way():
    rest = np.zeros((1, 3, 3))
    tracks = PointTracks(
        np.concatenate([rest, rest + np.array([0.0, 0.06, 0.0])]),
        np.tile(np.eye(3) * 1e-6, (2, 3, 1, 1)),
    )
    assert by_threshold(tracks, 0.10, RULES)
    assert not by_threshold(tracks, 0.13, RULES)


def test_a_part_that_was_far_and_is_no_longer_seen_was_opened_all_the_same():
    unseen = replace(stretch(GOOD, None), state=None, state_sd=None)
    assert enough([stretch(VAGUE, BETTER), unseen], RULES) is not None
    assert enough([unseen], RULES) is None


def test_what_only_the_hand_tells_is_not_called_opened():
    assert moved_enough(stretch(GOOD, None), RULES.need)
    assert not moved_enough(replace(stretch(GOOD, None), seen=False), RULES.need)
    assert enough([replace(stretch(GOOD, None), seen=False)], RULES) is None
