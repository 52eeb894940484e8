"""Decisions on the way to a target, with an arm and a camera that exist on paper only."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.manipulation.config import ManipulateConfig
from akm_fg.manipulation.manipulate import Manipulator
from akm_fg.manipulation.records import Goal, Manipulation
from akm_fg.manipulation.watch import Watch
from akm_fg.model.records import StateLimits
from akm_fg.records import PinholeCamera, RgbdFrame
from akm_fg.relocalization.records import StateBelief
from tests.akm_fg.manipulation.conftest import GRASP

CAMERA = PinholeCamera(4, 3, 4.0, 4.0, 1.5, 1.0)
CONFIG = ManipulateConfig(tolerance_m=0.005)


class World:
    """A drawer that comes along with the hand, by -x; what goes wrong is said beforehand."""

    def __init__(self, state, short=0.0, sd=0.001, stop=np.inf):
        self.state, self.clock, self.sd, self.stop, self.short = state, 0.0, sd, stop, short
        self.held, self.seen, self.hidden, self.lost = False, True, False, 0
        self.slips_at, self.blocked, self.reach, self.way = None, [], 1.0, None
        self.log, self.updates, self.felt = [], [], []

    def capture(self):
        self.clock += 0.1
        depth = np.ones((3, 4), np.float32)
        return RgbdFrame(self.clock, np.zeros((3, 4, 3), np.uint8), depth, CAMERA, gtsam.Pose3())

    def T_world_gripper(self):
        return gtsam.Pose3(GRASP.rotation(), GRASP.translation() - [self.state, 0.0, 0.0])

    def holding(self):
        return self.held

    def see(self, frame):
        self.log.append("see")

    def step_aside(self, frame, tick_s, unseen=False):
        self.held = False
        self.hidden = False
        self.log.append("aside")
        yield

    def reachable(self, T, onward=()):
        return self.reach

    def can_follow(self, poses):
        return len(poses) if self.way is None else self.way

    def grasp(self, T, tick_s, feel_m=0.0, onward=()):
        self.log.append("grasp")
        if self.blocked:
            raise self.blocked.pop(0)
        self.held = True
        yield

    def close_and_reach(self, T, tick_s, onward=()):
        self.log.append("close")
        yield

    def relax(self, tick_s):
        self.log.append("relax")
        yield

    def pull(self, direction, distance_m, tick_s):
        self.log.append("pull")
        self.state += -direction[0] * distance_m
        yield

    def follow(self, path, tick_s):
        x = np.array([T.translation()[0] for T in path.T_world_gripper])
        # Where it comes to rest: short of where it was sent, as friction holds it back.
        goes = (x[0] - x[-1]) - np.sign(x[0] - x[-1]) * self.short
        self.log.append(("follow", round(float(goes), 4)))
        begin, pushes = self.state, not self.held
        for share in np.linspace(0.0, 1.0, 12)[1:]:
            self.state = min(begin + share * goes, self.stop)
            if self.slips_at is not None and self.state > self.slips_at:
                self.held, self.slips_at = False, None
                self.log.append("slip")
            yield
            if not self.held and not pushes:
                return


class Follower:
    """Tells the true state, as far as it is said to."""

    def __init__(self, world):
        self.world = world

    def update(self, frame, hand=None, commanded=None, felt=None):
        world = self.world
        world.updates.append(hand)
        if world.lost > 0:
            world.lost -= 1
            return StateBelief(frame.stamp_s, "lost", None, None, None, 0.0, False, None,
                               reason="the part is not seen at any state")  # fmt: skip
        seen = world.seen and not world.hidden
        sd = world.sd if seen else 0.02
        world.felt += [] if felt is None else [felt]
        return StateBelief(frame.stamp_s, "tracking", world.state, sd, 0.0, 1.0, seen, 0.1)


class Quiet:
    def looked(self, look):
        pass

    def decided(self, decision):
        pass


@pytest.fixture
def moved(paper_part):
    def _moved(world, target, config=CONFIG, fresh=None, follower=Follower, limits=None, **of_part):
        part = replace(paper_part("prismatic", **of_part), limits=limits)
        run, goal = Manipulation(), Goal(target, config.tolerance_m)
        watch = Watch(world, world, follower(world), part, goal, run, Quiet(), config)
        Manipulator(world, watch, part, goal, run, config, fresh).run()
        return run

    return _moved


def actions(run):
    return [decision.action for decision in run.decisions]


def test_it_looks_holds_moves_and_ends_with_a_probability(moved):
    world = World(0.12)
    run = moved(world, 0.32)
    assert actions(run) == ["look", "grasp", "move", "end"]
    assert run.failure is None
    assert world.state == pytest.approx(0.32)
    assert run.probability > 0.95
    assert run.rounds == 1


def test_a_hand_that_has_closed_tells_the_state_to_what_it_feels_for(moved):
    world = World(0.12)
    moved(world, 0.32)
    ((q, sd),) = world.felt
    assert q == pytest.approx(0.12, abs=1e-9)
    assert 1.96 * sd == pytest.approx(CONFIG.hold.most_feel_m)


def test_a_part_that_is_there_is_not_touched(moved):
    world = World(0.32)
    run = moved(world, 0.32)
    assert actions(run) == ["look", "end"]
    assert "grasp" not in world.log


def test_what_friction_leaves_short_is_made_up_for(moved):
    world = World(0.12, short=0.008)
    run = moved(world, 0.32)
    assert run.failure is None
    assert run.rounds == 2
    # The second move is sent as much farther as the first fell short.
    assert world.log[-1] == ("follow", pytest.approx(0.008, abs=1e-3))


def test_a_vague_axis_makes_short_moves(moved):
    world = World(0.02)
    run = moved(world, 0.38, axis_sd=0.03)
    bounds = [d.foreseen["across_m"] for d in run.decisions if d.action == "move"]
    assert run.failure is None
    assert run.rounds >= 2
    assert max(bounds) <= CONFIG.move.across_m
    blind = moved(World(0.02), 0.38, replace(CONFIG, planner="blind"), axis_sd=0.03)
    assert [d.foreseen for d in blind.decisions if d.action == "move"] == [{}] * blind.rounds
    assert blind.rounds == 4  # steps of 10 cm
    # It does not weigh the covariance, and claims nothing of it.
    whys = [d.why for d in blind.decisions if d.action == "move"]
    assert all("whatever the covariance is" in why for why in whys)
    assert "a step of fixed length" in whys[0] and "the rest of the way" in whys[-1]


def test_a_joint_that_nobody_knows_is_left_to_lead(moved):
    world = World(0.02)
    run = moved(world, 0.38, fresh=lambda frame, p, normal: [GRASP], axis_sd=1.0)
    assert "pull" in actions(run)
    assert "pull" in world.log


def test_a_lost_grip_is_taken_anew(moved):
    world = World(0.05)
    world.slips_at = 0.15
    run = moved(world, 0.3)
    assert run.failure is None
    assert run.regrasps == 1
    assert world.log.count("grasp") == 2
    assert actions(run).count("look") == 2  # where it is now is not taken for known


def test_a_stop_met_early_ends_the_run_and_is_kept(moved):
    world = World(0.05, stop=0.2)
    run = moved(world, 0.35)
    assert "does not go on from 20.0 cm" in run.failure
    assert run.probability < 0.05
    assert run.stop.opening
    assert run.stop.state == pytest.approx(0.2)
    assert "relax" in world.log


def test_a_stop_earlier_than_the_model_tells_ends_the_run_and_is_the_stop_from_then_on(moved):
    told = StateLimits(0.0, 0.4, 1e-3)
    run = moved(World(0.05, stop=0.2), 0.35, limits=told)
    assert "does not go on from 20.0 cm" in run.failure
    assert run.stop.opening and run.stop.state == pytest.approx(0.2)
    assert run.rounds == 1  # it does not try again what did not give


def test_a_short_move_that_presses_and_gets_nowhere_has_met_a_stop(moved):
    world = World(0.2, stop=0.2)
    run = moved(world, 0.25)
    assert "does not go on from 20.0 cm" in run.failure
    assert run.rounds == 1
    near = moved(World(0.2, stop=0.2), 0.22)  # as friction may, which the next move makes up for
    assert "does not go on from 20.0 cm" in near.failure
    assert near.rounds == 2


def test_an_arm_at_its_end_takes_another_grasp(moved):
    world = World(0.05)
    calls = []

    def can_follow(poses):
        calls.append(len(poses))
        return 0 if len(calls) == 1 else len(poses)

    world.can_follow = can_follow
    run = moved(world, 0.3)
    assert run.failure is None
    assert run.regrasps == 1
    assert actions(run).count("grasp") == 2


def test_part_of_the_way_is_gone_where_the_arm_reaches_no_farther(moved):
    world = World(0.0)
    world.way = 6  # of 12
    run = moved(world, 0.2)
    first = next(d for d in run.decisions if d.action == "move")
    assert first.commanded == pytest.approx(0.1)
    assert "no farther" in first.why


def test_a_part_that_is_not_found_is_not_moved(moved):
    world = World(0.1)
    world.lost = 1000
    run = moved(world, 0.3)
    assert "not found: the part is not seen at any state" in run.failure
    assert run.probability == 0.0
    assert "grasp" not in world.log


def test_a_part_lost_on_the_way_is_looked_for_before_anything_moves(moved):
    world = World(0.1)

    class Blocked(Follower):
        def update(self, frame, hand=None, commanded=None, felt=None):
            if ("follow", 0.2) in world.log and "blocked" not in world.log:
                world.log.append("blocked")
                world.lost = 30
            if world.log[-1] == "aside":
                world.lost = 0
            return super().update(frame, hand, commanded, felt)

    run = moved(world, 0.3, follower=Blocked)
    assert run.failure is None
    assert actions(run).count("look") == 2


def test_a_state_too_unsure_to_end_asks_for_a_clear_look(moved):
    world = World(0.1)
    follow = world.follow

    def hiding(path, tick_s):
        yield from follow(path, tick_s)
        world.hidden = True  # the hand stands before it; stepping aside shows it

    world.follow = hiding
    run = moved(world, 0.3)
    assert run.failure is None
    assert actions(run)[-2:] == ["look", "end"]


class Moved(Follower):
    """The part is not where it was believed: for some frames nobody sees it, and the belief widens.

    As the filter has it, which gives a belief up only after frames that contradict it.
    """

    frames = 2

    def update(self, frame, hand=None, commanded=None, felt=None):
        world = self.world
        belief = super().update(frame, hand, commanded, felt)
        if "grasp" in world.log and world.log.count("aside") > 1 and self.frames > 0:
            self.frames -= 1
            return replace(belief, mean=0.1, sd=0.25, seen=False,
                           reason="the part is seen at another state")  # fmt: skip
        return belief


def test_a_part_that_no_frame_has_shown_since_it_is_held_is_looked_at_before_the_end(moved):
    """The arm hides it from the hold on, and its state is believed to 2 mm all the same."""
    world = World(0.30)

    def hiding(T, tick_s, feel_m=0.0, onward=()):
        yield from World.grasp(world, T, tick_s, feel_m, onward)
        world.hidden = True

    class Sure(Follower):
        def update(self, frame, hand=None, commanded=None, felt=None):
            belief = super().update(frame, hand, commanded, felt)
            return belief if belief.seen else replace(belief, sd=0.002)

    world.grasp = hiding
    run = moved(world, 0.05, follower=Sure)
    whys = [decision.why for decision in run.decisions]
    assert run.failure is None and world.state == pytest.approx(0.05, abs=0.005)
    assert "no frame has shown the part since it is held" in whys[-2:]
    assert run.belief.seen


def test_a_part_pushed_while_the_arm_reached_for_it_is_looked_for_until_a_frame_shows_it(moved):
    world = World(0.1)
    grasp = world.grasp

    def met_nothing(T, tick_s, feel_m=0.0, onward=()):
        if "grasp" not in world.log:
            world.log.append("grasp")
            world.state = 0.25  # pushed meanwhile
            raise GraspFailed("the fingers met with nothing between them")
        yield from grasp(T, tick_s, feel_m, onward)

    world.grasp = met_nothing
    run = moved(world, 0.3, follower=Moved)
    assert run.failure is None and world.state == pytest.approx(0.3)
    moves = [d for d in run.decisions if d.action in ("grasp", "move", "push")]
    assert all(d.state_sd < 0.01 for d in moves)  # nothing moves by a state that nobody saw


def test_a_part_that_clear_looks_do_not_show_is_neither_held_nor_pushed(moved):
    class Never(Moved):
        frames = 1000

    world = World(0.32)
    world.blocked = [GraspFailed("the fingers met with nothing between them")]
    run = moved(world, 0.12, follower=Never)
    assert "not found: the part is seen at another state" in run.failure
    assert world.log.count("grasp") == 1 and "push" not in actions(run)


class Outlined(Follower):
    """By its outline until it has been moved into view: 12 mm, and no frame shows its surface."""

    def update(self, frame, hand=None, commanded=None, felt=None):
        belief = super().update(frame, hand, commanded, felt)
        if self.world.state > 0.2:
            return belief
        return replace(belief, sd=0.012, seen=False, by_outline=True)


def test_a_part_that_its_outline_tells_is_held_at_once_and_brought_into_view(moved):
    world = World(0.1)
    run = moved(world, 0.3, follower=Outlined)
    assert run.failure is None and world.state == pytest.approx(0.3)
    assert actions(run)[:2] == ["look", "grasp"]
    assert sum(d.action == "look" for d in run.decisions) == 1
    # One frame tells it: no further ones are waited for.
    assert run.decisions[1].looks == 1


def test_an_outline_alone_ends_nothing(moved):
    world = World(0.1)
    run = moved(world, 0.101, follower=Outlined)
    assert run.failure is not None and run.probability < 0.95


def test_holds_that_fail_are_counted_and_end(moved):
    world = World(0.1)
    world.blocked = [GraspFailed("the fingers met with nothing between them")]
    run = moved(world, 0.3)
    assert run.failure is None
    assert world.log.count("grasp") == 2
    world = World(0.1)
    world.blocked = [GraspFailed("met with nothing")] * 9
    run = moved(world, 0.3)
    assert run.failure.startswith("met with nothing")
    assert world.log.count("grasp") == CONFIG.hold.most_failures
    world = World(0.1)
    world.blocked = [MotionInfeasible("no free way")] * 9
    assert moved(world, 0.3).failure.startswith("no free way")


def test_rounds_end_with_the_probability_it_has(moved):
    world = World(0.1, sd=0.001)
    world.follow = lambda path, tick_s: iter([None])  # nothing moves, the hand neither
    run = moved(world, 0.3)
    assert run.rounds <= CONFIG.max_rounds
    assert "probability 0.00" in run.failure


class AtItsBase(World):
    """A drawer whose handle is out of the arm's reach where it stands far open."""

    def reachable(self, T, onward=()):
        if self.state > 0.2 and T.rotation().matrix()[2, 2] > -0.9:
            raise MotionInfeasible("the grasp is out of the arm's reach")
        return 1.0


