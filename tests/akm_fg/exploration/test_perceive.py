from dataclasses import replace

import numpy as np
import pytest

from akm_fg.exploration.belief import BayesBelief
from akm_fg.exploration.perceive import apart, rigid_groups, with_priors
from akm_fg.perception.fronts.front_records import ContactCandidate

NORMAL = np.array([-1.0, 0.0, 0.0])


def candidate(front, y_m, prior=0.8, thing=None):
    what = "edge" if thing is None else "protrusion"
    p = np.array([0.6, y_m, 0.5])
    return ContactCandidate(p, np.array([100 * y_m, 9.0]), front, NORMAL, prior, what, thing)


def test_a_handle_shares_its_fronts_fate_with_the_fronts_edges():
    groups = rigid_groups(
        [candidate(3, 0.0, thing=0), candidate(3, 0.1, thing=0), candidate(3, 0.3)]
    )
    assert groups.tolist() == [3, 3, 3]


def test_handles_on_what_looks_like_one_front_are_each_others_rivals():
    seen = [
        candidate(0, 0.0, thing=0),
        candidate(0, 0.05, thing=0),
        candidate(0, 0.4, thing=1),
        candidate(0, 0.2),
        candidate(1, 0.8, thing=2),
    ]
    groups = rigid_groups(seen)
    assert groups[0] == groups[1] != groups[2]
    assert groups[3] == 0 and groups[4] == 1
    assert len(set(groups.tolist())) == 4


@pytest.mark.parametrize("fronts", [1, 2, 6])
def test_something_opens_with_the_probability_that_is_believed_beforehand(fronts):
    seen = [candidate(f, 0.3 * f, thing=f) for f in range(fronts)]
    contacts = with_priors(seen, np.linspace(0.5, 1.0, fronts), 0.97)
    closed = np.prod([1.0 - contact.prior for contact in contacts])
    assert closed == pytest.approx(0.03, rel=1e-6)


def test_no_prior_is_certain_and_none_is_more_than_its_rivals_by_more_than_their_weights():
    contacts = with_priors([candidate(0, 0.0), candidate(1, 0.3)], np.array([1.0, 0.1]), 0.999)
    assert max(contact.prior for contact in contacts) <= 0.98
    assert contacts[0].prior > contacts[1].prior


def test_after_a_rigid_pull_the_other_handle_of_a_merged_front_is_as_likely_as_before():
    seen = [candidate(0, 0.0, thing=0), candidate(0, 0.4, thing=1)]
    belief = BayesBelief(with_priors(seen, np.ones(2), 0.97))
    first = belief.next()
    before = belief.front_opens(belief._contacts[1 - first.contact].front)["outward"]
    belief.learn(first, "rigid", False, True)
    then = belief.next()
    assert then.contact == 1 - first.contact
    assert belief.front_opens(belief._contacts[then.contact].front)["outward"] == before


def test_after_a_rigid_pull_another_place_of_a_long_edge_is_tried_before_anything_less_likely():
    seen = [replace(candidate(0, 0.3 * i, 0.4), serves=0.56) for i in range(3)]
    seen.append(candidate(1, 1.5, 0.02))
    belief = BayesBelief(with_priors(seen, np.array([c.prior for c in seen]), 0.95))
    tried = []
    for _ in range(3):
        then = belief.next()
        tried.append(then.contact)
        belief.learn(then, "rigid", False, True)
    assert sorted(tried) == [0, 1, 2]


def test_places_nearer_than_a_finger_are_one():
    seen = [candidate(0, 0.0, 0.9), candidate(0, 0.01, 0.8), candidate(0, 0.05, 0.7)]
    assert [c.prior for c in apart(seen, 0.02)] == [0.9, 0.7]
