"""Ways through free space: from joint angles to joint angles without touching anything.

The search is OMPL's RRTConnect and path simplifier, behind a small Protocol; decision 9 says why.
It is bounded by a number of collision checks, never by the clock, so that the same seed gives the
same way on a busy machine too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from ompl import base, geometric, util

from akm_fg.arm.body.collision import ArmCollisions
from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, limit_margin_rad
from akm_fg.arm.body.model import N_ARM
from akm_fg.arm.motion.joint_path import RETURN_RAD, JointMotion, TimeLawConfig, joint_motion
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """How hard to look, and how closely a way is checked."""

    seed: int = 1  # of the search; 0 would mean the clock to OMPL
    step_m: float = 0.01  # no point of the arm moves farther between two checks of a found way
    search_step_rad: float = 0.05  # between checks while searching, norm over the joints
    reach_rad: float = 0.8  # of one branch of the tree, norm over the joints
    checks_max: int = 15000  # of a search: about one second
    searches: int = 3  # with other seeds, each twice as fine as the one before
    margins_m: tuple[float, ...] = (0.02, 0.01, 0.0)  # the first at which both ends are free
    limit_margin_rad: float = 0.01  # kept from the soft limits


class FreeMotionPlanner(Protocol):
    """Finds ways for the whole arm."""

    def plan(self, q_from: FloatArray, q_to: FloatArray) -> FloatArray:
        """Waypoints (K, 7) rad, K >= 2, from `q_from` to `q_to`; straight lines between are free.

        Raises:
            MotionInfeasible: an end is not free, or no way was found.
        """
        ...


class RrtConnectPlanner:
    """Straight if that is free; otherwise the shortened result of RRTConnect."""

    def __init__(self, collisions: ArmCollisions, config: PlanConfig | None = None) -> None:
        self._collisions = collisions
        self._config = config or PlanConfig()

    def plan(self, q_from: FloatArray, q_to: FloatArray) -> FloatArray:
        """See FreeMotionPlanner. Keeps the largest of the margins at which both ends are free."""
        config = self._config
        inside = np.clip(q_from, Q_MIN, Q_MAX)
        if 0.0 < np.abs(q_from - inside).max() <= RETURN_RAD:  # pushed there: back first
            onwards = self.plan(inside, q_to)
            if not self._collisions.free_along(np.stack([q_from, inside]), config.step_m):
                raise MotionInfeasible(f"from joint angles {np.round(q_from, 3)} no way leads back")
            return np.concatenate([q_from[None], onwards])
        self._settle_margin(q_from, q_to)
        straight = np.stack([q_from, q_to])
        if self._collisions.free_along(straight, config.step_m):
            return straight
        for k in range(config.searches):
            step_rad = config.search_step_rad / 2**k
            way = self._search(q_from, q_to, config.seed + k, step_rad)
            if way is not None and self._collisions.free_along(way, config.step_m):
                return way
        checks = config.searches * config.checks_max
        raise MotionInfeasible(f"no free way to the goal was found with {checks} collision checks")

    def _settle_margin(self, q_from: FloatArray, q_to: FloatArray) -> None:
        if limit_margin_rad(q_from) < 0.0:
            raise MotionInfeasible(f"joint angles {np.round(q_from, 3)} are outside the limits")
        problem = ""
        for margin_m in self._config.margins_m:
            self._collisions.set_margin(margin_m)
            ends = [self._collisions.touched(q) for q in (q_from, q_to)]
            if ends == [None, None]:
                return
            problem = f"where the arm stands, {ends[0]} touch"
            if ends[0] is None:
                problem = f"at the goal of the motion, {ends[1]} would touch"
        raise MotionInfeasible(problem)

    def _search(
        self, q_from: FloatArray, q_to: FloatArray, seed: int, step_rad: float
    ) -> FloatArray | None:
        """Waypoints (K, 7) checked every `step_rad`, or None where the checks are used up."""
        util.setLogLevel(util.LOG_NONE)
        util.RNG.setSeed(seed)  # of every generator made from here on
        checks = _CountedChecks(self._collisions)
        setup = geometric.SimpleSetup(self._space(q_from))
        setup.setStateValidityChecker(checks)
        information = setup.getSpaceInformation()
        extent = information.getStateSpace().getMaximumExtent()
        information.setStateValidityCheckingResolution(step_rad / extent)
        setup.setStartAndGoalStates(_state(setup, q_from), _state(setup, q_to))
        planner = geometric.RRTConnect(information)
        planner.setRange(self._config.reach_rad)
        setup.setPlanner(planner)
        setup.setup()
        limit = self._config.checks_max
        setup.solve(base.PlannerTerminationCondition(lambda: checks.count >= limit))
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        simplifier = geometric.PathSimplifier(information)
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path)
        simplifier.reduceVertices(path)
        states = [path.getState(k) for k in range(path.getStateCount())]
        return np.array([[state[i] for i in range(N_ARM)] for state in states])

    def _space(self, q_from: FloatArray) -> Any:
        """The joint limits, drawn in by the margin; the start may be nearer to them."""
        margin = self._config.limit_margin_rad
        lower, upper = np.minimum(Q_MIN + margin, q_from), np.maximum(Q_MAX - margin, q_from)
        space, bounds = base.RealVectorStateSpace(N_ARM), base.RealVectorBounds(N_ARM)
        for i in range(N_ARM):
            bounds.setLow(i, float(lower[i]))
            bounds.setHigh(i, float(upper[i]))
        space.setBounds(bounds)
        return space


class _CountedChecks:
    """The collision check as OMPL calls it."""

    def __init__(self, collisions: ArmCollisions) -> None:
        self._collisions = collisions
        self.count = 0

    def __call__(self, state: Any) -> bool:
        self.count += 1
        return self._collisions.free(np.array(state[0:N_ARM]))


def _state(setup: Any, q: FloatArray) -> Any:
    state = setup.getStateSpace().allocState()
    for i in range(N_ARM):
        state[i] = float(q[i])
    return state


def way_out(collisions: ArmCollisions, q_from: FloatArray) -> FloatArray | None:
    """Joint angles (7,) close by at which nothing touches; None where nothing touches already.

    A hand that followed a part where it went may leave the arm folded so far that its hulls touch,
    or against what it has pulled open: no planner leaves such a place. The way there is a straight
    line in the joints, towards home or of one joint alone, on which nothing else is touched.

    Raises:
        MotionInfeasible: there is none within `OUT_RAD`.
    """
    collisions.set_margin(0.0)
    touches = collisions.touched(q_from)
    if touches is None:
        return None
    home = (Q_HOME - q_from) / max(float(np.abs(Q_HOME - q_from).max()), 1e-9)
    ways = [home, *np.eye(N_ARM), *-np.eye(N_ARM)]
    least = min(limit_margin_rad(q_from), 0.0)
    for step in np.arange(OUT_STEP_RAD, OUT_RAD, OUT_STEP_RAD):
        left: list[FloatArray] = []
        for way in ways:
            q = q_from + step * way
            if limit_margin_rad(q) < least:
                continue
            hit = collisions.touched(q)
            if hit is None:
                return np.asarray(q)
            if hit == touches:
                left.append(way)
        ways = left
    raise MotionInfeasible(f"where the arm stands, {touches} touch")


OUT_STEP_RAD = 0.04  # of the joint that goes farthest
OUT_RAD = 0.8


def timed_motion(
    waypoints: FloatArray,
    collisions: ArmCollisions,
    step_s: float,
    law: TimeLawConfig,
    step_m: float,
) -> JointMotion:
    """The jerk-limited motion along a free way, its rounded corners checked again.

    Where a rounded corner is not free, corners are cut less, at last not at all: the arm then
    stops at each waypoint.

    Raises:
        MotionInfeasible: not even the way itself is free.
    """
    for share in (1.0, 0.25, 0.0):
        motion = joint_motion(waypoints, step_s, replace(law, corner_rad=share * law.corner_rad))
        if collisions.free_along(np.vstack([waypoints[:1], motion.q]), step_m):
            return motion
    raise MotionInfeasible("the way to the goal is not free")
