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
    closed_at,
    last_recording,
    solved_frames,
)
from akm_fg.config import AkmConfig
from akm_fg.errors import InsufficientData
from akm_fg.exploration.records import Exploration
from akm_fg.model.build import FittedRecording, build_model
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


def test_a_front_that_may_have_slid_along_itself_unseen_gets_no_model(drawer, fit_of):
    """A drawer comes out of its plane: depth shows how far. What is asked of that is set higher."""
    model = build_model(FittedRecording.of(Recording("clip", drawer.frames), fit_of(drawer)))
    front, other = (SimpleNamespace(front=k) for k in (0, 1))
    opened = SimpleNamespace(contact=front, unseen_m=0.0)
    config = AkmConfig()
    plain = replace(config, relocalization=replace(config.relocalization, outline_along=2.0))

    def require(before, config):
        attempts = [before, opened]
        _require_closed_known(model, SimpleNamespace(attempts=attempts), config)

    require(SimpleNamespace(contact=front, unseen_m=0.12), config)
    require(SimpleNamespace(contact=front, unseen_m=0.01), plain)
    require(SimpleNamespace(contact=other, unseen_m=0.12), plain)
    with pytest.raises(InsufficientData, match="gone 12 cm with it before"):
        require(SimpleNamespace(contact=front, unseen_m=0.12), plain)


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
