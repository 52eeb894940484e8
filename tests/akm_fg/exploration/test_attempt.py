"""Attempts and whole explorations with a cabinet, an arm and a model that exist on paper only."""

from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import pytest

from akm_fg.errors import GraspFailed, MotionInfeasible, NoMotionObserved
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.explore import Explorer, explore
from akm_fg.exploration.explore_json import exploration_as_dict, exploration_from_dict
from akm_fg.exploration.records import Contact, Exploration
from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation
from akm_fg.perception.observed import ObservedMotion
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.records import PinholeCamera, PixelTracks, PointTracks, RgbdFrame
from akm_fg.stages import RecordingFit
from factors.joint import Joint, JointKind

CAMERA = PinholeCamera(8, 6, 10.0, 10.0, 3.5, 2.5)
NORMAL = np.array([-1.0, 0.0, 0.0])


@dataclass
class PaperCabinet:
    """Fronts side by side; those in `free` slide out. Arm, camera and truth in one.

    `slips` fronts are lost after so many metres, `away` ones are out of reach, `empty` ones have
    nothing that fingers could hold the first so many times.
    """

    free: tuple[int, ...] = ()
    slips: dict[int, float] = field(default_factory=dict)
    away: tuple[int, ...] = ()
    empty: dict[int, int] = field(default_factory=dict)
    beside_m: dict[int, float] = field(
        default_factory=dict
    )  # by which a knob is off, along the pads
    stop_m: float = 0.4  # end of the way of what slides
    state: dict[int, float] = field(default_factory=dict)
    clock: float = 0.0
    front: int | None = None
    hand: np.ndarray = field(default_factory=lambda: np.zeros(3))
    lost: bool = False
    asides: int = 0
    elsewhere_m: float = 0.0  # that something seems to go which nobody holds
    unseen_m: float = 0.002  # of the way of what slides, before the camera shows it
    tilts_m: float = 0.0  # by which the pads first give on what is rigid
    hides: bool = False  # the arm hides what it holds, until it stands aside
    led: int = 0  # stretches in which the joint led the hand
    along: np.ndarray = field(default_factory=NORMAL.copy)  # way in which what is free slides

    def contact(self, front: int) -> Contact:
        p = np.array([0.6, 0.3 * front, 0.5])
        return Contact(p, np.array([float(front), 1.0]), NORMAL, front, 0.5)

    def capture(self):
        self.clock += 0.1
        rgb, depth = np.zeros((6, 8, 3), np.uint8), np.ones((6, 8), np.float32)
        return RgbdFrame(self.clock, rgb, depth, CAMERA, gtsam.Pose3())

    def T_world_gripper(self):
        return gtsam.Pose3(gtsam.Rot3(), self.hand)

    def see(self, frame):
        pass

    def step_aside(self, frame, tick_s, unseen=False):
        self.asides, self.front = self.asides + 1, None
        yield

    def holding(self):
        return self.front is not None and not self.lost

    def grasp(self, T_world_grasp, tick_s, feel_m=0.0):
        front = round(T_world_grasp.translation()[1] / 0.3)
        if front in self.away:
            raise MotionInfeasible("the grasp is out of the arm's reach")
        yield
        if self.empty.get(front, 0) > 0:
            self.empty[front] -= 1
            raise GraspFailed("the fingers met with nothing between them")
        off_m = 0.0
        if front in self.beside_m:
            off_m = float(T_world_grasp.translation()[0]) - 0.6 - self.beside_m[front]
        if abs(off_m) > 0.006:  # squeezed out of the pads, and the hand as far to the other side
            self.hand = T_world_grasp.translation() + np.array([off_m, 0.0, 0.0])
            raise GraspFailed("the fingers met with nothing between them")
        self.front, self.lost, self.hand = front, False, T_world_grasp.translation()

    def pull(self, direction_world, distance_m, tick_s):
        yield
        if self.front not in self.free or direction_world @ self.along < 0.5:
            self.hand = self.hand + (0.001 + self.tilts_m) * direction_world
            self.tilts_m = 0.0
            return
        before = self.state.get(self.front, 0.0)
        after = min(before + distance_m, self.stop_m)
        if after > self.slips.get(self.front, np.inf):
            self.lost = True
            self.slips.pop(self.front)
            return
        self.state[self.front] = after
        self.hand = self.hand + (after - before) * self.along

    def follow(self, path, tick_s):
        way = path.T_world_gripper[-1].translation() - path.T_world_gripper[0].translation()
        length = float(np.linalg.norm(way))
        self.led += 1
        yield from self.pull(way / length, length, tick_s)


