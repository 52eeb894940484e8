import numpy as np
import pytest

from akm_fg.exploration.belief import BayesBelief, BeliefConfig, ways_of
from akm_fg.exploration.records import Contact, Hypothesis
from akm_fg.exploration.suppression import SuppressedMap, SuppressionConfig

NORMAL = np.array([-1.0, 0.0, 0.0])


def contact(front: int, prior: float = 0.4, x_m: float = 0.0) -> Contact:
    uv = np.array([100.0 + 1000.0 * x_m, 50.0])
    return Contact(np.array([0.6, x_m, 0.5]), uv, NORMAL, front, prior)


def outward(place: int) -> Hypothesis:
    return Hypothesis(place, "outward", NORMAL)


def test_two_fronts_of_which_one_was_rigid_worked_by_hand():
    """p(free) = 0.5 each, one contact a front, all by one way, a grasp that always holds."""
    config = BeliefConfig(
        outward=1.0, sideways=0.0, upward=0.0, on_its_front=1.0, missed=0.1, holds=(1e9, 1e-9)
    )
    belief = BayesBelief([contact(0, 0.5), contact(1, 0.5)], config)
    belief.learn(outward(0), "rigid", False)
    # 0.5 * 0.1 / (0.5 * 0.1 + 0.5) = 1 / 11 that front 0 opens after all
    assert belief.front_opens(0)["outward"] == pytest.approx(1 / 11)
    assert belief.front_opens(1)["outward"] == pytest.approx(0.5)
    assert belief.anything() == pytest.approx(1 - (1 - 1 / 11) * 0.5)


def test_a_rigid_pull_speaks_of_the_whole_front_and_of_no_other():
    belief = BayesBelief([contact(0), contact(0, 0.39, 0.1), contact(1)])
    before = [belief.probability(outward(place)) for place in range(3)]
    belief.learn(outward(0), "rigid", False)
    after = [belief.probability(outward(place)) for place in range(3)]
    assert after[0] < 0.1 * before[0]
    assert after[1] < 0.3 * before[1]
    assert after[2] == before[2]


def test_a_lost_grasp_speaks_of_the_grasp_and_not_of_the_place():
    belief = BayesBelief([contact(0), contact(0, 0.39, 0.1)])
    opens, other = belief.front_opens(0), belief.probability(outward(1))
    own = belief.probability(outward(0))
    belief.learn(outward(0), "grasp_lost", False)
    assert belief.front_opens(0) == opens
    assert belief.probability(outward(1)) == other
    assert belief.probability(outward(0)) < own


def test_a_refused_contact_is_left_alone_and_its_front_is_not():
    belief = BayesBelief([contact(0, 0.5), contact(0, 0.4, 0.1)])
    belief.learn(outward(0), "refused", False)
    assert belief.probability(outward(0)) == 0.0
    assert belief.next() == Hypothesis(1, "outward", pytest.approx(NORMAL))


def test_what_was_seen_to_move_is_tried_again():
    belief = BayesBelief([contact(0), contact(1)])
    belief.learn(outward(0), "grasp_lost", True)
    assert belief.front_opens(0) == {"outward": 1.0, "left": 0.0, "right": 0.0, "upward": 0.0}
    assert belief.next() == Hypothesis(0, "outward", pytest.approx(NORMAL))


def test_when_all_is_rigid_the_search_ends_and_every_front_was_tried_outwards_first():
    contacts = [contact(front, 0.4, 0.1 * front) for front in range(4)]
    belief, tried = BayesBelief(contacts), []
    for _ in range(60):
        hypothesis = belief.next()
        if hypothesis is None:
            break
        tried.append((hypothesis.contact, hypothesis.way))
        belief.learn(hypothesis, "rigid", False)
    assert {place for place, way in tried[:4] if way == "outward"} == {0, 1, 2, 3}
    assert len(tried) < 25
    assert belief.anything() < BeliefConfig().nothing_left


def test_a_second_rigid_pull_at_one_place_hardly_speaks_of_the_front():
    """Whether a contact serves is the same in both: 1 - s + s e^2, by hand."""
    config = BeliefConfig(outward=1.0, sideways=0.0, upward=0.0, on_its_front=0.9, missed=0.1)
    belief = BayesBelief([contact(0, 0.5)], config)
    for _ in range(2):
        belief.learn(outward(0), "rigid", False)
    spared = 0.1 + 0.9 * 0.01
    assert belief.front_opens(0)["outward"] == pytest.approx(spared / (spared + 1.0))


def test_what_is_held_is_pulled_another_way_where_coming_back_is_likely():
    one = BayesBelief([contact(0, 0.95)])
    other = one.while_held([outward(0)])
    assert other is not None and other.contact == 0 and other.way != "outward"
    seven = BayesBelief([contact(front, 0.35, 0.1 * front) for front in range(7)])
    assert seven.while_held([outward(0)]) is None  # another front is likelier
    rigid = [Hypothesis(0, way, way_world) for way, way_world in ways_of(NORMAL).items()]
    assert one.while_held(rigid) is None
    assert one.front_opens(0) == BayesBelief([contact(0, 0.95)]).front_opens(
        0
    )  # asked, not learned


