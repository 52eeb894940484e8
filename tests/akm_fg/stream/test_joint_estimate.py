"""Depth and tracks: who is asked when the other one has no answer."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from akm_fg.errors import AxisUnobservable
from akm_fg.perception.config import PerceptionConfig
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
        ("by_change_in_steps", by_change),
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


@pytest.mark.parametrize(("elsewhere", "wins"), [(0.2, "tracks"), (0.9, "depth")])
def test_depth_that_is_right_where_tracks_are_and_nowhere_else_does_not_take_their_place(
    monkeypatch, elsewhere: float, wins: str
):
    """Tracks explain all in two of five frames; depth most of it there, and less or more beyond."""
    first = np.arange(5) < 2
    motion = SimpleNamespace(known=first, from_frame=lambda _: ("R", "t"))
    monkeypatch.setattr(joint_estimate, "free_rigid_motion", lambda *_: motion)
    guess = SimpleNamespace(motion=lambda: ("R_depth", "t_depth"))
    everywhere, change = np.ones(5, dtype=bool), SimpleNamespace(nearer=np.ones((5, 1, 1)) > 0)
    found = SimpleNamespace(change=change, guesses=(guess,), known=(everywhere,))

    def by_depth(*_: Any) -> Iterator[None]:
        yield
        return found

    def share(_: Any, R: str, t: str, known: np.ndarray) -> float:
        return 1.0 if R == "R" else 0.9 if known.sum() == 2 else elsewhere

    monkeypatch.setattr(joint_estimate, "depth_motion", by_depth)
    monkeypatch.setattr(joint_estimate, "explained_share", share)
    observed = SimpleNamespace(
        object_mask=None, moving_tracks=None, segmentation=SimpleNamespace(moving=np.ones(9) > 0)
    )
    recording: Any = SimpleNamespace(name="lid")
    steps = joint_estimate.better_than_tracks(recording, observed, PerceptionConfig())  # type: ignore
    assert to_end(steps) is (None if wins == "tracks" else found)


@pytest.mark.parametrize(("turns", "chosen"), [(True, "tracks"), (False, "depth")])
def test_tracks_speak_for_depth_that_is_undecided_only_where_both_move_alike(
    turns: bool, chosen: str
):
    def estimate(turns: bool) -> Any:
        best = SimpleNamespace(joint=SimpleNamespace(turns=turns))
        return SimpleNamespace(fitted=SimpleNamespace(posterior=SimpleNamespace(best=best)))

    depth, tracks = estimate(True), estimate(turns)

    def by_tracks() -> Iterator[None]:
        yield
        return tracks

    found = to_end(joint_estimate._in_accord(depth, by_tracks))  # type: ignore
    assert found is {"tracks": tracks, "depth": depth}[chosen]
