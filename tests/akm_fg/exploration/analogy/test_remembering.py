"""The memory of contacts grows by what an exploration opened."""

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.exploration.analogy.contacts import ContactMemory
from akm_fg.exploration.analogy.remembering import opened_at, remember
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.perceive import Analogy, Perceiver
from tests.akm_fg.exploration.analogy.conftest import ColourFeatures, front, kept
from tests.akm_fg.exploration.test_attempt import NORMAL, PaperCabinet, explored


@pytest.fixture
def memory():
    return ContactMemory(ColourFeatures.made_by, (kept(front((50, 40))), kept(front((70, 60)))))


class Everything:
    def segment(self, frame):
        return np.isfinite(frame.depth_m)


def seen_exploration(cabinet=None):
    """A paper exploration, as if its first look had shown the front of the memory's tests."""
    seen = front((40, 30))
    exploration = explored(cabinet or PaperCabinet(free=(0,)), fronts=1)
    exploration.first_look = seen.frame
    last = exploration.attempts[-1]
    uv = np.array([[40.0, 30.0]])
    p_cam = seen.frame.camera.back_project(uv, seen.frame.depth_m[30, 40][None])[0]
    contact = replace(last.contact, p_world=seen.frame.T_world_cam.transformFrom(p_cam))
    exploration.attempts[-1] = replace(last, contact=contact)
    return exploration


def perceiver(memory):
    return Perceiver(Everything(), None, Analogy(memory, ColourFeatures()), ExploreConfig())


def test_the_contact_that_opened_is_kept_with_its_kind_and_the_way_it_went():
    opened = opened_at(explored(PaperCabinet(free=(0,)), fronts=1), "it", "cabinet")
    assert (opened.kind, opened.object_name, opened.family) == ("prismatic", "it", "cabinet")
    np.testing.assert_allclose(opened.direction_world, NORMAL, atol=1e-9)


def test_what_did_not_open_or_has_no_kind_is_not_remembered():
    assert opened_at(explored(PaperCabinet(), fronts=1), "it", "") is None
    exploration = explored(PaperCabinet(free=(0,)), fronts=1)
    undecided = replace(exploration.fit.posterior, kind="undecided")
    exploration.fit = replace(exploration.fit, posterior=undecided)
    assert opened_at(exploration, "it", "") is None


def test_a_memory_begins_with_what_was_asked_and_grows(memory, tmp_path):
    folder = tmp_path / "mine"
    before = len(memory.contacts)
    assert remember(folder, seen_exploration(), perceiver(memory), "first", "") == before + 1
    assert remember(folder, seen_exploration(), perceiver(memory), "second", "") == before + 2
    kept = ContactMemory.read(folder).contacts
    assert [contact.object_name for contact in kept[before:]] == ["first", "second"]


def test_a_memory_of_other_features_is_left_as_it_is_and_that_is_noted(memory, tmp_path):
    replace(memory, made_by="others/1").write(tmp_path)
    exploration = seen_exploration()
    assert remember(tmp_path, exploration, perceiver(memory), "it", "") is None
    assert "described by others/1" in exploration.notes[-1]
    assert len(ContactMemory.read(tmp_path).contacts) == len(memory.contacts)
