"""Explorations of several parts, on paper: opened, closed, modelled, and gone on from there."""

import re
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import pytest

from akm_fg.exploration.belief import BayesBelief
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.explore import Explorer, explore
from akm_fg.exploration.explore_json import exploration_as_dict, exploration_from_dict
from akm_fg.exploration.pages.page import exploration_part
from akm_fg.exploration.parts.closing import state_of_hand
from akm_fg.exploration.records import Contact, Exploration
from akm_fg.exploration.suppression import SuppressedMap
from akm_fg.model.records import ModelPart, ObjectModel, Surface
from tests.akm_fg.exploration.test_attempt import (
    CAMERA,
    NORMAL,
    PaperCabinet,
    PaperStream,
    Quiet,
    fit_of,
)


@dataclass
class Chest(PaperCabinet):
    """Drawers that can be pushed shut; those in `stuck` stay open the first so many times."""

    stuck: dict[int, int] = field(default_factory=dict)
    pushed: list[int] = field(default_factory=list)

    def follow(self, path, tick_s):
        way = path.T_world_gripper[-1].translation() - path.T_world_gripper[0].translation()
        if way @ NORMAL > 0.0:
            yield from super().follow(path, tick_s)
            return
        yield
        self.pushed.append(self.front)
        if self.stuck.get(self.front, 0) > 0:
            self.stuck[self.front] -= 1
            self.lost = True
            return
        self.state[self.front], self.hand = 0.0, self.hand + way


def surface(front: int) -> Surface:
    """Of a front about its contact, without the handle that stands 3 cm before it."""
    y, z = np.meshgrid(np.linspace(-0.1, 0.1, 21), np.linspace(-0.1, 0.1, 21))
    p = np.stack([np.full(y.shape, 0.63), 0.3 * front + y, 0.5 + z], axis=-1).reshape(-1, 3)
    return Surface(p, np.tile(NORMAL, (len(p), 1)), np.zeros((len(p), 3), np.uint8))


class PaperModels:
    """Knows a part's surface by its attempt, and where the parts are."""

    def __init__(self, chest, unmodelled=()):
        self.chest, self.unmodelled, self.kept, self.front_of = chest, unmodelled, [], {}

    def of(self, number, tried):
        front = tried.attempt.contact.front
        if front in self.unmodelled:
            return None
        posterior = fit_of(0.1, 5).posterior
        part = ModelPart("part-0", posterior, surface(front))
        rest = surface(9)
        self.front_of[f"part-{len(self.front_of)}"] = front
        return ObjectModel((part,), rest, CAMERA, gtsam.Pose3(), (f"attempt-{number}",))

    def states(self, model, frame):
        fronts = [self.front_of[part.name] for part in model.parts]
        return [self.chest.state.get(front, 0.0) for front in fronts]

    def keep(self, model):
        self.kept.append([part.name for part in model.parts])


def explored(chest, fronts=3, parts=0, so_far=None, models=None, **changes):
    config = replace(ExploreConfig(), parts=parts, **changes)
    models = models or PaperModels(chest)
    explorer = Explorer(
        contacts=lambda frame: [chest.contact(front) for front in range(fronts)],
        grasps=lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        stream=lambda number: PaperStream(chest),
        config=config,
        models=models,
    )
    exploration = so_far or Exploration()
    explore(chest, chest, explorer, exploration, Quiet())
    return exploration, models


def opened(exploration):
    return [a.contact.front for a in exploration.attempts if a.outcome == "opened"]


def test_all_that_opens_is_found_closed_again_and_kept_in_one_model():
    chest = Chest(free=(0, 2))
    exploration, models = explored(chest)
    assert opened(exploration) == [0, 2]
    assert chest.pushed == [0, 2] and max(chest.state.values()) == 0.0
    assert [part.name for part in exploration.model.parts] == ["part-0", "part-1"]
    assert models.kept == [["part-0"], ["part-0", "part-1"]]
    assert [part.explains for part in exploration.found] == [(0,), (2,)]
    assert [part.state for part in exploration.found] == [0.0, 0.0]
    assert exploration.failure is None and exploration.stop == "posterior"
    tried = [a.contact.front for a in exploration.attempts]
    assert tried.count(0) == tried.count(2) == 1  # what is explained is not tried again


def test_the_page_has_a_row_for_each_part():
    chest = Chest(free=(0, 2))
    exploration, _ = explored(chest, models=PaperModels(chest, unmodelled=(0,)))
    page = str(exploration_part(exploration, ExploreConfig()))
    rows = re.findall(r'<th scope="row">(part-0|no model)</th>\s*<td[^>]*>(\d+)</td>', page)
    assert rows == [("no model", "1"), ("part-0", "3")]


def test_as_many_parts_as_are_asked_for_are_enough():
    exploration, _ = explored(Chest(free=(0, 1, 2)), parts=2)
    assert opened(exploration) == [0, 1] and exploration.failure is None
    few, _ = explored(Chest(free=(1,)), parts=2)
    assert opened(few) == [1]
    assert few.failure.startswith("1 of 2 parts were opened, and nothing else opens")


