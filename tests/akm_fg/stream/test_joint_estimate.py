"""Depth and tracks: who is asked when the other one has no answer."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from akm_fg.errors import AxisUnobservable
from akm_fg.stages import ModelSettings
from akm_fg.steps import to_end
from akm_fg.stream import joint_estimate


def estimated(monkeypatch: pytest.MonkeyPatch, moving: bool) -> Any:
    """The estimate where depth explains more of the change, but leaves the joint open."""

    def better(*_: Any) -> Iterator[None]:
        yield
        return "change"

    def by_change(*_: Any) -> Iterator[None]:
        yield
        raise AxisUnobservable("the data leave a state open")

    def by_tracks(*_: Any) -> Iterator[None]:
        yield
        return "by tracks"

    for name, stage in (
        ("better_than_tracks", better),
        ("_by_change", by_change),
        ("_by_tracks", by_tracks),
        ("stands_still", lambda _: True),
        ("knowledge_of", lambda *_: []),
    ):
        monkeypatch.setattr(joint_estimate, name, stage)
    observed = SimpleNamespace(segmentation=SimpleNamespace(moving=np.array([moving])))
    recording = SimpleNamespace(frames=(), name="lid")
    steps = joint_estimate.estimate_in_steps(recording, observed, ModelSettings())  # type: ignore
    return to_end(steps)


def test_where_depth_leaves_the_joint_open_the_tracks_are_asked(monkeypatch):
    assert estimated(monkeypatch, moving=True) == "by tracks"


def test_where_no_track_moves_what_depth_says_stands(monkeypatch):
    with pytest.raises(AxisUnobservable, match="leave a state open"):
        estimated(monkeypatch, moving=False)
