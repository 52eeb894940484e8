"""The closed loop's decisions, with an arm and a camera that exist on paper only."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.closed_loop import (
    Episode,
    EpisodeConfig,
    Look,
    Task,
    probability_within,
    run_episode,
)
from akm_fg.errors import GraspFailed, NoMotionObserved
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.records import PinholeCamera, RgbdFrame
from akm_fg.stages import RecordingFit
from factors.joint import Joint, JointKind

CAMERA = PinholeCamera(4, 3, 4.0, 4.0, 1.5, 1.0)


class PaperDrawer:
    """A drawer along z whose hand slips a share of every commanded move."""

    def __init__(self, slip=0.0, fails=None, lost_after=None):
        self.state, self.clock, self.slip, self.fails = 0.0, 0.0, slip, fails
        self.moves, self.lost_after = 0, lost_after

    def capture(self):
        self.clock += 0.1
        rgb = np.zeros((3, 4, 3), np.uint8)
        depth = np.ones((3, 4), np.float32)
        return RgbdFrame(self.clock, rgb, depth, CAMERA, gtsam.Pose3())

    def T_world_gripper(self):
        return gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, self.state]))

    def holding(self):
        return self.lost_after is None or self.moves < self.lost_after

    def see(self, frame):
        self.seen = frame

    def grasp(self, T_world_grasp, tick_s, feel_m=0.0):
        assert self.seen.stamp_s > 0.0  # shown before it moves
        if self.fails:
            raise self.fails
        yield

    def pull(self, direction_world, distance_m, tick_s):
        self.state += distance_m
        yield

    def follow(self, path, tick_s):
        self.moves += 1
        start = path.T_world_gripper[0].translation()[2]
        wanted = path.T_world_gripper[-1].translation()[2] - start
        self.state += wanted * (1 - self.slip)
        yield


class Quiet:
    def __init__(self):
        self.frames, self.stages = 0, []

    def looked(self, look):
        self.frames += 1

    def stage(self, words):
        self.stages.append(words)


class PaperStream:
    """Counts frames, and says of so many what `fit` says."""

    def __init__(self, fit):
        self.frames, self.fit = [], fit

    def add(self, frame, hand=None):
        self.frames.append(frame)

    def posterior(self):
        return self.fit(len(self.frames))


@pytest.fixture
def run():
    def _run(world, target=0.2, state_sd=0.001, kind="prismatic", fit=None, mean_of=float):
        def known(n):
            mean, sd = np.full(n, mean_of(world.state)), np.full(n, state_sd)
            joint = JointPosterior(Joint(kind, np.eye(4), 0.0), np.eye(6) * 1e-6)
            best = KindPosterior(joint, StatePosterior("m", mean, sd), Evidence(0.0, 0.0, 0.0, 0.0))
            report = FitReport(0.0, 1, 0, 0.0, 1.0, 1.0, 1.0, True)
            posterior = ArticulationPosterior("x", kind, {kind: 1.0}, {kind: best}, report)
            return RecordingFit(None, posterior)

        episode, observer = Episode(), Quiet()
        task = Task("x", gtsam.Pose3(), np.array([0.0, 0.0, 1.0]), {"prismatic": target})
        stream = PaperStream(fit or known)
        run_episode(world, world, task, episode, observer, EpisodeConfig(), stream)
        return episode, observer

    return _run


def test_probability_within_is_the_normal_integral_over_the_tolerance():
    assert_allclose(probability_within(0.0, 1.0, 0.0, 1.96), 0.95, atol=1e-3)
    assert_allclose(probability_within(0.5, 1.0, 0.0, 1e9), 1.0)
    assert probability_within(1.0, 1e-6, 0.0, 0.5) == 0.0


def test_a_drawer_that_follows_is_at_its_target_after_one_round(run):
    world = PaperDrawer()
    episode, observer = run(world)
    assert episode.failure is None
    assert [r.commanded for r in episode.rounds] == [None, 0.2]
    assert_allclose(world.state, 0.2, atol=1e-6)
    assert episode.rounds[-1].p_within_tolerance > 0.95
    assert observer.frames == len(episode.looks)
    assert episode.closed_loop_frame is not None


def test_looking_again_makes_up_for_slip(run):
    world = PaperDrawer(slip=0.5)
    episode, _ = run(world, target=0.3)
    assert episode.failure is None
    assert len(episode.rounds) > 2
    assert abs(world.state - 0.3) < 0.01


def test_a_vague_belief_does_not_count_as_reached(run):
    episode, _ = run(PaperDrawer(), state_sd=0.02)
    assert "not sure of the target after 5 rounds" in episode.failure


def test_an_episode_is_done_at_95_percent_and_not_before(run):
    """Two-sided 95 % of a normal lies within 1.96 standard deviations; the tolerance is 1 cm."""
    episode, _ = run(PaperDrawer(), state_sd=0.01 / 1.90)  # 94.3 %
    assert "not sure of the target after 5 rounds" in episode.failure
    episode, _ = run(PaperDrawer(), state_sd=0.01 / 2.02)  # 95.7 %
    assert episode.failure is None and len(episode.rounds) == 2


def test_a_lost_grip_ends_the_episode_with_its_cause(run):
    episode, _ = run(PaperDrawer(slip=0.9, lost_after=1), target=0.3)
    assert episode.failure == "the gripper lost the part"


def test_a_failed_grasp_is_told_and_leaves_no_rounds(run):
    episode, _ = run(PaperDrawer(fails=GraspFailed("the fingers met with nothing between them")))
    assert "nothing between" in episode.failure
    assert episode.rounds == []


def test_a_kind_without_a_target_is_a_failure_not_a_crash(run):
    episode, _ = run(PaperDrawer(), kind="revolute")
    assert "seems revolute" in episode.failure


def test_no_motion_is_told(run):
    def fit(frames):
        raise NoMotionObserved("x: nothing moved")

    episode, _ = run(PaperDrawer(), fit=fit)
    assert episode.failure == "x: nothing moved"


def test_a_part_that_is_not_seen_at_the_end_is_said_to_be_lost(run):
    episode, _ = run(PaperDrawer(), state_sd=np.nan, mean_of=lambda state: np.nan)
    assert episode.failure == "the part is not seen in the last frame"
    assert episode.rounds == []


@pytest.mark.parametrize(
    ("kind", "within", "beyond"), [("revolute", 1.4, 1.6), ("helical", 1.4, 1.6)]
)
def test_what_turns_may_be_one_and_a_half_degrees_off_and_what_slides_a_centimetre(
    kind, within, beyond
):
    config = EpisodeConfig()
    assert np.deg2rad(within) < config.tolerance(JointKind(kind)) < np.deg2rad(beyond)
    assert config.tolerance(JointKind.PRISMATIC) == pytest.approx(0.01)


def test_a_moment_is_looked_at_once_and_the_stream_hears_whether_the_hand_holds():
    """The clock goes on with motions alone; after each the loop looks again, at the same moment."""

    class Clocked(PaperDrawer):
        def capture(self):
            return replace(super().capture(), stamp_s=self.time_s)

        def pull(self, direction_world, distance_m, tick_s):
            for _ in range(3):
                self.time_s += tick_s
                self.state += distance_m / 3
                yield

        def holding(self):
            return self.time_s > 0.2

    class Listening(PaperStream):
        def add(self, frame, hand=None):
            super().add(frame)
            self.hands = [*getattr(self, "hands", []), hand]

    world = Clocked()
    world.time_s = 0.01

    def fit(frames):
        raise NoMotionObserved("x: nothing moved")

    stream, episode = Listening(fit), Episode()
    task = Task("x", gtsam.Pose3(), np.array([0.0, 0.0, 1.0]), {"prismatic": 0.2})
    run_episode(world, world, task, episode, Quiet(), EpisodeConfig(), stream)
    stamps = [look.frame.stamp_s for look in episode.looks]
    np.testing.assert_allclose(stamps, [0.01, 0.16, 0.31, 0.46])
    assert [frame.stamp_s for frame in stream.frames] == stamps
    assert [hand.holding for hand in stream.hands] == [False, False, True, True]
    z = [hand.T_world_gripper.translation()[2] for hand in stream.hands]
    np.testing.assert_allclose(z, np.array([0, 1, 2, 3]) * EpisodeConfig().pull_m / 3)


def test_an_episode_works_on_depth_that_a_recording_can_hold(run):
    world = PaperDrawer()
    real = world.capture

    def capture():
        frame = real()
        return replace(frame, depth_m=frame.depth_m * np.float32(1.00003))

    world.capture = capture
    episode, _ = run(world)
    assert {float(d) for look in episode.looks for d in look.frame.depth_m.flat} == {1.0}


@pytest.mark.parametrize(
    ("holding", "expected"),
    [
        ("", None),
        ("..", None),
        ("xx", (0, 1)),
        ("xx..", (0, 1)),
        (".xxx.", (1, 3)),
        ("x..xx", (0, 0)),
    ],
)
def test_grasp_frames_are_the_first_stretch_in_which_the_gripper_holds(holding, expected):
    frame = PaperDrawer().capture()
    looks = [Look(frame, gtsam.Pose3(), mark == "x") for mark in holding]
    assert Episode(looks).grasp_frames == expected
