"""Where a modelled part is: from anywhere, followed, hidden, moved unseen, and not there at all."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.io.recording_writer import write_recording
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.model.write import write_model
from akm_fg.records import CameraCorrection, Recording
from akm_fg.relocalization.likelihood import Shares
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.relocalization.surface_state import Measured
from akm_fg.stream.seen_so_far import Hand
from experiments.trials.mishaps import of_wrong_kind


@pytest.fixture(scope="module", params=["door", "drawer"])
def known(request, fit_of):
    """A clip, and the model that was made of it."""
    clip = request.getfixturevalue(request.param)
    return clip, model_of(clip, fit_of)


def model_of(clip, fit_of):
    return build_model(FittedRecording.of(Recording("clip", clip.frames), fit_of(clip)))


def states_of(clip, model) -> np.ndarray:
    """The true states, with the sign of the model's axis."""
    fitted = model.parts[0].states.mean
    return np.asarray(clip.states) * np.sign(fitted[-1] * clip.states[-1])


def dark(frame, stamp_s=None):
    """The camera is covered."""
    depth = np.full_like(frame.depth_m, np.nan)
    return replace(frame, depth_m=depth, stamp_s=stamp_s or frame.stamp_s)


def at(frame, stamp_s):
    return replace(frame, stamp_s=stamp_s)


def assert_told(belief, q):
    assert belief.mode == "tracking"
    assert abs(belief.mean - q) < 3.5 * belief.sd
    assert belief.sd < 0.01


@pytest.mark.parametrize("number", [0, 6, -1])
def test_it_is_found_from_anywhere_in_one_frame(known, number):
    clip, model = known
    belief = Relocalizer(model).update(clip.frames[number])
    assert_told(belief, states_of(clip, model)[number])
    assert belief.probability > 0.99


def test_it_is_followed_and_the_innovations_are_no_larger_than_they_should_be(known):
    clip, model = known
    follower, nis = Relocalizer(model), []
    for frame, q in zip(clip.frames, states_of(clip, model), strict=True):
        belief = follower.update(frame)
        assert_told(belief, q)
        nis += [] if belief.nis is None else [belief.nis]
    assert np.mean(nis) < 3.0


def test_while_it_is_hidden_the_belief_widens_and_afterwards_it_is_found(known):
    clip, model = known
    follower = Relocalizer(model)
    first = follower.update(clip.frames[0])
    widths = [first.sd]
    for k in range(1, 11):
        belief = follower.update(dark(clip.frames[0], clip.frames[0].stamp_s + 0.1 * k))
        assert belief.mode == "tracking" and not belief.seen
        assert belief.reason == "the part is hidden"
        widths.append(belief.sd)
    assert (np.diff(widths) > 0).all() and widths[-1] > 3 * widths[0]
    found = follower.update(at(clip.frames[3], clip.frames[0].stamp_s + 1.2))
    assert_told(found, states_of(clip, model)[3])


def test_a_part_that_was_moved_while_nobody_looked_is_noticed_and_found_again(known):
    clip, model = known
    follower = Relocalizer(model)
    for k in range(3):
        follower.update(at(clip.frames[0], 1.0 + 0.03 * k))
    last, told = len(clip.frames) - 1, []
    for k in range(5):
        told.append(follower.update(at(clip.frames[last], 1.1 + 0.03 * k)))
    assert_told(told[-1], states_of(clip, model)[last])
    assert any("found again" in (belief.reason or "") for belief in told) or told[0].seen
    wrong = [b for b in told if b.seen and abs(b.mean - states_of(clip, model)[last]) > 5 * b.sd]
    assert not wrong