def test_a_drawer_at_the_robots_base_is_moved_by_its_edge_and_then_by_its_handle(moved):
    world = AtItsBase(0.35)
    run = moved(world, 0.05)
    assert run.failure is None and world.state == pytest.approx(0.05)
    assert [hold.by_edge for hold in run.holds] == [True, False]
    by_edge, by_handle = (d.commanded for d in run.decisions if d.action == "move")
    assert by_edge >= CONFIG.hold.board.room_m and by_handle == pytest.approx(0.05)


def refused(times=9):
    return [MotionInfeasible("no free way")] * times


def test_what_cannot_be_held_is_pushed_towards_closed_and_looked_at(moved):
    world = World(0.32)
    world.blocked = refused()
    run = moved(world, 0.12)
    assert [action for action in actions(run) if action != "grasp"] == [
        "look", "push", "look", "end",
    ]  # fmt: skip
    push = next(d for d in run.decisions if d.action == "push")
    assert "cannot be held" in push.why and "no free way" in push.why
    assert push.commanded == pytest.approx(0.12)
    assert run.failure is None and run.rounds == 1 and run.probability > 0.95
    assert world.state == pytest.approx(0.12)
    assert world.log.index("close") < world.log.index(("follow", pytest.approx(-0.2)))


def test_what_cannot_be_held_is_not_pushed_open_nor_by_the_blind_baseline(moved):
    for target, config in ((0.42, CONFIG), (0.12, replace(CONFIG, planner="blind"))):
        world = World(0.32)
        world.blocked = refused()
        run = moved(world, target, config)
        assert "push" not in actions(run)
        assert run.failure is not None and "no free way" in run.failure