class PaperStream:
    """Says of a part what a stretch's length tells: the better the longer it was pulled."""

    def __init__(self, cabinet):
        self.cabinet, self.frames = cabinet, 0
        self.first, self.seen, self.zero = None, {}, {}

    def add(self, frame, hand=None):
        self.frames += 1
        if self.first is None:
            self.first, self.zero = frame, dict(self.cabinet.state)
        if not (self.cabinet.hides and self.cabinet.holding()):
            self.seen = dict(self.cabinet.state)

    def posterior(self):
        seen = {f: abs(q - self.zero.get(f, 0.0)) for f, q in self.seen.items()}
        seen[-1] = self.cabinet.elsewhere_m
        moved = {f: q for f, q in seen.items() if q > self.cabinet.unseen_m}
        if not moved:
            raise NoMotionObserved("nothing moved")
        fit = fit_of(max(moved.values()), self.frames, along=self.cabinet.along)
        if self.cabinet.hides and self.cabinet.holding():
            fit.posterior.best.states.mean[-1] = np.nan
        return fit


def fit_of(q: float, frames: int, vague: float = 0.002, along=NORMAL) -> RecordingFit:
    """A drawer seen to have moved by q in so many frames; its axis known to `vague` / q."""
    up = np.array([0.0, 0.0, 1.0])
    R = gtsam.Rot3(np.column_stack([up, np.cross(along, up), along]))
    T = gtsam.Pose3(R, np.array([0.6, 0.0, 0.5])).matrix()
    cov = np.zeros((6, 6))
    cov[0, 0] = cov[1, 1] = (vague / q) ** 2
    joint = JointPosterior(Joint(JointKind.PRISMATIC, T, 0.0), cov)
    mean = np.linspace(0.0, q, frames)
    states = StatePosterior("m", mean, np.full(frames, 0.001))
    best = KindPosterior(joint, states, Evidence(0.0, 0.0, 0.0, 0.0))
    report = FitReport(0.0, 4, 0, 0.0, 1.0, 1.0, 1.0, True)
    kinds = {"prismatic": 0.999, "revolute": 0.001}
    posterior = ArticulationPosterior("x", "prismatic", kinds, {"prismatic": best}, report)
    p = np.array([0.6, 0.0, 0.5]) + 0.1 * np.array([[0, 1, 0], [0, 0, 1], [0, -1, 0.0]])
    points = p[None] + mean[:, None, None] * NORMAL
    tracks = PointTracks(points, np.tile(np.eye(3) * 1e-6, (frames, 3, 1, 1)))
    seen = np.ones((frames, 3), dtype=bool)
    pixels = PixelTracks(np.zeros((frames, 3, 2)), seen, np.zeros((frames, 3, 2, 2)))
    moving = np.ones(3, dtype=bool)
    segmentation = MotionSegmentation(moving, ~moving, ~moving, 0.0, q, 1.0)
    mask = np.ones((6, 8), dtype=bool)
    return RecordingFit(ObservedMotion(tracks, pixels, segmentation, mask), posterior)


class Quiet:
    def __init__(self):
        self.looks, self.words = 0, []

    def begun(self, number, attempt):
        self.looks = 0

    def looked(self, look):
        self.looks += 1

    def stretched(self, attempt):
        pass

    def ended(self, number, attempt):
        pass

    def stage(self, words):
        self.words.append(words)