def test_after_a_long_time_the_part_is_where_it_is_and_no_full_turn_on(known):
    clip, model = known
    follower, states = Relocalizer(model), states_of(clip, model)
    assert_told(follower.update(clip.frames[0]), states[0])
    # What a rate may have done in a minute spans more than the whole range.
    assert_told(follower.update(at(clip.frames[1], clip.frames[0].stamp_s + 60.0)), states[1])


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_a_camera_that_is_off_finds_the_part_where_it_sees_it(known, share):
    clip, model = known
    # The hand has told that all is 1 cm lower and turned; of a slid part, longer by a share.
    off = gtsam.Pose3(gtsam.Rot3.Rz(0.01), np.array([0.0, 0.004, -0.01]))
    part = model.parts[0]
    joint, best = part.joint, part.posterior.best
    share = 0.0 if joint.turns else share
    moved = off * gtsam.Pose3(joint.T_world_joint)
    wide = replace(
        joint, joint=replace(joint.joint, T_world_joint=moved.matrix()), cov=100.0 * joint.cov
    )
    states = replace(best.states, mean=(1.0 + share) * best.states.mean)
    kind = replace(best, joint=wide, states=states)
    posterior = replace(part.posterior, alternatives={str(joint.kind): kind})
    correction = CameraCorrection(off, joint.cov, share, 0.0 if joint.turns else 0.001)
    corrected = replace(part, posterior=posterior, correction=correction)
    assert corrected.seen_joint.joint.T_world_joint == pytest.approx(joint.T_world_joint)
    told = Relocalizer(replace(model, parts=(corrected,))).update(clip.frames[6])
    plain = Relocalizer(model).update(clip.frames[6])
    assert told.mean == pytest.approx((1.0 + share) * plain.mean, rel=1e-6, abs=1e-6)
    unknown = 0.0 if joint.turns else 0.001 * abs(told.mean)
    assert told.sd == pytest.approx(np.hypot((1.0 + share) * plain.sd, unknown), rel=1e-3)
    x = part.surface.p_world[0]
    q = float(states.mean[6])
    seen = corrected.T_seen_part(q).transformFrom(x)
    assert seen == pytest.approx(part.T_world_part(float(best.states.mean[6])).transformFrom(x))


def test_a_hand_that_holds_carries_the_state_of_a_hidden_part(known):
    clip, model = known
    joint, q = model.parts[0].joint.joint, states_of(clip, model)
    x = model.parts[0].surface.p_world.mean(axis=0) + np.array([0.0, 0.02, 0.0])
    R, t = joint.motion(q)
    hands = [gtsam.Pose3(gtsam.Rot3(), R[k] @ x + t[k]) for k in range(q.size)]
    follower = Relocalizer(model)
    follower.update(clip.frames[0], Hand(hands[0], True))
    for k in range(1, q.size):
        belief = follower.update(dark(clip.frames[k]), Hand(hands[k], True))
    assert not belief.seen
    assert abs(belief.mean - q[-1]) < 3.5 * belief.sd
    assert belief.sd < 0.1 * abs(q[-1])


@pytest.mark.parametrize("holding", [True, False])
def test_a_look_alike_elsewhere_is_not_the_part_that_a_hand_holds(known, monkeypatch, holding):
    """An arm hides most of the part; what is seen of it is where the belief has it."""
    clip, model = known
    follower = Relocalizer(model)
    hand = Hand(gtsam.Pose3(gtsam.Rot3(), model.parts[0].surface.p_world.mean(axis=0)), holding)
    there = follower.update(clip.frames[0], hand)
    elsewhere = float(follower._grid.states[-3])

    def odds(frame, noise, states):
        return np.where(np.abs(states - elsewhere) < 0.05, 100.0, 40.0)

    monkeypatch.setattr(follower._surface, "measured", lambda frame, q, reach: (
        Measured(elsewhere, 1e-6, 0.5) if abs(q - elsewhere) < 0.05 else None
    ))  # fmt: skip
    monkeypatch.setattr(follower._likelihood, "shares", lambda *_: Shares(50, 1.0, 0.0, 0.0))
    monkeypatch.setattr(follower._likelihood, "log_odds", odds)
    told = [
        follower.update(at(clip.frames[0], clip.frames[0].stamp_s + 0.1 * k), hand)
        for k in range(1, 3)
    ]
    reason = "the part is hidden" if holding else "the part is seen at another state"
    assert [belief.reason for belief in told] == [reason, reason]
    assert told[-1].mode == "tracking" and told[-1].mean == pytest.approx(there.mean, abs=5e-3)


