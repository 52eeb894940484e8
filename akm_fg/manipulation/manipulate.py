"""From any state to a target: find the part, hold it, move as far as its covariance bears, look.

find -> [P(within tolerance) >= confidence? -> hold -> move -> look] ... -> end, with a probability

Knows pictures, joint angles and whether something is between the fingers, and nothing else.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import gtsam
import numpy as np

from akm_fg.arm.motion.reaching import standoff
from akm_fg.arm.motion.time_law import duration_s
from akm_fg.closed_loop import probability_within
from akm_fg.errors import AkmError, GraspFailed, MotionInfeasible, TracksLost
from akm_fg.exploration.processor_time import taking
from akm_fg.grasping.next_try import NextTry
from akm_fg.interfaces import Arm
from akm_fg.manipulation.carried_grasps import (
    ChosenGrasp,
    FreshGrasps,
    choose_grasp,
    not_so_deep,
    room_for,
    way_of,
)
from akm_fg.manipulation.config import ManipulateConfig
from akm_fg.manipulation.felt_state import felt_state
from akm_fg.manipulation.pushing import choose_push
from akm_fg.manipulation.records import Goal, Hold, Manipulation, Stop
from akm_fg.manipulation.watch import Watch
from akm_fg.model.records import ModelPart
from akm_fg.planning.move_length import Move, next_move
from akm_fg.planning.opening_path import plan_opening

log = logging.getLogger(__name__)


class Manipulator:
    """Moves one part with an arm, under a camera.

    Args:
        arm: holds and moves.
        watch: sees the part, and writes down what is decided.
        part: of the model.
        goal: where it should be.
        run: is filled as things happen, and stays valid when this is interrupted.
        config: tuning.
        fresh: grasps as they are seen; None: only those that the part's contacts tell.
    """

    def __init__(
        self,
        arm: Arm,
        watch: Watch,
        part: ModelPart,
        goal: Goal,
        run: Manipulation,
        config: ManipulateConfig | None = None,
        fresh: FreshGrasps | None = None,
    ) -> None:
        self._arm, self._watch, self._part, self._goal, self._run = arm, watch, part, goal, run
        self._config, self._fresh = config or ManipulateConfig(), fresh
        self._failed_holds = 0
        self._short_m = 0.0  # of where the hand was sent, by friction: the next move makes it up
        self._lost_grasps: list[gtsam.Pose3] = []
        self._next_try = NextTry()

    def run(self) -> None:
        """The whole; `failure` of the run says in one line why the target was not reached."""
        run, config = self._run, self._config
        try:
            if self._arm.holding():
                self._watch.look()
            if self._watch.state() is None:
                self._watch.look_clear("where the part is, is not known")
            while not self._done():
                if run.rounds >= config.max_rounds:
                    raise MotionInfeasible(
                        f"not sure of the target after {config.max_rounds} moves"
                    )
                self._next()
        except (GraspFailed, MotionInfeasible, TracksLost) as error:
            self._watch.decide("end", str(error))
            run.probability = run.decisions[-1].probability
            run.failure = f"{error} (probability {run.probability:.2f} of being within tolerance)"

    def _done(self) -> bool:
        """Whether the part is within tolerance, as sure as it is asked."""
        q, sd = self._watch.known()
        goal, run = self._goal, self._run
        run.probability = probability_within(q, sd, goal.state, goal.tolerance)
        if run.probability >= self._config.confidence:
            if not self._watch.seen_held:  # what the hand was told before it took hold may be old
                self._watch.look_clear("no frame has shown the part since it is held")
                return self._done()
            self._watch.decide("end", "the part is where it should be")
            return True
        best = probability_within(goal.state, sd, goal.state, goal.tolerance)
        blurred = best < self._config.confidence
        if blurred and abs(q - goal.state) <= goal.tolerance:
            # No move makes it surer: only a look does.
            self._watch.look_clear("the state is not sure enough to end")
            q, sd = self._watch.known()
            run.probability = probability_within(q, sd, goal.state, goal.tolerance)
            if run.probability < self._config.confidence:
                raise MotionInfeasible("a clear look leaves the state as unsure as it was")
            self._watch.decide("end", "a clear look shows the part where it should be")
            return True
        return False

    def _next(self) -> None:
        """One move, with a hold taken before it where there is none; where none is had, a push."""
        if not self._arm.holding():
            try:
                self._take_hold()
            except (GraspFailed, MotionInfeasible) as error:
                return self._push(error)
        q, sd = self._watch.known()
        blind = self._config.planner == "blind"
        if not (blind or self._watch.seen() or self._watch.borne_unseen()):
            return self._watch.look_clear(
                "nobody sees the part, and its state is not known to the hand"
            )
        move = self._blind_move(q) if blind else self._borne_move(q, sd)
        if move is None:
            return self._pull_on(q)
        within = move if blind else self._within_reach(q, move)
        if within is None:
            return self._hold_otherwise("the arm gets no farther with this grasp")
        self._move(q, within)

    def _push(self, unheld: AkmError) -> None:
        """What cannot be held may be pushed, where the way to the target goes into its front.

        Raises:
            GraspFailed, MotionInfeasible: `unheld`, where that leads nowhere either.
        """
        q, _ = self._watch.known()
        wanted, config = self._goal.state, self._config
        if config.planner == "blind" or not self._watch.borne_unseen():
            raise unheld
        try:
            with taking(self._run.time_s, "plan"):
                T, reach = choose_push(self._arm, self._part, q, wanted, config.push, config.hold)
            self._watch.decide("push", f"cannot be held ({unheld})", wanted, reach=reach)
            onward = way_of(self._part, T, q, wanted, config.hold)
            before = standoff(T, config.push.before_m)
            with taking(self._run.time_s, "reach"):
                for _ in self._arm.close_and_reach(before, config.tick_s, onward):
                    pass
        except (GraspFailed, MotionInfeasible) as error:
            log.info("not pushed either: %s", error)
            raise unheld from error
        self._run.rounds += 1
        share = self._arm.can_follow(onward) / len(onward)
        path = plan_opening(self._part.joint, T, q, q + share * (wanted - q), config.push.hand)
        with taking(self._run.time_s, "move"):
            for _ in self._arm.follow(path, config.tick_s):
                self._watch.look()
        self._watch.look_clear("what was pushed may be anywhere on its way")

    def _borne_move(self, q: float, sd: float) -> Move | None:
        belief = self._run.belief
        watched = belief is not None and belief.seen
        goal, config = self._goal, self._config
        hand = self._arm.T_world_gripper()
        return next_move(
            self._part.joint, hand, q, sd, goal.state, goal.tolerance, watched, config.move
        )

    def _within_reach(self, q: float, move: Move) -> Move | None:
        """The move, cut where the arm does not get farther; None where it gets nowhere."""
        hold = self._config.hold
        poses = way_of(self._part, self._arm.T_world_gripper(), q, move.q_end, hold)
        board = self._run.holds[-1].board if self._run.holds else None
        room = round(len(poses) * room_for(self._part, board, q, move.q_end, hold))
        reached = min(self._arm.can_follow(poses), room)
        if reached == len(poses):
            return move
        if reached == 0:
            return None
        end = q + (move.q_end - q) * reached / len(poses)
        return Move(end, "reach", move.foreseen)

    def _blind_move(self, q: float) -> Move:
        """A fixed step of the hand, whatever is known: the baseline."""
        joint, hand = self._part.joint.joint, self._arm.T_world_gripper()
        lever = float(np.linalg.norm(joint.velocity(hand.translation())))
        step = self._config.blind_step_m / max(lever, 1e-3)
        left = self._goal.state - q
        if abs(left) <= step:
            return Move(self._goal.state, "rest", {})
        return Move(q + float(np.sign(left)) * step, "step", {})

    def _move(self, q: float, move: Move) -> None:
        run, config = self._run, self._config
        run.rounds += 1
        self._watch.decide("move", _WHY[move.bound], move.q_end, move.foreseen)
        hand = self._arm.T_world_gripper()
        joint = self._part.joint.joint
        onward = float(np.sign(move.q_end - q))
        lever = max(float(np.linalg.norm(joint.velocity(hand.translation()))), 1e-3)
        sent = move.q_end + onward * self._short_m / lever
        path = plan_opening(self._part.joint, hand, q, sent, config.hand)
        stuck = self._followed(self._arm.follow(path, config.tick_s), duration_s(path))
        if not self._arm.holding():
            self._hold_otherwise("the grip was lost")
            return
        end, here = (
            T.translation() for T in (path.T_world_gripper[-1], self._arm.T_world_gripper())
        )
        way = joint.velocity(end) * onward
        along = way / max(float(np.linalg.norm(way)), 1e-6)
        gap_m, went_m = float(along @ (end - here)), float(along @ (here - hand.translation()))
        most = 2.0 * self._goal.tolerance * lever
        # What is sent a little way has come to rest before it counts as stuck. None presses harder
        # than one that is sent on by the most already, or has a spring's way before it.
        presses = self._short_m >= _ALL * most or gap_m >= config.pressed_m
        if stuck or (presses and went_m < gap_m / 4 and self._off_target()):
            self._met_stop(q, move.q_end)
        self._short_m = float(np.clip(gap_m, 0.0, most))

    def _off_target(self) -> bool:
        return abs(self._watch.known()[0] - self._goal.state) > self._goal.tolerance

    def _followed(self, motion: Iterator[None], duration_s: float) -> bool:
        """Watch a motion to its end; True where it was ended since the hand did not get on."""
        config = self._config
        trail: list[np.ndarray] = []
        ticks = 0
        while True:
            with taking(self._run.time_s, "move"):
                more = next(motion, _DONE) is not _DONE
            self._watch.look()
            if not more:
                return False
            ticks += 1
            if not self._arm.holding():
                self._relax()
                return False
            trail.append(self._arm.T_world_gripper().translation())
            still = len(trail) > config.stuck_ticks and (
                np.linalg.norm(trail[-1] - trail[-1 - config.stuck_ticks]) < config.stuck_m
            )
            if still and ticks * config.tick_s < duration_s:
                self._relax()
                return True

    def _relax(self) -> None:
        with taking(self._run.time_s, "move"):
            for _ in self._arm.relax(self._config.tick_s):
                pass

    def _met_stop(self, q_from: float, q_to: float) -> None:
        """The part did not go on: it has come to its stop, or jams."""
        q, sd = self._watch.known()
        closed = self._part.closed_state
        opening = abs(q_to - closed) > abs(q_from - closed)
        self._run.stop = Stop(q, sd, opening)
        goal = self._goal
        self._run.probability = probability_within(q, sd, goal.state, goal.tolerance)
        if abs(q - goal.state) > goal.tolerance:
            raise MotionInfeasible(
                f"the part does not go on from {_written(q, self._part.joint.turns)}: "
                "it has met its stop, or it jams"
            )

    def _hold_otherwise(self, why: str) -> None:
        """Let go, look, and not take the same grasp again."""
        self._run.regrasps += 1
        if self._run.holds:
            self._lost_grasps.append(self._run.holds[-1].T_world_gripper)
        self._watch.look_clear(why)

    def _pull_on(self, q: float) -> None:
        """The joint is too vague to lead the hand: the hand follows where the part lets it go."""
        run, config = self._run, self._config
        run.rounds += 1
        joint, hand = self._part.joint.joint, self._arm.T_world_gripper()
        way = joint.velocity(hand.translation()) * np.sign(self._goal.state - q)
        lever = float(np.linalg.norm(way))
        step_m = min(abs(self._goal.state - q) * lever, config.blind_step_m)
        self._watch.decide("pull", "the joint is too vague to lead the hand: the part leads it")
        self._followed(self._arm.pull(way / max(lever, 1e-9), step_m, config.tick_s), np.inf)
        if not self._arm.holding():
            self._hold_otherwise("the grip was lost")

    def _take_hold(self) -> None:
        """With the grasp that goes farthest.

        Raises:
            MotionInfeasible: none can be taken.
            GraspFailed: too many led nowhere.
        """
        config = self._config.hold
        while True:
            if self._watch.frame is None:
                self._watch.look_clear("the arm must know what is around it")
            q, sd = self._watch.known()
            with taking(self._run.time_s, "plan"):
                chosen = self._chosen(q, sd)
            what = "the front's edge" if chosen.grasp.board else "the handle"
            self._watch.decide(
                "grasp",
                f"by {what}, {100 * chosen.reach:.0f} % of the way is within reach",
                reach=chosen.reach,
            )
            T = self._next_try.corrected(chosen.grasp.T_world_grasp)
            onward = way_of(self._part, T, q, self._goal.state, config)
            feel_m = float(np.clip(chosen.grasp.depth_m, config.feel_m, config.most_feel_m))
            try:
                with taking(self._run.time_s, "reach"):
                    for _ in self._arm.grasp(T, self._config.tick_s, feel_m, onward):
                        pass
            except (GraspFailed, MotionInfeasible) as error:
                self._failed_holds += 1
                self._lost_grasps.append(chosen.grasp.T_world_grasp)
                if self._failed_holds >= config.most_failures:
                    raise
                if isinstance(error, GraspFailed):
                    self._next_try.failed(T, self._arm.T_world_gripper())
                    self._watch.look_clear(str(error))
                else:  # no free way there: others may have one
                    log.info("grasp refused: %s", error)
                continue
            hand = self._arm.T_world_gripper()
            self._watch.look(felt_state(self._part, q, T, hand, config))
            q, _ = self._watch.known()
            self._run.holds.append(Hold(self._arm.T_world_gripper(), q, chosen.grasp.board))
            return

    def _chosen(self, q: float, sd: float) -> ChosenGrasp:
        fresh: list[gtsam.Pose3] = []
        if self._fresh is not None and self._watch.frame is not None and self._part.contacts:
            surface, held = self._part.surface.p_world, self._part.contacts[0].T_part_grasp
            T = self._part.T_world_part(q) * not_so_deep(held, surface, self._config.hold)
            normal = -T.rotation().matrix()[:, 2]
            fresh = list(self._fresh(self._watch.frame, T.translation(), normal))
        return choose_grasp(
            self._arm, self._part, q, sd, self._goal.state, fresh, self._lost_grasps,
            self._config.hold,
        )  # fmt: skip


def _written(q: float, turns: bool) -> str:
    return f"{np.rad2deg(q):.1f} deg" if turns else f"{100 * q:.1f} cm"


_DONE = object()
_ALL = 0.9  # of the most: a turning part's lever differs a little from one move to the next
_WHY = {
    "target": "the covariance bears the whole way",
    "across": "beyond, the hand would be too far off the part's way",
    "turn": "beyond, the hand would be turned too far against the part",
    "state": "beyond, the state would be too unsure without a look",
    "reach": "the arm gets no farther with this grasp",
    "step": "a step of fixed length, whatever the covariance is",
    "rest": "the rest of the way is no longer than a step, whatever the covariance is",
}