def explored(cabinet, fronts=3, so_far=None, **changes):
    config = replace(ExploreConfig(), **changes)
    explorer = Explorer(
        contacts=lambda frame: [cabinet.contact(front) for front in range(fronts)],
        grasps=lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        stream=lambda number: PaperStream(cabinet),
        config=config,
    )
    exploration = so_far or Exploration()
    explore(cabinet, cabinet, explorer, exploration, Quiet())
    return exploration


def outcomes(exploration):
    return [(a.hypothesis.contact, a.outcome) for a in exploration.attempts]


def test_the_free_front_is_found_and_pulled_until_the_joint_is_known():
    cabinet = PaperCabinet(free=(2,))
    exploration = explored(cabinet)
    assert outcomes(exploration) == [(0, "rigid"), (1, "rigid"), (2, "opened")]
    assert exploration.pulls == 3
    assert exploration.stop == "posterior"
    assert exploration.failure is None
    assert cabinet.state[2] > 0.05
    last = exploration.attempts[-1].stretches[-1]
    assert np.rad2deg(last.bounds.axis_rad) <= 1.0 or "expected" in exploration.attempts[-1].reason


def test_it_stops_no_later_than_the_task_needs():
    """The axis is known to 1 deg (95 %) at 2.45 * 0.0005 / q: after 7 cm, the third stretch."""
    cabinet = PaperCabinet(free=(0,))
    stream = PaperStream(cabinet)
    stream.posterior = lambda: fit_of(cabinet.state[0], stream.frames, vague=0.0005)
    explorer = Explorer(
        lambda frame: [cabinet.contact(0)],
        lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        lambda number: stream,
        ExploreConfig(),
    )
    exploration = Exploration()
    explore(cabinet, cabinet, explorer, exploration, Quiet())
    assert exploration.attempts[0].reason == "the joint is known as well as the task needs"
    assert cabinet.led == 2  # all but the first stretch
    assert cabinet.state[0] == pytest.approx(0.09)


def test_where_nothing_opens_it_says_so_and_not_that_something_did():
    exploration = explored(PaperCabinet(), fronts=2)
    assert not exploration.opened
    assert exploration.failure.startswith("nothing here opens (probability 0.9")
    assert exploration.pulls < 25
    assert {outcome for _, outcome in outcomes(exploration)} == {"rigid"}


def test_what_the_planner_refuses_costs_no_pull_and_is_told():
    exploration = explored(PaperCabinet(free=(1,), away=(0,)), fronts=2)
    assert outcomes(exploration) == [(0, "refused"), (1, "opened")]
    assert exploration.pulls == 1
    assert "out of the arm's reach" in exploration.attempts[0].reason


def test_an_empty_grasp_leaves_the_place_for_later():
    exploration = explored(PaperCabinet(free=(0,), empty={0: 1}), fronts=1)
    assert outcomes(exploration) == [(0, "grasp_lost"), (0, "opened")]


def test_a_knob_that_slips_out_to_a_side_is_held_where_it_must_be_within_the_attempt():
    cabinet = PaperCabinet(free=(0,), beside_m={0: -0.008})
    found = explored(cabinet, fronts=1)
    assert [a.outcome for a in found.attempts] == ["opened"]
    assert found.attempts[0].T_world_grasp.translation()[0] == pytest.approx(0.592)
    far = PaperCabinet(free=(0,), beside_m={0: -0.05})
    assert explored(far, fronts=1).attempts[0].outcome == "grasp_lost"


