"""Rendered recordings on their smallest configuration: two objects, three frames."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.io.recording import read_recording, read_truth
from experiments.rendered_recordings import RecordingConfig, chosen, main, travel_and_states
from sim.objects.suites.catalogue import find_suite, load_spec

SMALL = ["--suite", "furniture-dev", "--frames", "3", "--travel-deg", "12", "14"]


def test_a_recording_has_frames_grips_and_truth_and_is_made_only_once(tmp_path, capfd):
    command = [*SMALL, "--objects", "door-003", "--out", str(tmp_path)]
    assert main(command) == 0
    folder = tmp_path / "door-003"
    recording, truth = read_recording(folder), read_truth(folder)
    assert len(recording.frames) == 3 and recording.grasp_frames == (0, 2)
    assert truth is not None and truth.kind == "revolute"
    assert truth.states[0] == 0.0 and (np.diff(truth.states) > 0).all()
    assert np.deg2rad(12.0) <= truth.states[-1] <= np.deg2rad(14.0)
    assert_grips_follow_the_true_joint(recording.T_world_gripper, truth)
    last = recording.frames[-1]
    assert 0.02 < np.isnan(last.depth_m).mean() < 0.7  # the robot, edges
    made = (folder / "recording.json").stat().st_mtime_ns
    assert main(command) == 0
    assert (folder / "recording.json").stat().st_mtime_ns == made
    assert "is there already" in capfd.readouterr().err
    assert not list(tmp_path.glob("*.part"))


def assert_grips_follow_the_true_joint(grips, truth) -> None:
    """The gripper turns with the part about the true axis line."""
    for T_world_gripper, state in zip(grips, truth.states, strict=True):
        turn = (T_world_gripper * grips[0].inverse()).matrix()
        K = np.cross(np.eye(3), truth.axis)  # K v = axis x v
        R = np.eye(3) + np.sin(state) * K + (1.0 - np.cos(state)) * K @ K
        np.testing.assert_allclose(turn[:3, :3], R, atol=1e-3)
        np.testing.assert_allclose(turn[:3, :3] @ truth.pivot + turn[:3, 3], truth.pivot, atol=1e-3)


def test_what_the_arm_cannot_do_is_told_and_leaves_no_recording(tmp_path, capfd):
    far = ["--travel-cm", "150", "151"]  # beyond the arm's reach
    assert main([*SMALL, *far, "--objects", "drawer-003", "--out", str(tmp_path)]) == 1
    assert "0 of 1 recordings" in (told := capfd.readouterr().out)
    assert "drawer-003: the arm cannot follow the handle" in told
    assert not (tmp_path / "drawer-003").exists()


def test_states_begin_closed_grow_unevenly_and_end_within_the_asked_travel():
    spec, config = load_spec("furniture-dev/drawer-007", 0), RecordingConfig()
    ends = []
    for seed in range(50):
        states = travel_and_states(spec, config, np.random.default_rng(seed))
        steps = np.diff(states)
        assert states[0] == 0.0 and (steps > 0.0).all() and steps.std() > 0.2 * steps.mean()
        ends.append(states[-1])
    assert 0.06 <= min(ends) < 0.10 and 0.21 < max(ends) <= 0.25


def test_objects_are_chosen_by_glob_or_count(tmp_path, capfd):
    suite = find_suite("furniture-dev")
    assert chosen(suite, "door-00?") == [f"door-00{i}" for i in range(1, 10)]
    assert len(chosen(suite, "7")) == 7 and len(chosen(suite, None)) == 40
    assert chosen(suite, "2") == ["drawer-001", "door-020"]
    assert main([*SMALL, "--objects", "sofa-*", "--out", str(tmp_path)]) == 2
    assert "matches nothing" in capfd.readouterr().err


@pytest.mark.slow
def test_the_robot_opens_a_drawer_by_friction_and_is_recorded(tmp_path):
    command = ["--suite", "furniture-dev", "--pull", "robot", "--frames", "8"]
    assert main([*command, "--objects", "drawer-003", "--out", str(tmp_path)]) == 0
    recording, truth = read_recording(tmp_path / "drawer-003"), read_truth(tmp_path / "drawer-003")
    assert len(recording.frames) == len(truth.states) >= 5
    assert truth.states[-1] > 0.03