def test_one_part_is_left_open_as_ever():
    chest = Chest(free=(0, 2))
    exploration, models = explored(chest, parts=1)
    assert opened(exploration) == [0] and not chest.pushed and not models.kept
    assert exploration.found == [] and exploration_as_dict(exploration)["parts"] == []


def test_a_part_that_does_not_close_is_taken_hold_of_again_and_then_left():
    chest = Chest(free=(0, 2), stuck={0: 1, 2: 5})
    exploration, _ = explored(chest)
    assert opened(exploration) == [0, 2]
    assert chest.pushed == [0, 0, 2, 2]
    assert [part.state == 0.0 for part in exploration.found] == [True, False]
    assert exploration.found[1].state == pytest.approx(chest.state[2])


def test_contacts_on_a_found_part_are_left_alone_and_others_are_not():
    """A handle before its own front is the part's; one as far from another's front is not."""
    chest = Chest(free=(0, 1))
    handle = chest.contact(0)

    def off(*by_m: float, front: int = 0) -> Contact:
        return replace(handle, p_world=handle.p_world + np.array(by_m), front=front)

    contacts = [handle, off(0, -0.05, 0), off(0.03, 0.08, 0, front=5), off(0, 0.08, 0, front=5)]
    models = PaperModels(chest)
    explorer = Explorer(
        lambda frame: contacts,
        lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        lambda number: PaperStream(chest),
        replace(ExploreConfig(), parts=0, max_attempts=1),
        models=models,
    )
    exploration = Exploration()
    explore(chest, chest, explorer, exploration, Quiet())
    assert exploration.found[0].explains == (0, 1, 2)


def test_a_part_that_is_opened_once_more_is_no_second_part():
    """A contact on the same front, beyond what was seen of its surface."""
    chest = Chest(free=(0,))
    handle = chest.contact(0)
    other = replace(handle, p_world=handle.p_world + np.array([0.0, 0.14, 0.14]), prior=0.4)
    models = PaperModels(chest)
    explorer = Explorer(
        lambda frame: [handle, other],
        lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        lambda number: PaperStream(chest),
        replace(ExploreConfig(), parts=0),
        models=models,
    )
    exploration = Exploration()
    explore(chest, chest, explorer, exploration, Quiet())
    assert opened(exploration) == [0, 0]
    assert [part.name for part in exploration.found] == ["part-0"]
    assert exploration.found[0].explains == (0, 1) and exploration.parts_opened == 1
    assert len(exploration.model.parts) == 1
    assert "attempt 2 opened part-0 once more" in exploration.notes


def test_what_has_moved_and_not_opened_is_pushed_back():
    chest = Chest(free=(0,), stop_m=0.04)
    exploration, _ = explored(chest, fronts=1, max_attempts=1)
    assert [a.outcome for a in exploration.attempts] == ["stopped"]
    assert chest.pushed == [0] and chest.state[0] == 0.0


def test_a_part_without_a_model_takes_its_front_with_it():
    chest = Chest(free=(0, 2))
    exploration, _ = explored(chest, models=PaperModels(chest, unmodelled=(0,)))
    assert opened(exploration) == [0, 2]
    assert [part.name for part in exploration.found] == [None, "part-0"]
    assert "no model of what attempt 1 opened" in exploration.notes


def test_what_was_found_comes_back_from_its_file_and_is_not_opened_again():
    chest = Chest(free=(0, 2))
    first, models = explored(chest, parts=1, max_attempts=1)
    first, models = explored(chest, parts=0, max_attempts=1)
    again = exploration_from_dict(exploration_as_dict(first), "explore.json")
    assert [vars_of(part) for part in again.found] == [vars_of(part) for part in first.found]
    again.model = first.model
    exploration, _ = explored(chest, so_far=again, models=models)
    assert opened(exploration) == [0, 2]
    assert [part.name for part in exploration.model.parts] == ["part-0", "part-1"]


def vars_of(part):
    return part.name, part.attempt, part.state, part.explains


@pytest.mark.parametrize("belief", ["bayes", "suppression"])
def test_what_is_left_alone_is_not_tried(belief: str):
    contacts = [Contact(np.zeros(3), np.array([f, 1.0]), NORMAL, f, 0.5) for f in range(3)]
    made = BayesBelief(contacts) if belief == "bayes" else SuppressedMap(contacts, 8)
    made.leave([0, 2])
    assert made.next().contact == 1
    np.testing.assert_array_equal(made.snapshot().by_contact > 0.0, [False, True, False])
    made.leave([1])
    assert made.next() is None


def test_the_hand_tells_how_far_a_part_stands_open():
    joint = fit_of(0.1, 5).posterior.best.joint
    grasp = gtsam.Pose3(gtsam.Rot3(), np.array([0.6, 0.0, 0.5]))
    hand = gtsam.Pose3(gtsam.Rot3(), grasp.translation() + 0.123 * NORMAL + [0.0, 0.01, 0.0])
    assert state_of_hand(joint, grasp, hand) == pytest.approx(0.123, abs=1e-3)
