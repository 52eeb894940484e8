"""A stream of frames: the answer of the recording, on the way what is known, and no frame undone."""

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
from akm_fg.records import Recording
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


@pytest.fixture(scope="module", params=["door", "drawer"])
def told(request):
    """A rendered clip, its stream and the updates."""
    clip = request.getfixturevalue(request.param)
    return (clip, *streamed(clip.frames))


def test_a_stream_ends_where_the_recording_does(told):
    clip, stream, _ = told
    assert_same(stream.posterior(), fit_recording(clip.recording))


def test_asking_on_the_way_changes_nothing_later(drawer):
    stream = FrameStream("clip")
    for t, frame in enumerate(drawer.frames):
        stream.add(frame)
        if t == 8:
            short = Recording("clip", drawer.frames[:9])
            assert_same(stream.posterior(), fit_recording(short))
    assert_same(stream.posterior(), fit_recording(drawer.recording))


def test_the_joint_is_told_while_it_moves(told):
    """With the last frame: the right kind, and a state within its deviation."""
    clip, stream, updates = told
    assert [update.number for update in updates] == list(range(15))
    assert updates[0].kind == "undecided" and updates[0].joint is None
    last, answer = updates[-1], stream.posterior().posterior
    assert last.kind == answer.kind == clip.scene.joint
    assert last.warning is None
    angle = np.arccos(min(1.0, abs(last.joint.axis @ answer.best.joint.axis)))
    assert angle < 4 * np.hypot(last.joint.axis_sd_rad, answer.best.joint.axis_sd_rad)
    told_states = [u for u in updates if u.state is not None and u.number > 8]
    assert len(told_states) >= 3
    for update in told_states:
        off = abs(abs(update.state) - clip.states[update.number])
        assert off < 5 * update.state_sd + 0.01 * clip.states[-1]


def test_the_graph_that_is_solved_on_keeps_the_surface(told):
    """Between comparisons too, with frames that came since."""
    _, stream, updates = told
    lead = stream._thinking._lead
    assert {source.name for source in lead.problem.sources} >= {SURFACE, "tracks"}
    seen = [s for s in lead.problem.sources if s.name == SURFACE][0]
    assert np.isin(lead.problem.keyframes[seen.frames], range(15)).all()
    assert len(seen.frames) == 5
    assert updates[-1].keyframes >= lead.numbers.size - len(seen.frames)


def test_nothing_moves_and_nothing_is_claimed(still):
    stream, updates = streamed(still.frames)
    assert {update.kind for update in updates} <= {"undecided", "rigid"}
    assert all(update.joint is None and update.state is None for update in updates)
    assert "nothing moved" in updates[-1].warning
    with pytest.raises(NoMotionObserved, match=r"^clip: .*expected a part that moves$"):
        stream.posterior()


def test_a_frame_in_which_the_part_is_hidden_has_no_state_and_does_no_harm(drawer):
    """Somebody stands before the camera for a moment."""
    frames = list(drawer.frames) * 2  # it closes with a jump, and opens again
    frames = [replace(f, stamp_s=0.1 * t) for t, f in enumerate(frames)]
    dark = frames[26]
    frames[26] = replace(
        dark, rgb=np.zeros_like(dark.rgb), depth_m=np.full_like(dark.depth_m, np.nan)
    )
    stream, updates = streamed(frames)
    assert updates[25].kind == updates[27].kind == "prismatic"
    assert updates[26].state is None
    assert_array_equal(np.isfinite(stream.posterior().posterior.best.states.mean)[[25, 26]], [1, 0])
    known = [u for u in updates[18:] if u.state is not None]
    assert len(known) >= 8
    for update in known:
        assert abs(update.state - drawer.states[update.number % 15]) < 0.01


def test_an_object_that_comes_late_starts_the_stream_then(drawer):
    first = drawer.frames[0]
    dark = replace(first, stamp_s=-1.0, depth_m=np.full_like(first.depth_m, np.nan))
    stream = FrameStream("clip")
    with pytest.raises(TracksLost, match="no object"):
        stream.add(dark)
    updates = [stream.add(frame) for frame in drawer.frames[:7]]
    assert updates[0].number == 0
    assert_same(stream.posterior(), fit_recording(Recording("clip", drawer.frames[:7])))


def test_frames_that_are_not_kept_get_their_states_beside_the_graph(door):
    """Ten frames are kept of fifteen; memory of images is bounded, the answer is over all."""
    stream, _ = streamed(door.frames, FEW_KEPT)
    assert stream._seen.numbers.size == 10
    few = stream.posterior()
    assert_same(few, fit_recording(door.recording, perception=FEW_KEPT.perception))
    states, all_kept = few.posterior.best.states, fit_recording(door.recording).posterior
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
    settings = ModelSettings(states=StateKnowledge(np.arange(2.0), sigma_m_per_sqrt_s=0.05))
    stream, updates = streamed(drawer.frames, settings)
    assert stream.posterior().posterior.kind == updates[-1].kind == "prismatic"


def test_a_stamp_that_does_not_grow_is_refused(drawer):
    stream, _ = streamed(drawer.frames[:2])
    with pytest.raises(ValueError, match="expected to grow"):
        stream.add(drawer.frames[1])
