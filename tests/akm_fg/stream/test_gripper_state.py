"""States of hidden frames by the hand that holds the part."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from akm_fg.estimation.config import GraspConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.records import PointTracks
from akm_fg.stream.gripper_state import with_gripper_states
from experiments.trials.openings import make_opening

GRASP = GraspConfig()
HIDDEN = range(12, 20)


def _hidden_from(kind):
    """An opening whose points are seen in its first twelve frames, and a hand that holds it."""
    truth = make_opening(3, kind, frames=20, noise_m=0.001, claimed_m=0.001, steady=True)
    p = truth.tracks.p_world.copy()
    p[list(HIDDEN)] = np.nan
    posterior = fit_tracks(PointTracks(p, truth.tracks.cov_world))
    assert np.isnan(posterior.best.states.mean[list(HIDDEN)]).all()
    rng = np.random.default_rng(1)
    R, t = truth.joint.motion(truth.q)
    hand = R @ truth.rest_world.max(axis=0) + t + 0.001 * rng.normal(size=(20, 3))
    return truth, posterior, dict(enumerate(hand))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_hand_tells_the_states_of_frames_in_which_the_part_is_hidden(kind):
    truth, posterior, hands = _hidden_from(kind)
    found = with_gripper_states(posterior, hands, GRASP)
    states, before = found.best.states, posterior.best.states
    off = states.mean - truth.q
    assert (np.abs(off) < 3 * states.sd + 1e-6).all()
    assert (states.sd[list(HIDDEN)] > 0).all()
    seen = np.isfinite(before.mean)
    assert_array_equal(states.mean[seen], before.mean[seen])
    metres = 1.0 if kind == "prismatic" else 0.2
    assert np.abs(off[list(HIDDEN)]).max() < 0.006 / metres


def test_what_the_hand_tells_is_no_surer_than_its_own_noise():
    _, posterior, hands = _hidden_from("prismatic")
    found = with_gripper_states(posterior, hands, GRASP)
    assert (found.best.states.sd[list(HIDDEN)] >= GRASP.sigma_trans_m).all()


def test_a_hand_that_has_left_the_parts_way_tells_nothing():
    _, posterior, hands = _hidden_from("revolute")
    for k in (15, 16):
        hands[k] = hands[k] + np.array([0.0, 0.0, 0.06]) @ _upright(posterior)
    found = with_gripper_states(posterior, hands, GRASP).best.states.mean
    assert np.flatnonzero(np.isnan(found)).tolist() == [15, 16]


def _upright(posterior):
    """Rows that take a joint's own axes to the world's."""
    return posterior.best.joint.T_world_joint[:3, :3].T


@pytest.mark.parametrize("held", [range(0), range(2), range(12, 20)])
def test_without_frames_that_say_where_the_hand_sits_nothing_is_told(held):
    _, posterior, hands = _hidden_from("revolute")
    some = {k: hands[k] for k in held}
    assert_allclose(
        with_gripper_states(posterior, some, GRASP).best.states.mean, posterior.best.states.mean
    )