@pytest.mark.parametrize("fronts", [1, 2, 3, 5, 8])
def test_of_what_is_locked_each_front_is_held_little_more_than_once(fronts):
    prior = 1.0 - 0.05 ** (1.0 / fronts)
    belief = BayesBelief([contact(front, prior, 0.1 * front) for front in range(fronts)])
    holds = 0
    while (hypothesis := belief.next()) is not None:
        holds, rigid = holds + 1, [hypothesis]
        while (other := belief.while_held(rigid)) is not None:
            rigid.append(other)
        for pulled in rigid:
            belief.learn(pulled, "rigid", False)
    assert holds <= 1.6 * fronts + 1.0
    assert belief.anything() < BeliefConfig().nothing_left


def test_belief_is_right_as_often_as_it_says():
    """Drawn from its own model, calibration of the first answer of a belief with a rigid pull."""
    config, rng = BeliefConfig(holds=(1e9, 1e-9)), np.random.default_rng(3)
    said, was = [], []
    for _ in range(4000):
        prior = rng.uniform(0.1, 0.8)
        free = rng.random() < prior
        way = str(rng.choice(["outward", "left", "right", "upward"], p=[0.88, 0.04, 0.04, 0.04]))
        serves = rng.random() < config.on_its_front
        if free and way == "outward" and serves and rng.random() > config.missed:
            continue  # opened at once
        belief = BayesBelief([contact(0, prior)], config)
        belief.learn(outward(0), "rigid", False)
        said.append(sum(belief.front_opens(0).values()))
        was.append(free)
    said_a, was_a = np.array(said), np.array(was)
    for low, high in ((0.0, 0.1), (0.1, 0.2), (0.2, 0.5)):
        rows = (said_a >= low) & (said_a < high)
        spread = 3.0 * np.sqrt(said_a[rows].mean() * (1 - said_a[rows].mean()) / rows.sum())
        assert abs(said_a[rows].mean() - was_a[rows].mean()) < spread


@pytest.mark.parametrize("normal", [NORMAL, np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.8, 0.0])])
def test_ways_to_pull_are_unit_and_level_where_they_should_be(normal):
    ways = ways_of(normal)
    for direction in ways.values():
        assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert ways["left"][2] == pytest.approx(0.0)
    np.testing.assert_allclose(ways["left"], -ways["right"])
    assert ways["left"] @ normal == pytest.approx(0.0, abs=1e-12)


def test_suppression_subtracts_the_papers_gaussian():
    contacts = [contact(0, 0.9), contact(1, 0.8, 0.032), contact(2, 0.7, 0.4)]
    belief = SuppressedMap(contacts, width_px=640, config=SuppressionConfig(0.5, 0.05))
    first = belief.next()
    assert first is not None and first.contact == 0
    belief.learn(first, "grasp_lost", False)
    # sigma is 32 px: 0.9 - 0.5, 0.8 - 0.5 exp(-1/2), 0.7 - 0
    np.testing.assert_allclose(
        belief.snapshot().by_contact, [0.4, 0.8 - 0.5 * np.exp(-0.5), 0.7], atol=1e-6
    )


def test_without_suppression_nothing_is_learned_and_places_are_drawn_by_score():
    contacts = [contact(0, 0.75), contact(1, 0.25, 0.3)]
    belief = SuppressedMap(contacts, 640, rng=np.random.default_rng(0))
    drawn = []
    for _ in range(400):
        hypothesis = belief.next()
        assert hypothesis is not None
        belief.learn(hypothesis, "rigid", False)
        drawn.append(hypothesis.contact)
    assert np.mean(np.array(drawn) == 0) == pytest.approx(0.75, abs=0.07)


@pytest.mark.parametrize("rng", [None, np.random.default_rng(0)])
def test_a_map_whose_places_the_planner_all_refused_has_no_next_one(rng):
    """A refusal costs no pull: the search went on for ever."""
    belief = SuppressedMap([contact(0), contact(1, x_m=0.3)], width_px=640, rng=rng)
    for place in (0, 1, 0):
        assert belief.next() is not None
        belief.learn(outward(place), "refused", moved=False)
        if place == 1:
            belief.learn(outward(0), "rigid", moved=False)  # it could be reached again
    assert belief.next() is None
    belief.learn(outward(1), "rigid", moved=False)
    assert belief.next() is not None


def test_a_place_that_was_missed_a_few_times_in_a_row_is_left_alone():
    belief = BayesBelief([contact(0), contact(1, 0.2)])
    most = BeliefConfig().most_missed
    for _ in range(most - 1):
        belief.learn(outward(0), "grasp_lost", moved=False, held=False)
    assert belief.probability(outward(0)) > 0
    belief.learn(outward(0), "grasp_lost", moved=False, held=True)  # it was held after all
    for _ in range(most):
        assert belief.probability(outward(0)) > 0
        belief.learn(outward(0), "grasp_lost", moved=False, held=False)
    assert belief.probability(outward(0)) == 0
    assert belief.probability(outward(1)) > 0
    belief.noticed(0, "left")
    assert belief.probability(Hypothesis(0, "left", NORMAL)) > 0
    assert belief.probability(outward(0)) == 0, "it opens another way"