def test_a_hand_that_takes_hold_where_nobody_looked_for_long_tells_the_state(known):
    clip, model = known
    first, q = clip.frames[0], states_of(clip, model)[0]
    told = []
    for felt in (None, (float(q), 0.015), (float(q) + 9.0, 0.015)):
        follower = Relocalizer(model)
        follower.update(first)
        later = dark(first, first.stamp_s + 10.0)
        told.append(follower.update(later, None, None, felt))
    alone, held, elsewhere = told
    assert alone.sd > 0.1 and not held.seen
    assert held.sd < 0.02 and abs(held.mean - q) < 0.02
    assert elsewhere.mean == alone.mean  # what the belief excludes is no hold of this part


@pytest.mark.parametrize(("after_s", "kept"), [(8.0, True), (60.0, False)])
def test_while_an_arm_reaches_for_a_part_nobody_else_moves_it(known, after_s, kept):
    clip, model = known
    first, q = clip.frames[6], float(states_of(clip, model)[6])
    handle = gtsam.Pose3(gtsam.Rot3(), model.parts[0].surface.p_world.max(axis=0))
    follower = Relocalizer(model)
    before = follower.update(first, Hand(handle, False))
    later = dark(first, first.stamp_s + after_s)
    held = follower.update(later, Hand(handle, True), None, (q + 0.005, 0.015))
    assert not held.seen
    lever = np.linalg.norm(model.parts[0].joint.joint.velocity(handle.translation()))
    assert (held.sd * lever < 0.004) == kept
    assert not kept or abs(held.mean - before.mean) * lever < 0.002


def test_another_objects_model_is_not_believed(door, drawer, fit_of):
    for own, other in ((door, drawer), (drawer, door)):
        model = model_of(own, fit_of)
        follower = Relocalizer(model)
        away = gtsam.Pose3(gtsam.Rot3(), np.array([0.4, 0.3, 0.2]))
        far = [replace(frame, T_world_cam=away * frame.T_world_cam) for frame in other.frames]
        beliefs = [follower.update(frame) for frame in far]
        assert all(belief.mode != "tracking" or belief.probability < 0.99 for belief in beliefs)


def test_a_model_of_the_wrong_kind_is_not_believed_where_its_joint_does_not_lead(known):
    clip, model = known
    part = model.parts[0]
    wrong = of_wrong_kind(part)
    assert wrong.joint.kind != part.joint.kind
    follower = Relocalizer(model.with_part(wrong))
    last = [follower.update(frame) for frame in clip.frames][-1]
    assert not last.seen and last.reason


def test_frames_come_in_the_order_of_their_time(known):
    clip, model = known
    follower = Relocalizer(model)
    follower.update(clip.frames[1])
    with pytest.raises(ValueError, match="after one at"):
        follower.update(clip.frames[0])


def test_the_command_tells_states_with_deviations(known, tmp_path, capsys):
    clip, model = known
    (tmp_path / "model").mkdir()
    write_model(tmp_path / "model", model)
    write_recording(tmp_path / "later", Recording("later", clip.frames[::3]))
    words = ["relocalize", str(tmp_path / "model"), str(tmp_path / "later")]
    assert main([*words, "--json", str(tmp_path / "states.json")]) == 0
    told = json.loads((tmp_path / "states.json").read_text())
    q = states_of(clip, model)[::3]
    assert np.abs(np.array(told["mean"]) - q).max() < 0.01
    assert set(told["mode"]) == {"tracking"}
    assert main([*words, "--part", "lid"]) == 2
    assert "'lid' is not in the model; expected one of part-0" in capsys.readouterr().err