def test_a_lost_grip_on_what_moves_is_taken_again_within_the_attempt():
    cabinet = PaperCabinet(free=(0,), slips={0: 0.05})
    exploration = explored(cabinet, fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    assert exploration.attempts[0].regrasps == 1
    assert cabinet.state[0] > 0.05


def test_a_part_that_is_open_and_little_known_is_held_again_where_the_grip_was_lost():
    cabinet = PaperCabinet(free=(0,), slips={0: 0.07})
    exploration = explored(cabinet, fronts=1)
    (attempt,) = exploration.attempts
    assert attempt.outcome == "opened" and attempt.regrasps == 1
    assert cabinet.state[0] > 0.1  # 5 cm are open; a further stretch is expected to tell more
    assert not attempt.reason.startswith("opened, then")


def test_a_part_that_stops_short_is_not_called_opened():
    exploration = explored(PaperCabinet(free=(0,), stop_m=0.04), fronts=1, max_attempts=2)
    assert not exploration.opened
    assert outcomes(exploration)[0] == (0, "stopped")
    assert "come to its stop" in exploration.attempts[0].reason


def test_where_nothing_could_be_held_it_does_not_say_that_nothing_opens():
    """A front that moves, whose every place is out of reach."""
    exploration = explored(PaperCabinet(free=(0, 1), away=(0, 1)), fronts=2)
    assert exploration.pulls == 0
    assert exploration.failure.startswith("nothing was opened: what may open was not to be held")
    assert "opens with probability 0.75" in exploration.failure  # 1 - 0.5^2, as before


def test_attempts_end_at_their_number():
    exploration = explored(PaperCabinet(), fronts=9, max_attempts=4)
    assert exploration.pulls == 4
    assert exploration.stop == "attempts"


def test_what_is_held_is_pulled_the_other_ways_before_the_hand_lets_go():
    cabinet = PaperCabinet(free=(0,), along=np.array([0.0, -1.0, 0.0]))
    exploration = explored(cabinet, fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    attempt = exploration.attempts[0]
    assert attempt.rigid_before[0] == "outward"
    assert attempt.hypothesis.way == "left"
    assert attempt.stretches[0].travel_m == pytest.approx(0.03)  # since it was pulled this way
    assert exploration.pulls == 1
    again = exploration_from_dict(exploration_as_dict(exploration), "explore.json")
    assert again.attempts[0].rigid_before == attempt.rigid_before


def test_what_gives_a_little_and_then_no_more_is_rigid_and_is_pulled_the_other_ways():
    cabinet = PaperCabinet(free=(0,), along=np.array([0.0, -1.0, 0.0]), tilts_m=0.006)
    exploration = explored(cabinet, fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    assert exploration.attempts[0].rigid_before == ["outward"]
    assert exploration.attempts[0].hypothesis.way == "left"


def test_what_goes_with_the_hand_is_pulled_on_until_it_is_seen():
    exploration = explored(PaperCabinet(free=(0,), unseen_m=0.05), fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    assert exploration.attempts[0].stretches[0].travel_m == pytest.approx(0.06)
    never = explored(PaperCabinet(free=(0,), unseen_m=1.0), fronts=1, max_attempts=1)
    assert outcomes(never) == [(0, "grasp_lost")]
    assert never.attempts[0].unseen_m > 0.05
    again = exploration_from_dict(exploration_as_dict(never), "explore.json")
    assert again.attempts[0].unseen_m == never.attempts[0].unseen_m
    assert "went 12.0 cm and nothing was seen to move" in never.attempts[0].reason


def test_what_seems_to_go_farther_than_the_hand_is_not_what_it_holds():
    """Tracks that slide along the grain of a board, while what is held gives 5 mm."""
    cabinet = PaperCabinet(elsewhere_m=0.08, tilts_m=0.004)
    exploration = explored(cabinet, fronts=1)
    assert not exploration.opened
    assert {outcome for _, outcome in outcomes(exploration)} == {"rigid"}


def test_what_goes_with_the_hand_behind_the_arm_is_looked_at_from_aside():
    cabinet = PaperCabinet(free=(0,), hides=True)
    exploration = explored(cabinet, fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    assert exploration.attempts[0].stretches[0].travel_m == pytest.approx(0.12)
    assert exploration.attempts[0].stretches[0].state == pytest.approx(0.12)


def test_a_part_that_slipped_off_behind_the_arm_is_held_again_where_it_is():
    cabinet = PaperCabinet(free=(0,), hides=True, slips={0: 0.04})
    exploration = explored(cabinet, fronts=1)
    assert outcomes(exploration) == [(0, "opened")]
    assert exploration.attempts[0].regrasps == 1


def test_an_attempt_begins_with_what_the_arm_hides_as_the_first_looks_showed_it():
    """Two looks, and a frame in which the arm hides its right half; nothing has moved since."""
    cabinet, streams = PaperCabinet(free=(0,)), []
    whole = cabinet.capture

    def half_hidden():
        frame = whole()
        if cabinet.asides >= 2:
            frame.depth_m[:, 4:] = np.nan
        return frame

    cabinet.capture = half_hidden
    explorer = Explorer(
        lambda frame: [cabinet.contact(0)],
        lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        lambda number: streams.append(PaperStream(cabinet)) or streams[-1],
        ExploreConfig(),
    )
    explore(cabinet, cabinet, explorer, Exploration(), Quiet())
    first = streams[0].first
    assert np.isfinite(first.depth_m).all()
    assert first.stamp_s > 0.25  # its own time, not that of a look


def test_ways_in_which_a_hold_was_rigid_are_learned_and_not_pulled_again():
    exploration = explored(PaperCabinet(), fronts=1)
    ways = [(*a.rigid_before, a.hypothesis.way) for a in exploration.attempts]
    assert ways == [("outward", "left", "right")]  # of even odds that leave less than 5 %
    assert exploration.failure.startswith("nothing here opens (probability 0.9")


def test_no_frame_is_taken_while_the_hand_stands_still():
    cabinet, quiet, exploration = PaperCabinet(free=(0,)), Quiet(), Exploration()
    explorer = Explorer(
        lambda frame: [cabinet.contact(0)],
        lambda frame, contact: [gtsam.Pose3(gtsam.Rot3(), contact.p_world)],
        lambda number: PaperStream(cabinet),
        ExploreConfig(),
    )
    explore(cabinet, cabinet, explorer, exploration, quiet)
    stretches = len(exploration.attempts[0].stretches)
    assert quiet.looks == 2 + stretches  # before, held, and one a stretch; not its first tick


def test_without_adaptive_termination_one_attempt_is_all():
    exploration = explored(PaperCabinet(free=(2,)), adaptive_termination=False)
    assert len(exploration.attempts) == 1


def test_the_papers_way_pulls_once_and_compares_with_its_threshold():
    cabinet = PaperCabinet(free=(1,))
    exploration = explored(cabinet, fronts=2, belief="suppression", stop="threshold")
    assert outcomes(exploration) == [(0, "rigid"), (1, "opened")]
    assert cabinet.state[1] == pytest.approx(0.10)
    assert exploration.stop == "threshold"


def test_what_was_tried_comes_back_from_its_file_and_is_not_tried_again():
    first = explored(PaperCabinet(free=(2,)), max_attempts=1)
    assert outcomes(first) == [(0, "rigid")]
    again = exploration_from_dict(exploration_as_dict(first), "explore.json")
    assert exploration_as_dict(again)["attempts"] == exploration_as_dict(first)["attempts"]
    exploration = explored(PaperCabinet(free=(2,)), so_far=again)
    assert outcomes(exploration) == [(0, "rigid"), (1, "rigid"), (2, "opened")]


def test_every_stretch_says_what_was_expected_of_the_next():
    exploration = explored(PaperCabinet(free=(0,)), fronts=1)
    stretches = exploration.attempts[0].stretches
    assert len(stretches) > 1
    for stretch in stretches:
        assert stretch.expected_next.axis_rad < stretch.bounds.axis_rad
    rows = exploration_as_dict(exploration)["attempts"][0]["stretches"]
    assert set(rows[0]) >= {"travel_m", "kind", "axis_sd_deg", "pivot_sd_m", "expected_next"}
