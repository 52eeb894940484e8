"""One attempt: take hold, pull in short stretches, solve after each, stop when it is enough.

Knows pictures, joint angles and whether something is between the fingers, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np

from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.exploration.attempts.pull_watch import Observer, PullWatch, Tried
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.mobile_points import mobile_tracks
from akm_fg.exploration.processor_time import taking
from akm_fg.exploration.records import Hypothesis, Outcome, Stretch
from akm_fg.exploration.stopping import by_threshold, enough, met, moved_enough
from akm_fg.grasping.next_try import NextTry
from akm_fg.interfaces import Arm
from akm_fg.planning.opening_path import plan_opening
from akm_fg.records import FloatArray, HandPath


class Trier:
    """Tries one hypothesis with an arm, under a camera."""

    def __init__(
        self,
        arm: Arm,
        watch: PullWatch,
        tried: Tried,
        observer: Observer,
        config: ExploreConfig,
        feel_m: float = 0.0,
        other_way: Callable[[Sequence[Hypothesis]], Hypothesis | None] = lambda rigid: None,
    ) -> None:
        """Nothing moves yet.

        Args:
            arm: holds and pulls.
            watch: sees what comes of it.
            tried: is filled.
            observer: is told.
            config: of the exploration.
            feel_m: how far a grasp's depth may be off.
            other_way: another way to pull what is held and rigid.
        """
        self._arm, self._watch, self._feel_m, self._other_way = arm, watch, feel_m, other_way
        self._tried, self._observer, self._config = tried, observer, config
        self._tick_s, self._time_s = config.pull.tick_s, tried.attempt.time_s

    def run(self, grasps: Sequence[gtsam.Pose3]) -> None:
        """The attempt, from a first look to its outcome.

        Args:
            grasps: of the contact, best first.
        """
        self._watch.look()
        attempt = self._tried.attempt
        try:
            self._take_hold(grasps)
            if self._config.stop == "threshold":
                self._pull_straight()
            else:
                self._pull_in_stretches()
        except GraspFailed as error:
            if self._opened_already():
                self._end("opened", f"opened, then {error}")
            else:
                attempt.unseen_m = 0.0 if attempt.stretches else self._watch.travel_m
                self._end("grasp_lost", str(error))
        except MotionInfeasible as error:
            attempt.grasps_refused = max(attempt.grasps_refused, 1)
            self._end("refused", str(error))

    def _end(self, outcome: Outcome, reason: str) -> None:
        attempt = self._tried.attempt
        attempt.outcome, attempt.reason = outcome, reason

    def _take_hold(self, grasps: Sequence[gtsam.Pose3]) -> None:
        """With the first of the grasps that the planner allows.

        Raises:
            MotionInfeasible: it allows none.
            GraspFailed: it led nowhere.
        """
        attempt, refusal = self._tried.attempt, None
        for T_world_grasp in grasps[: self._config.pull.most_grasps]:
            try:
                self._reach(T_world_grasp)
            except MotionInfeasible as error:
                attempt.grasps_refused += 1
                refusal = refusal or error
                continue
            attempt.pulled = attempt.held = True
            attempt.T_world_grasp = self._arm.T_world_gripper()
            self._watch.look()
            return
        raise refusal or MotionInfeasible("no grasp was found on the cloud around the contact")

    def _reach(self, T_world_grasp: gtsam.Pose3) -> None:
        """Take hold there, or where the hand tells that what it met must be.

        Raises:
            MotionInfeasible: the planner does not allow it.
            GraspFailed: it led nowhere.
        """
        attempt, next_try = self._tried.attempt, NextTry()
        with taking(self._time_s, "reach"):
            try:
                for _ in self._arm.grasp(T_world_grasp, self._tick_s, self._feel_m):
                    attempt.pulled, attempt.T_world_grasp = True, T_world_grasp
            except GraspFailed:
                next_try.failed(T_world_grasp, self._arm.T_world_gripper())
                T_world_there = next_try.corrected(T_world_grasp)
                if T_world_there is T_world_grasp:
                    raise
                self._observer.stage(
                    "  nothing between the fingers; again, where the hand tells that it must be"
                )
                for _ in self._arm.grasp(T_world_there, self._tick_s, self._feel_m):
                    attempt.T_world_grasp = T_world_there

    def _pull_in_stretches(self) -> None:
        """By the way of the hypothesis and, where what is held is rigid, by others."""
        attempt, rigid = self._tried.attempt, list[Hypothesis]()
        while (why := self._pull_on()) is not None:
            rigid.append(attempt.hypothesis)
            other = self._other_way(rigid)
            if other is None:
                return self._end("rigid", f"held, and {why}")
            attempt.rigid_before.append(attempt.hypothesis.way)
            attempt.hypothesis, self._watch.travel_m = other, 0.0
            self._observer.stage(f"  {why}; pulling {other.way}")

    def _pull_on(self) -> str | None:
        """One way, to the attempt's end; or how what is held was rigid, in words.

        Raises:
            GraspFailed: it was lost, or the hand went and nothing moved with it.
        """
        pull, direction = self._config.pull, self._tried.attempt.hypothesis.direction_world
        for number in range(pull.most_stretches):
            advanced = self._stretch(direction, pull.stretch_m)
            if not self._arm.holding():
                self._watch.solve()
                if not self._hold_again("the grip was lost"):
                    raise GraspFailed(f"the grip was lost after {_cm(self._watch.travel_m)}")
                direction = self._tangent(advanced)
                continue
            gave = self._gave(advanced)
            if not gave and number == 0:
                return f"did not give by {_mm(pull.gave_m)}"
            stretch = self._watch.solve()
            if stretch is None:
                if self._watch.travel_m > (pull.unseen_m if gave else pull.slipped_m):
                    if not self._found_from_aside():
                        return None
                    direction = self._tangent(advanced)
                elif not gave:
                    return f"gave {_mm(self._watch.travel_m)} in all"
                continue
            reason = enough(self._tried.attempt.stretches, self._config.stopping)
            if reason is not None:
                self._end("opened", reason)
                return None
            if not gave:
                self._ended_early("the part has come to its stop")
                return None
            direction = self._tangent(advanced)
        self._ended_early(f"after {pull.most_stretches} stretches")
        return None

    def _found_from_aside(self) -> bool:
        """What went with the hand unseen is held again; False: it is seen to be open already.

        Raises:
            GraspFailed: from aside, too, nothing is seen to have moved, or it is not to be held.
        """
        open_before = self._opened_already()
        if self._hold_again("nothing is seen to move behind the arm"):
            return True
        if self._opened_already() and not open_before:
            self._end("opened", "let go, and seen from aside")
            return False
        raise GraspFailed(f"the hand went {_cm(self._watch.travel_m)} and nothing was seen to move")

    def _gave(self, advanced: FloatArray) -> bool:
        return float(np.linalg.norm(advanced)) > self._config.pull.gave_m

    def _pull_straight(self) -> None:
        """The paper's pull and its check of what moved (Algorithm 2)."""
        pull, stopping = self._config.pull, self._config.stopping
        self._stretch(self._tried.attempt.hypothesis.direction_world, pull.straight_m)
        self._watch.solve()
        fit, contact = self._tried.fit, self._tried.attempt.contact
        moved = None if fit is None else mobile_tracks(fit, contact)
        if moved is not None and by_threshold(moved, pull.straight_m, stopping):
            return self._end("opened", "the moving tracks went far enough")
        if not self._arm.holding():
            raise GraspFailed("the grip was lost")
        self._end("rigid", "the moving tracks did not go far enough")

    def _ended_early(self, why: str) -> None:
        stretches = self._tried.attempt.stretches
        if not self._opened_already() and stretches and not _state_seen(stretches[-1]):
            self._watch.from_aside("it is not seen how far the part has moved")
        if self._opened_already():
            self._end("opened", why)
        else:
            self._end("stopped", f"{why}, and the part has not moved far enough")

    def _known_enough(self) -> bool:
        stretches, need = self._tried.attempt.stretches, self._config.stopping.need
        if not stretches or not self._opened_already():
            return False
        bounds = stretches[-1].bounds
        return bounds is not None and met(bounds, need)

    def _opened_already(self) -> bool:
        stretches = self._tried.attempt.stretches
        need = self._config.stopping.need
        return any(moved_enough(stretch, need) for stretch in stretches)

    def _stretch(self, direction_world: FloatArray, distance_m: float) -> FloatArray:
        """Pull on; returns how far (3,) the hand went."""
        before = self._arm.T_world_gripper().translation()
        path = self._path_on(distance_m)
        try:
            if path is None:
                self._watch.watched(self._arm.pull(direction_world, distance_m, self._tick_s))
            else:
                self._watch.watched(self._arm.follow(path, self._tick_s))
        except MotionInfeasible:  # of the path: its end is out of reach, the way there may not be
            self._watch.watched(self._arm.pull(direction_world, distance_m, self._tick_s))
        advanced = self._arm.T_world_gripper().translation() - before
        self._watch.travel_m += float(np.linalg.norm(advanced))
        return np.asarray(advanced)

    def _path_on(self, distance_m: float) -> HandPath | None:
        """Along the joint with the hand turning along; None as long as the joint is vague."""
        stretches, joint, pull = (
            self._tried.attempt.stretches,
            self._watch.joint(),
            self._config.pull,
        )
        if not stretches or joint is None or stretches[-1].kind != str(joint.kind):
            return None
        last = stretches[-1]
        if last.bounds is None or last.state is None or last.bounds.axis_rad > pull.led_axis_rad:
            return None
        if last.bounds.pivot_m is not None and last.bounds.pivot_m > pull.led_pivot_m:
            return None
        hand = self._arm.T_world_gripper()
        way = float(np.linalg.norm(joint.joint.velocity(hand.translation())))
        on = float(np.copysign(distance_m / max(way, 1e-3), last.state))
        return plan_opening(joint, hand, last.state, last.state + on, pull.hand)

    def _tangent(self, advanced: FloatArray) -> FloatArray:
        """Where the joint would take the hand next, (3,) unit; where it is vague, as it went."""
        length = float(np.linalg.norm(advanced))
        went = advanced / length if length > 1e-6 else None
        joint, fit = self._watch.joint(), self._tried.fit
        sure = fit is not None and fit.posterior.kind == str(joint.kind) if joint else False
        if joint is None or (not sure and went is not None):
            assert went is not None
            return went
        along = joint.joint.velocity(self._arm.T_world_gripper().translation())
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        if went is not None and along @ went < 0.0:
            along = -along
        return np.asarray(along)

    def _hold_again(self, why: str) -> bool:
        """Take hold anew of the part where it is seen now; False where that is not to be had.

        An arm before a front may hide all of it while it moves: from aside it is seen.
        """
        attempt = self._tried.attempt
        if attempt.regrasps >= self._config.pull.most_regrasps:
            return False
        if attempt.T_world_grasp is None or self._known_enough():
            return False
        stretch, joint = self._watch.from_aside(why), self._watch.joint()
        if stretch is None or stretch.state is None or joint is None or self._known_enough():
            return False
        attempt.regrasps += 1
        R, t = joint.joint.motion(np.array([stretch.state]))
        T_world_now = gtsam.Pose3(gtsam.Rot3(R[0]), t[0]) * attempt.T_world_grasp
        try:
            with taking(self._time_s, "reach"):
                for _ in self._arm.grasp(T_world_now, self._tick_s, self._feel_m):
                    pass
        except MotionInfeasible:
            return False
        self._watch.look()
        return True


def _state_seen(stretch: Stretch) -> bool:
    return stretch.state is not None and stretch.seen


def _cm(distance_m: float) -> str:
    return f"{100 * distance_m:.1f} cm"


def _mm(distance_m: float) -> str:
    return f"{1e3 * distance_m:.0f} mm"
