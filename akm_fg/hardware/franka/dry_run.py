"""An arm that moves nothing: it plans as the real one does, and says what would move.

It connects to nothing. The robot itself stands where it stands, wherever the plan has got to.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.motion.joint_path import TimeLawConfig, joint_motion
from akm_fg.arm.motion.time_law import duration_s
from akm_fg.errors import DryRunEnded
from akm_fg.hardware.franka.planning import ArmPlanner
from akm_fg.records import FloatArray, HandPath, RgbdFrame

STEP_S = 0.01  # of the times that are told


class DryRunArm:
    """Fits `akm_fg.interfaces.Arm`; what it would do goes to `tell`, line by line."""

    def __init__(
        self, planner: ArmPlanner, tell: Callable[[str], None], q_start: FloatArray | None = None
    ) -> None:
        """Plans from where the arm is said to stand.

        Args:
            planner: what is known of the place.
            tell: takes a line.
            q_start: (7,) rad; home if absent.
        """
        self._planner, self._tell = planner, tell
        self._q_stands = Q_HOME.copy() if q_start is None else np.asarray(q_start, dtype=float)
        self._q = self._q_stands.copy()

    def T_world_gripper(self) -> gtsam.Pose3:
        """Where the hand would be by now."""
        return self._planner.kinematics.T_world_gripper(self._q)

    def masked(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame without the arm, which stands where it was said to stand."""
        fingers_m = self._planner.config.grasp.open_m / 2.0
        return self._planner.silhouette.masked(frame, self._q_stands, fingers_m)

    def see(self, frame: RgbdFrame) -> None:
        """Keep clear of what this frame shows."""
        self._planner.scene.see(frame, self._q_stands)

    def holding(self) -> bool:
        """Nothing is ever held."""
        return False

    def reachable(self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3] = ()) -> float:
        """As the real arm.

        Raises:
            MotionInfeasible: as the real arm would.
        """
        return self._planner.reachable(T_world_grasp, onward)

    def can_follow(self, poses: Sequence[gtsam.Pose3]) -> int:
        """As the real arm, from where the hand would be by now."""
        return self._planner.can_follow(poses, self._q)

    def grasp(
        self,
        T_world_grasp: gtsam.Pose3,
        tick_s: float,
        feel_m: float = 0.0,
        onward: Sequence[gtsam.Pose3] = (),
    ) -> Iterator[None]:
        """Says the way to the grasp.

        Raises:
            MotionInfeasible: as the real arm would.
            DryRunEnded: it would be grasped; what follows is not known.
        """
        planned = self._planner.grasp(T_world_grasp, self._q, onward)
        self._tell(f"to the pre-grasp: {_words(planned.waypoints, self._planner.config.time_law)}")
        where = _rounded(T_world_grasp.translation(), 3)
        along = _rounded(T_world_grasp.rotation().matrix()[:, 2], 2)
        way_cm = 100.0 * planned.choice.standoff_m
        felt = f", up to {1e3 * feel_m:.0f} mm on until it is felt" if feel_m > 0.0 else ""
        self._tell(f"approach: {way_cm:.0f} cm along {along} to {where} m{felt}; close the fingers")
        yield
        raise DryRunEnded("dry run: the fingers would close here, and nothing was moved")

    def close_and_reach(
        self, T_world_wanted: gtsam.Pose3, tick_s: float, onward: Sequence[gtsam.Pose3] = ()
    ) -> Iterator[None]:
        """Says the way.

        Raises:
            MotionInfeasible: as the real arm would.
        """
        planned = self._planner.grasp(T_world_wanted, self._q, onward)
        law = self._planner.config.time_law
        self._tell(f"with closed fingers: {_words(planned.waypoints, law)}")
        self._q = planned.choice.q_grasp
        yield

    def step_aside(self, frame: RgbdFrame, tick_s: float, unseen: bool = False) -> Iterator[None]:
        """Says where to."""
        here = self.T_world_gripper()
        way = self._planner.out_of_sight(frame, self._q, here, unseen)
        if way is None:
            self._tell("out of sight: it stays where it is")
            return
        self._tell(f"out of sight: {_words(way, self._planner.config.time_law)}")
        self._q = way[-1]
        yield

    def pull(self, direction_world: FloatArray, distance_m: float, tick_s: float) -> Iterator[None]:
        """Says how far, and with which force at most."""
        direction = _rounded(np.asarray(direction_world), 2)
        force_n = self._planner.config.pull.force_max_n
        self._tell(f"pull: {100 * distance_m:.0f} cm along {direction}, {force_n:.0f} N at most")
        yield

    def relax(self, tick_s: float) -> Iterator[None]:
        """Nothing moves."""
        yield from ()

    def follow(self, path: HandPath, tick_s: float) -> Iterator[None]:
        """Says the path's ends.

        Raises:
            MotionInfeasible: as the real arm would.
        """
        slower = self._planner.path(path, self._q)
        poses = slower.T_world_gripper
        first, last = (_rounded(T.translation(), 3) for T in (poses[0], poses[-1]))
        self._tell(f"follow: from {first} to {last} m in {duration_s(slower):.1f} s")
        yield


def _words(waypoints: FloatArray, law: TimeLawConfig) -> str:
    legs = itertools.pairwise(waypoints)
    seconds = sum(STEP_S * len(joint_motion(np.array(leg), STEP_S, law).q) for leg in legs)
    goal = _rounded(np.rad2deg(waypoints[-1]), 0)
    count = len(waypoints) - 1
    return f"{count} leg{'s' if count > 1 else ''}, {seconds:.1f} s, to joint angles {goal} deg"


def _rounded(numbers: FloatArray, digits: int) -> str:
    return "(" + ", ".join(f"{x + 0.0:.{digits}f}" for x in np.round(numbers, digits)) + ")"
