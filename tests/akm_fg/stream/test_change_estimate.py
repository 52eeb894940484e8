"""Answers from depth alone: the rival of the kind that was found gets a start of its own."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import gtsam
import numpy as np
import pytest

from akm_fg.estimation.fit import fit_tracks
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.perception.change.depth_change import DepthChange, depth_change
from akm_fg.perception.change.depth_motion import DepthMotion
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.changed_surface import ChangedSurface
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from akm_fg.stages import ModelSettings
from akm_fg.steps import to_end
from akm_fg.stream import change_estimate
from akm_fg.stream.change_estimate import share_of_answer
from experiments.trials.openings import make_opening
from factors.joint import Joint, JointKind

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)


@pytest.fixture(scope="module")
def posteriors() -> dict[str, ArticulationPosterior]:
    return {kind: fit_tracks(make_opening(1, kind).tracks) for kind in ("revolute", "prismatic")}


@dataclass(frozen=True)
class SimpleFitted:
    """All of the fitted kinds that is asked here."""

    posterior: ArticulationPosterior


def named(
    monkeypatch: pytest.MonkeyPatch,
    posteriors: dict[str, ArticulationPosterior],
    first: tuple[str, float],
    second: tuple[str, float],
) -> str:
    """The kind that is named where these are found, explaining so much, from two starts."""

    def answer(kind: str, share: float) -> Any:
        return change_estimate._Answer(SimpleFitted(posteriors[kind]), share)  # type: ignore

    def again(*_: Any) -> Iterator[None]:
        yield
        return answer(*second)

    monkeypatch.setattr(change_estimate, "_answer_from", again)
    start = SimpleNamespace(settings=ModelSettings(), recording=SimpleNamespace(name="bin"))
    found = to_end(change_estimate._against_its_rival(start, answer(*first)))  # type: ignore
    return str(found.fitted.posterior.kind)


def test_two_kinds_that_explain_the_change_as_well_name_none(monkeypatch, posteriors):
    pair = ("prismatic", 0.8), ("revolute", 0.82)
    assert named(monkeypatch, posteriors, *pair) == "undecided"


def test_the_kind_that_explains_clearly_more_is_named_whichever_start_it_has(
    monkeypatch, posteriors
):
    slide, hinge = ("prismatic", 0.6), ("revolute", 0.95)
    assert named(monkeypatch, posteriors, slide, hinge) == "revolute"
    assert named(monkeypatch, posteriors, hinge, slide) == "revolute"


def test_a_kind_that_is_found_from_both_starts_stands(monkeypatch, posteriors):
    pair = ("revolute", 0.8), ("revolute", 0.82)
    assert named(monkeypatch, posteriors, *pair) == "revolute"


def test_planes_of_a_face_that_explain_the_change_settle_how_the_part_moves(posteriors):
    answer = change_estimate._Answer(SimpleFitted(posteriors["revolute"]), 0.9)  # type: ignore
    for kind, explained, settled in (
        (JointKind.REVOLUTE, 0.95, True),
        (JointKind.REVOLUTE, 0.7, False),
        (JointKind.PRISMATIC, 0.95, False),
    ):
        guess = JointGuess(Joint(kind, np.eye(4), 0.0), np.zeros(2))
        change: Any = SimpleNamespace(guesses=(guess,), explained=(explained,))
        assert change_estimate._faces_agree(answer, change, PerceptionConfig()) is settled


@pytest.mark.parametrize(("states", "kind"), [(2, "undecided"), (5, "revolute")])
def test_a_part_that_is_found_in_few_of_the_frames_that_change_is_not_named(
    posteriors, states: int, kind: str
):
    """Depth changes in 20 frames, of which a quarter is asked for."""
    whole = posteriors["revolute"]
    mean = whole.best.states.mean.copy()
    mean[states:] = np.nan
    fitted = SimpleFitted(whole.with_states(mean, np.where(np.isnan(mean), np.nan, 0.01)))
    change: Any = SimpleNamespace(change=SimpleNamespace(nearer=np.ones((mean.size, 1, 1)) > 0))
    answer = change_estimate._Answer(fitted, 0.9)  # type: ignore
    found = change_estimate._silenced_where_little_is_told(answer, change, PerceptionConfig())
    assert found.posterior.kind == kind


def in_states(whole: ArticulationPosterior, count: int) -> ArticulationPosterior:
    """The posterior with states in the first frames only."""
    assert whole.best.states is not None
    mean = whole.best.states.mean.copy()
    mean[count:] = np.nan
    return whole.with_states(mean, np.where(np.isnan(mean), np.nan, 0.01))


@pytest.mark.parametrize(
    ("told", "sought", "again", "kind", "share", "states"),
    [
        (4, 9, 15, "revolute", 0.85, 15),  # found in more frames from there
        (12, 20, 20, "revolute", 0.9, 12),  # in enough already
        (4, 4, 15, "revolute", 0.9, 4),  # no other frame shows it
        (4, 9, 3, "revolute", 0.9, 4),  # found in fewer
        (4, 9, 15, "prismatic", 0.9, 4),  # another kind: the first is judged as it is
        (4, 9, 15, "revolute", 0.5, 4),  # it explains clearly less
    ],
)
def test_an_answer_in_few_frames_leads_to_one_in_more(
    monkeypatch,
    posteriors,
    told: int,
    sought: int,
    again: int,
    kind: str,
    share: float,
    states: int,
):
    """Depth changes in 20 frames; an answer in half of them is enough."""
    hinge, starts = posteriors["revolute"], []

    def answer_from(_: Any, guess: JointGuess, known: Any) -> Iterator[None]:
        starts.append((guess.q[known], int(known.sum())))
        yield
        return change_estimate._Answer(SimpleFitted(in_states(posteriors[kind], again)), share)

    monkeypatch.setattr(change_estimate, "_answer_from", answer_from)
    monkeypatch.setattr(change_estimate, "with_surface_states", lambda *_: in_states(hinge, sought))
    changed = SimpleNamespace(nearer=np.ones((20, 1, 1)) > 0)
    start: Any = SimpleNamespace(
        settings=ModelSettings(),
        recording=SimpleNamespace(name="bin", frames=()),
        change=SimpleNamespace(change=changed),
    )
    first = change_estimate._Answer(SimpleFitted(in_states(hinge, told)), 0.9)  # type: ignore
    found = to_end(change_estimate._in_more_frames(start, first))
    assert np.isfinite(found.fitted.posterior.best.states.mean).sum() == states
    for q, known in starts:
        assert known == sought
        q_sought = hinge.best.states.mean[:sought]
        np.testing.assert_allclose(q, q_sought - q_sought[0])


def plate_comes_nearer(way_m: list[float]) -> DepthChange:
    """A plate before a wall, so much nearer in every frame."""
    rgb, frames = np.zeros((120, 160, 3), np.uint8), []
    for i, way in enumerate(way_m):
        depth = np.full((120, 160), 1.5, np.float32)
        depth[30:90, 40:120] = 1.2 - way
        frames.append(RgbdFrame(float(i), rgb, depth, CAMERA, gtsam.Pose3()))
    whole = np.ones((120, 160), bool)
    return to_end(depth_change(Recording("x", tuple(frames)), whole, DepthNoiseModel()))


def test_views_of_a_changed_surface_know_that_it_came_nearer():
    change, still = plate_comes_nearer([0.0, 0.1, 0.2]), np.tile(np.eye(3), (3, 1, 1))
    steps = ChangedSurface(change).views((0, 1, 2), still, np.zeros((3, 3)), np.ones(3) > 0)
    assert to_end(steps).came_nearer


def test_what_an_answer_explains_is_judged_from_frame_0_also_where_it_has_no_state_there():
    """Its states begin at zero in frame 1, in which the plate has come 10 cm."""
    change = plate_comes_nearer([0.0, 0.1, 0.2, 0.3])
    towards = np.diag([1.0, -1.0, -1.0, 1.0])  # z along the camera's back
    joint = Joint(JointKind.PRISMATIC, towards, 0.0)
    guess = JointGuess(joint, np.array([0.0, 0.12, 0.2, 0.29]))
    known = np.ones(4, dtype=bool)
    depth, vague = (DepthMotion((guess,), (e,), (known,), change) for e in (1.0, 0.1))
    for states, least, most in (
        ([np.nan, 0.0, 0.1, 0.2], 0.95, 1.0),
        ([np.nan, 0.0, 0.0, 0.0], 0.0, 0.6),
    ):
        best = SimpleNamespace(
            joint=SimpleNamespace(joint=joint), states=SimpleNamespace(mean=np.array(states))
        )
        part = SimpleNamespace(metres_per_unit=lambda _: 1.0)
        fitted: Any = SimpleNamespace(
            posterior=SimpleNamespace(best=best), problem=SimpleNamespace(part=part)
        )
        assert least <= share_of_answer(depth, fitted, PerceptionConfig()) <= most
        assert np.isnan(share_of_answer(vague, fitted, PerceptionConfig()))
