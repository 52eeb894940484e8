"""A stream of frames: the recording's answer, what is known on the way, and no frame undone."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from akm_fg.errors import NoMotionObserved, TracksLost
from akm_fg.estimation.sources.state_knowledge import StateKnowledge
from akm_fg.estimation.sources.surface import SURFACE
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.kept_frames import KeptFramesConfig
from akm_fg.perception.observe import ObserveConfig
from akm_fg.pipeline import fit_recording
from akm_fg.records import CalibrationErrors, Recording
from akm_fg.stages import ModelSettings, Stages
from akm_fg.stream.frame_stream import FrameStream
from akm_fg.stream.joint_estimate import estimate_joint
from akm_fg.stream.seen_so_far import Hand

FEW_KEPT = ModelSettings(
    perception=PerceptionConfig(observe=ObserveConfig(kept=KeptFramesConfig(most=10)))
)


def streamed(frames, settings=None, stages=None):
    """A stream that was given these frames, and what it said with each."""
    stream = FrameStream("clip", settings, stages)
    return stream, [stream.add(frame) for frame in frames]


def assert_same(a, b) -> None:
    """Two fits agree to the last digit."""
    assert a.posterior.kind_probability == b.posterior.kind_probability
    assert a.posterior.fit == b.posterior.fit
    for name, kind in b.posterior.alternatives.items():
        other = a.posterior.alternatives[name]
        assert (kind.joint is None) == (other.joint is None)
        if kind.joint is not None:
            assert_array_equal(other.joint.T_world_joint, kind.joint.T_world_joint)
            assert_array_equal(other.joint.cov, kind.joint.cov)
            assert_array_equal(other.states.mean, kind.states.mean)
            assert_array_equal(other.states.sd, kind.states.sd)
    assert_array_equal(a.observed.segmentation.moving, b.observed.segmentation.moving)
    assert_array_equal(a.observed.tracks.p_world, b.observed.tracks.p_world)


def to_and_fro(clip, times: int):
    """Frames of a clip forwards and backwards, so often, and which each of them is."""
    n = len(clip.frames)
    once = [*range(n), *range(n - 2, 0, -1)]
    order = (times * once)[: times * len(once)]
    frames = [replace(clip.frames[k], stamp_s=0.1 * t) for t, k in enumerate(order)]
    return frames, np.array(order)


@pytest.fixture(scope="module", params=["door", "drawer"])
def told(request):
    """A rendered clip, three times to and fro: its states, its stream and the updates."""
    clip = request.getfixturevalue(request.param)
    frames, order = to_and_fro(clip, 3)
    return (clip, clip.states[order], *streamed(frames))


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_a_stream_ends_where_the_recording_does(name, request, fit_of):
    clip = request.getfixturevalue(name)
    stream, _ = streamed(clip.frames)
    assert_same(stream.posterior(), fit_of(clip))


def test_a_stream_holds_what_is_not_known_of_the_camera_as_a_recording_does(drawer):
    errors = CalibrationErrors(1e-6 * np.eye(6), 0.002, 0.01, 0.001)
    stream = FrameStream("clip", calibration=errors)
    for frame in drawer.frames:
        stream.add(frame)
    fit = stream.posterior()
    assert_same(fit, fit_recording(replace(drawer.recording, calibration=errors)))
    assert fit.posterior.best.states.sd[-1] > 0.01 * fit.posterior.best.states.mean[-1]


def test_asking_on_the_way_changes_nothing_later(drawer, fit_of):
    stream = FrameStream("clip")
    for t, frame in enumerate(drawer.frames):
        stream.add(frame)
        if t == 8:
            short = Recording("clip", drawer.frames[:9])
            assert_same(stream.posterior(), fit_recording(short))
    assert_same(stream.posterior(), fit_of(drawer))


def test_the_joint_is_told_while_it_moves(told):
    clip, states, stream, updates = told
    assert [update.number for update in updates] == list(range(states.size))
    assert updates[0].kind == "undecided" and updates[0].joint is None
    last, answer = updates[-1], stream.posterior().posterior
    assert last.kind == answer.kind == clip.scene.joint
    assert last.warning is None
    angle = np.arccos(min(1.0, abs(last.joint.axis @ answer.best.joint.axis)))
    assert angle < 3 * np.hypot(last.joint.axis_sd_rad, answer.best.joint.axis_sd_rad)


def test_every_frames_state_is_told_at_once_and_within_its_deviation(told):
    _, states, _, updates = told
    late = [update for update in updates if update.number > 30]
    known = [update for update in late if update.state is not None]
    assert len(known) > 0.9 * len(late)
    off = np.array([abs(update.state) - states[update.number] for update in known])
    sd = np.array([update.state_sd for update in known])
    moved = states[[update.number for update in known]] > 0
    assert np.abs(off[moved] / sd[moved]).max() < 5
    assert np.mean((off[moved] / sd[moved]) ** 2) < 2  # they repeat the same images


def test_the_graph_that_is_solved_on_keeps_the_surface(told):
    """Between comparisons too, with frames that came since."""
    _, states, stream, updates = told
    lead = stream._thinking.lead
    (surface,) = (source for source in lead.problem.sources if source.name == SURFACE)
    numbers = lead.problem.keyframes
    assert_array_equal(numbers, lead.numbers)
    assert len(surface.frames) == 5 and numbers[surface.frames[0]] == 0
    apart = states[numbers[surface.frames]]
    assert np.unique(apart.round(6)).size == 5  # still those that were chosen, apart in state
    assert numbers[-1] > numbers[surface.frames].max()
    assert updates[-1].keyframes > 5


def test_where_nothing_can_be_followed_the_surface_tells_states(door):
    plain = [replace(f, rgb=np.full_like(f.rgb, 120)) for f in to_and_fro(door, 4)[0]]
    states = door.states[to_and_fro(door, 4)[1]]
    _, updates = streamed(plain)
    assert updates[-1].joint.turns and updates[-1].keyframes == 0
    late = [u for u in updates[-12:] if u.state is not None]
    assert len(late) >= 8
    for update in late:
        assert abs(abs(update.state) - states[update.number]) < 0.03


def test_nothing_moves_and_nothing_is_claimed(still):
    stream, updates = streamed(still.frames)
    assert {update.kind for update in updates} <= {"undecided", "rigid"}
    assert all(update.joint is None and update.state is None for update in updates)
    assert "nothing moved" in updates[-1].warning
    with pytest.raises(NoMotionObserved, match=r"^clip: .*expected a part that moves$"):
        stream.posterior()


def test_a_frame_in_which_the_part_is_hidden_has_no_state_and_does_no_harm(drawer):
    """Somebody stands before the camera for a moment."""
    frames, order = to_and_fro(drawer, 2)
    dark, k = frames[40], 40
    frames[k] = replace(
        dark, rgb=np.zeros_like(dark.rgb), depth_m=np.full_like(dark.depth_m, np.nan)
    )
    stream, updates = streamed(frames)
    assert updates[k].state is None
    assert updates[k - 1].kind == updates[k].kind == updates[-1].kind == "prismatic"
    before, after = updates[k - 1], [u for u in updates[k + 1 :] if u.state is not None]
    assert before.state is not None and len(after) > 10
    for update in (before, *after):
        assert abs(update.state - drawer.states[order[update.number]]) < 0.01
    assert np.isnan(stream.posterior().posterior.best.states.mean[k])


def test_an_object_that_comes_late_starts_the_stream_then(drawer):
    first = drawer.frames[0]
    dark = replace(first, stamp_s=-1.0, depth_m=np.full_like(first.depth_m, np.nan))
    stream = FrameStream("clip")
    with pytest.raises(TracksLost, match="no object"):
        stream.add(dark)
    updates = [stream.add(frame) for frame in drawer.frames[:7]]
    assert updates[0].number == 0
    assert_same(stream.posterior(), fit_recording(Recording("clip", drawer.frames[:7])))


def test_frames_that_are_not_kept_get_their_states_beside_the_graph(door, fit_of):
    """Ten frames are kept of fifteen; memory of images is bounded, the answer is over all."""
    stream, _ = streamed(door.frames, FEW_KEPT)
    assert stream._seen.numbers.size == 10
    few = stream.posterior()
    assert_same(few, fit_recording(door.recording, perception=FEW_KEPT.perception))
    states, all_kept = few.posterior.best.states, fit_of(door).posterior
    assert states.mean.shape == (15,) and np.isfinite(states.mean).all()
    assert few.observed.tracks.p_world.shape[0] == 15
    assert few.posterior.kind == all_kept.kind == "revolute"
    assert set(few.posterior.fit.keyframes_registered) <= set(stream._seen.numbers.tolist())
    sd = np.hypot(states.sd, all_kept.best.states.sd)
    assert_allclose(states.mean, all_kept.best.states.mean, atol=float(4 * sd.max()))
    off = np.abs(states.mean - door.states)[1:] / states.sd[1:]
    assert np.max(off) < 5


def test_an_estimator_that_is_handed_in_answers_over_all_frames_too(door):
    asked = []

    def estimator(recording, observed, settings):
        asked.append((len(recording.frames), observed.tracks.p_world.shape[0]))
        return estimate_joint(recording, observed, settings)

    stream, _ = streamed(door.frames, FEW_KEPT, Stages(estimator=estimator))
    found = stream.posterior()
    assert asked == [(10, 10)]
    states = found.posterior.best.states
    assert_array_equal(np.flatnonzero(np.isfinite(states.mean)), stream._seen.numbers)
    assert found.observed.tracks.p_world.shape[0] == 15
    assert set(found.posterior.fit.keyframes_registered) <= set(stream._seen.numbers.tolist())


def test_the_hand_tells_as_long_as_it_holds_without_a_break(door):
    """As a recording says it: the first stretch of frames in which it holds."""
    poses = [gtsam.Pose3(gtsam.Rot3(), np.array([0.01 * t, 0.0, 0.5])) for t in range(9)]
    holding = [False, True, True, True, False, True, True, True, True]
    stream = FrameStream("clip")
    for frame, pose, held in zip(door.frames, poses, holding, strict=False):
        stream.add(frame, Hand(pose, held))
    clip = stream._seen._clip()
    assert clip.grasp_frames == (1, 3)
    assert_array_equal([p.translation()[0] for p in clip.T_world_gripper], [p.x() for p in poses])
    given = Recording("clip", door.frames[:9], None, tuple(poses), (1, 3))
    assert_same(stream.posterior(), fit_recording(given))


def test_knowledge_of_the_states_motion_takes_the_frames_own_times(drawer):
    """And goes on with frames that come while kinds are compared."""
    settings = ModelSettings(states=StateKnowledge(np.arange(2.0), sigma_m_per_sqrt_s=0.05))
    frames, _ = to_and_fro(drawer, 2)
    stream, updates = streamed(frames, settings)
    assert stream.posterior().posterior.kind == updates[-1].kind == "prismatic"
    assert {u.kind for u in updates[-10:]} == {"prismatic"}


def test_a_stamp_that_does_not_grow_is_refused(drawer):
    stream, _ = streamed(drawer.frames[:2])
    with pytest.raises(ValueError, match="expected to grow"):
        stream.add(drawer.frames[1])
