"""What an exploration leaves where its last looks have no states."""

from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from akm_fg.cli.exploring.explore import _print
from akm_fg.cli.exploring.kept import Explored
from akm_fg.cli.exploring.outcome import (
    _require_closed_known,
    began_at,
    carried_before,
    closed_at,
    last_recording,
    solved_frames,
)
from akm_fg.config import AkmConfig
from akm_fg.errors import InsufficientData
from akm_fg.exploration.records import Exploration
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.pipeline import fit_recording
from akm_fg.records import Look, Recording
from tests.akm_fg.exploration.test_attempt import PaperCabinet
from tests.akm_fg.exploration.test_attempt import fit_of as paper_fit


def test_frames_after_the_last_solution_are_no_part_of_what_was_fitted():
    cabinet = PaperCabinet()
    looks = [Look(cabinet.capture(), cabinet.T_world_gripper(), k in (1, 2, 3)) for k in range(7)]
    exploration = Exploration(first_look=looks[0].frame, looks=looks, fit=paper_fit(0.1, 5))
    assert solved_frames(exploration.fit) == 5
    recording = last_recording(exploration)
    assert len(recording.frames) == len(recording.T_world_gripper) == 5
    assert recording.grasp_frames == (1, 3)


def test_without_a_fit_all_looks_of_the_attempt_are_shown_and_without_any_the_first():
    cabinet = PaperCabinet()
    first = cabinet.capture()
    looks = [Look(cabinet.capture(), cabinet.T_world_gripper(), False) for _ in range(3)]
    assert len(last_recording(Exploration(first_look=first, looks=looks)).frames) == 3
    (only,) = last_recording(Exploration(first_look=first)).frames
    np.testing.assert_array_equal(only.rgb, first.rgb)
    assert last_recording(Exploration()) is None


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_what_had_crept_open_before_is_closed_where_the_first_look_shows_it(request, name, fit_of):
    clip = request.getfixturevalue(name)
    fitted = FittedRecording.of(Recording("clip", clip.frames), fit_of(clip))
    model = build_model(fitted)
    assert closed_at(model, clip.frames[0], AkmConfig()) is None  # it began where it is closed
    assert closed_at(model, None, AkmConfig()) is None
    states = model.parts[0].states
    found = closed_at(model, clip.frames[5], AkmConfig())
    assert found == pytest.approx(states.mean[5], abs=4 * states.sd[5] + 0.004)


def tried(contact, unseen_m, seen_m=None):
    stretches = [] if seen_m is None else [SimpleNamespace(travel_m=seen_m)]
    return SimpleNamespace(contact=contact, unseen_m=unseen_m, stretches=stretches)


def test_a_front_that_may_have_slid_along_itself_unseen_gets_no_model(drawer, fit_of):
    """A drawer comes out of its plane: depth shows how far. What is asked of that is set higher."""
    model = build_model(FittedRecording.of(Recording("clip", drawer.frames), fit_of(drawer)))
    front, other = (SimpleNamespace(front=k) for k in (0, 1))
    opened = tried(front, 0.0)
    config = AkmConfig()
    plain = replace(config, relocalization=replace(config.relocalization, outline_along=2.0))

    def require(before, config):
        gone_m = carried_before(SimpleNamespace(attempts=[before, opened]))
        _require_closed_known(model, gone_m, config)

    require(tried(front, 0.12), config)
    require(tried(front, 0.01), plain)
    require(tried(other, 0.12), plain)
    for before in (tried(front, 0.12), tried(front, 0.0, seen_m=0.12)):
        with pytest.raises(InsufficientData, match="gone 12 cm with it before"):
            require(before, plain)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_what_was_carried_open_unseen_is_looked_for_beyond_where_its_pull_began(request, name):
    """The pull that was seen began a good way open; the first look is from before all pulls."""
    clip = request.getfixturevalue(name)
    later = Recording("clip", clip.frames[4:])
    model = build_model(FittedRecording.of(later, fit_recording(later)))
    part = model.parts[0]
    went = clip.states[-1] - clip.states[4]
    q = (clip.states[0] - clip.states[4]) * np.sign(part.states.mean[-1] * went)
    lever = np.linalg.norm(part.joint.joint.velocity(part.surface.p_world.mean(axis=0)))
    found = closed_at(model, clip.frames[0], AkmConfig(), gone_m=1.2 * lever * abs(q))
    assert found == pytest.approx(q, abs=0.006)
    empty = replace(clip.frames[0], depth_m=np.full_like(clip.frames[0].depth_m, np.nan))
    assert closed_at(model, empty, AkmConfig()) is None
    with pytest.raises(InsufficientData, match="shows it at no state"):
        closed_at(model, empty, AkmConfig(), gone_m=0.1)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_where_a_pull_began_that_the_hand_hid_the_hand_tells(request, name, fit_of):
    """Of frames whose states are taken away, all are told but those before the hold."""
    clip = request.getfixturevalue(name)
    posterior = fit_of(clip).posterior
    joint, states = posterior.best.joint.joint, posterior.best.states
    handle = np.array([0.3, 0.1, 0.4])
    hands = []
    for q in states.mean:
        (R,), (t,) = joint.motion(np.array([q]))
        hands.append(gtsam.Pose3(gtsam.Rot3(), R @ handle + t))
    recording = Recording(
        "clip", clip.frames, T_world_gripper=tuple(hands), grasp_frames=(2, len(hands) - 1)
    )
    assert began_at(posterior, recording) is None  # its frames show it
    mean, sd = states.mean.copy(), states.sd.copy()
    mean[:6], sd[:6] = np.nan, np.nan
    mean -= mean[6]  # as states count where frame 6 is the first to show the part
    hidden = posterior.with_states(mean, sd)
    there = states.mean[2] - states.mean[6]
    assert began_at(hidden, recording) == pytest.approx(there, abs=0.002)
    assert began_at(hidden, Recording("clip", clip.frames)) is None


def test_what_is_said_at_the_end_is_text_alone(tmp_path, capfd):
    folder = tmp_path / "a[red]\x1b[31mb"
    folder.mkdir()
    (folder / "report.html").touch()
    explored = Explored(Exploration(failure="no [/b] front"), folder)
    _print(SimpleNamespace(folder=folder), explored)
    said = capfd.readouterr().out
    assert "not opened: no [/b] front\n" in said
    assert said.endswith(r"a[red]\x1b[31mb/report.html" + "\n")
