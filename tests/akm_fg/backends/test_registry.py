"""Stages by name: what is there, what a new file needs, what is said of names that are wrong."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from akm_fg.backends import registry, segmenters, trackers
from akm_fg.backends.registry import names, require_known, stages_of
from akm_fg.config import AkmConfig, StageNames
from akm_fg.errors import InputError
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.perception.tracking.flow_tracker import FlowTracker
from akm_fg.pipeline import fit_recording
from akm_fg.stages import Stages
from akm_fg.stream.joint_estimate import estimate_joint

TOY = """
from dataclasses import dataclass

@dataclass(frozen=True)
class ToyConfig:
    points: int = 7

def make(settings):
    return settings.own(ToyConfig())
"""


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A package of backends, with one file."""
    folder = tmp_path / "toys"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "toy.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("toys")
    for name in [name for name in sys.modules if name.partition(".")[0] == "toys"]:
        del sys.modules[name]


def with_own(**own: dict) -> AkmConfig:
    return AkmConfig(stages=StageNames(own=own))


def test_the_defaults_are_there_and_are_what_a_fit_takes_by_itself():
    assert "flow" in names(trackers) and "depth" in names(segmenters)
    stages = stages_of(AkmConfig())
    assert isinstance(stages.segmenter, DepthObjectSegmenter)
    assert isinstance(stages.tracker, FlowTracker)


def test_stages_are_tuned_by_the_tree():
    config = AkmConfig()
    observe = config.perception.observe
    observe = replace(
        observe,
        tracker=replace(observe.tracker, max_coast=3),
        mask=replace(observe.mask, samples=77),
    )
    stages = stages_of(replace(config, perception=replace(config.perception, observe=observe)))
    assert stages.tracker.config.max_coast == 3
    assert stages.segmenter.config.samples == 77


def test_a_backend_is_one_file_that_is_imported_when_it_is_asked_for(toys):
    assert names(toys) == ("toy",)
    assert "toys.toy" not in sys.modules
    assert registry.make(toys, "toy", AkmConfig()).points == 7
    assert registry.make(toys, "toy", with_own(toy={"points": 9})).points == 9


def test_a_backends_own_settings_are_checked_like_all_others(toys):
    with pytest.raises(InputError, match=r"stages.own.toy: pints = 9: is no setting.* points"):
        registry.make(toys, "toy", with_own(toy={"pints": 9}))


def test_a_name_without_a_file_is_told_with_the_names_that_there_are(toys):
    with pytest.raises(InputError, match=r"^toy 'toi': there is none of that name; .* of toy$"):
        require_known(toys, "toi")
    for stages in (StageNames(tracker="cotracker9"), StageNames(segmenter="sam9")):
        with pytest.raises(InputError, match=r"er '\w+9': there is none .* expected one of \w+"):
            stages_of(AkmConfig(stages=stages))
    with pytest.raises(InputError, match=r"stages.own.flaw: there is no such backend.*flow"):
        stages_of(with_own(flaw={"x": 1}))


class Counted:
    """One of the default stages, which counts how often it is asked."""

    def __init__(self, real: object) -> None:
        self.asked, self._real = 0, real

    def __getattr__(self, name: str):
        self.asked += 1
        return getattr(self._real, name)


def test_a_fit_takes_the_stages_that_it_is_given(door):
    given = replace(door.recording, object_masks=None)
    segmenter, tracker, seen = Counted(DepthObjectSegmenter()), Counted(FlowTracker()), []

    def estimator(recording, observed, settings):
        seen.append((recording.name, observed.segmentation.moving.sum(), settings))
        return estimate_joint(recording, observed, settings)

    stages = Stages(tracker, segmenter, estimator)
    found = fit_recording(given, seed=3, sources="tracks", stages=stages)
    assert segmenter.asked > 0 and tracker.asked > 0
    ((name, moving, settings),) = seen
    assert name == given.name and moving > 0
    assert (settings.seed, settings.sources) == (3, "tracks")
    alone = fit_recording(given, seed=3, sources="tracks")
    np.testing.assert_array_equal(
        found.posterior.best.joint.T_world_joint, alone.posterior.best.joint.T_world_joint
    )
