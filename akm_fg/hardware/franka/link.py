"""The connection to a Franka and its hand; with `stopped`, the only module that knows `franky`.

Whatever franky or libfranka raise becomes one line (`ArmStopped`). The robot itself keeps its
limits and stops by itself when it meets something, or when packets stay away: what is done here is
to say so, and to leave the arm at rest where the connection still stands.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from akm_fg.arm.body.kinematics import Q_MAX, Q_MIN
from akm_fg.arm.body.model import N_ARM
from akm_fg.errors import ArmStopped, MissingDependency
from akm_fg.hardware.franka.config import FrankaArmConfig, ReflexConfig, SpringConfig
from akm_fg.hardware.franka.legs import LegLimits
from akm_fg.hardware.franka.stopped import CONNECTING, told
from akm_fg.records import FloatArray

log = logging.getLogger(__name__)
REALTIME = Path("/sys/kernel/realtime")  # holds 1 on a kernel with PREEMPT_RT
WAIT_S = 0.1  # between two looks at a motion that is to end
SLOWEST = 10.0  # times slower than real is the clock of a simulated robot on a busy computer
PREEMPTED = "preempted"  # of a motion that was stopped by `Robot.stop`


@dataclass(frozen=True, slots=True)
class ArmState:
    """What the robot says of itself at one moment of its own clock."""

    time_s: float
    q: FloatArray  # (7,) rad
    dq: FloatArray  # (7,) rad/s
    q_wanted: FloatArray  # (7,) rad, its reference
    T_world_ee: FloatArray  # (4, 4)
    success: float  # share of the last 100 control packets that came in time


def is_realtime() -> bool:
    """Whether this kernel keeps the robot's millisecond."""
    try:
        return REALTIME.read_text(encoding="ascii").strip() == "1"
    except OSError:
        return False


class FrankaLink:
    """Robot and hand at one address. A context manager: leaves the arm at rest."""

    def __init__(self, host: str, config: FrankaArmConfig | None = None) -> None:
        """Connects to nothing yet.

        Raises:
            MissingDependency: `franky-control` is not installed.
        """
        if importlib.util.find_spec("franky") is None:
            raise MissingDependency(
                "a Franka needs franky-control, which is not installed; install akm-fg[hardware]"
            )
        self.host, self.config = host, config or FrankaArmConfig()
        self._robot: Any = None
        self._hand: Any = None
        self._fingers: Any = None  # what was last asked of the hand, while it is not done

    def __enter__(self) -> FrankaLink:
        """Connects.

        Raises:
            ArmStopped: there is no robot, or it does not let itself be commanded.
        """
        import franky

        kind = franky.RealtimeConfig
        with self._told(CONNECTING):
            self._robot = franky.Robot(
                self.host, realtime_config=kind.Enforce if is_realtime() else kind.Ignore
            )
            self._hand = franky.Gripper(self.host)
            mode, errors = self._robot.state.robot_mode, self._robot.has_errors
        if errors or mode not in (franky.RobotMode.Idle, franky.RobotMode.Move):
            raise ArmStopped(
                f"the arm at {self.host} is in mode {mode.name}: look at it, clear what stopped it "
                "in Franka's Desk, and start again"
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.stop()
        except ArmStopped as problem:
            if error is None:
                raise
            log.warning("%s", problem)
        finally:
            self._robot = self._hand = None

    # What it is and where it stands.

    def state(self) -> ArmState:
        """The newest state.

        Raises:
            ArmStopped: the connection is lost.
        """
        with self._told("reading its joints"):
            state = self._robot.state
            return ArmState(
                state.time.to_sec(),
                np.array(state.q),
                np.array(state.dq),
                np.array(state.q_d),
                np.array(state.O_T_EE.matrix),
                float(state.control_command_success_rate),
            )

    def fingers_m(self) -> float:
        """Distance between the fingertips."""
        with self._told("reading its fingers"):
            return float(self._hand.width)

    def widest_m(self) -> float:
        """The hand's largest opening, as found when it was homed last."""
        with self._told("reading its fingers"):
            return float(self._hand.max_width)

    def joint_limits(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest angles (7,) rad: of this robot's own model, and of ours."""
        with self._told("reading its model"):
            root = ElementTree.fromstring(self._robot.model_urdf)
        low, high = Q_MIN.copy(), Q_MAX.copy()
        for i in range(N_ARM):
            joint = next(
                x for x in root.iter("joint") if x.get("name", "").endswith(f"joint{i + 1}")
            )
            limit = joint.find("limit")
            if limit is not None:
                low[i] = max(low[i], float(limit.get("lower", low[i])))
                high[i] = min(high[i], float(limit.get("upper", high[i])))
        return low, high

    # How it moves.

    def expect(self, reflex: ReflexConfig) -> None:
        """From now on the robot stops itself at these outer torques and forces."""
        with self._told("setting its reflexes"):
            self._robot.set_collision_behavior([reflex.torque_n_m] * N_ARM, [reflex.force_n] * 6)

    def go(self, q: FloatArray, limits: LegLimits) -> None:
        """Set out from rest to joint angles (7,) within limits of each joint."""
        import franky

        robot = self._robot
        with self._told("setting out"):
            robot.joint_velocity_limit.set(np.minimum(limits.rates, robot.joint_velocity_limit.max))
            robot.joint_acceleration_limit.set(
                np.minimum(limits.accelerations, robot.joint_acceleration_limit.max)
            )
            robot.joint_jerk_limit.set(np.minimum(limits.jerks, robot.joint_jerk_limit.max))
            robot.move(
                franky.JointWaypointMotion([franky.JointWaypoint(q.tolist())]), asynchronous=True
            )

    def done(self, wait_s: float = 0.0) -> bool:
        """Whether the last motion has ended, waiting for it no longer than this.

        Raises:
            ArmStopped: it was ended by the robot, or the connection is lost.
        """
        with self._told("moving"):
            return bool(self._robot.join_motion(timeout=wait_s))

    @contextmanager
    def spring(self, config: SpringConfig) -> Iterator[Spring]:
        """Hold the hand by a spring, first where it is; at rest afterwards."""
        import franky

        with self._told("taking hold of the hand"):
            motion = franky.CartesianImpedanceTrackingMotion(
                translational_stiffness=config.stiffness_n_m,
                rotational_stiffness=config.stiffness_rot,
                translational_error_clip=np.full(3, config.stretch_max_m),
                rotational_error_clip=np.full(3, config.stretch_max_rad),
            )
            here = self._robot.state.O_T_EE
            motion.set_reference(franky.CartesianReference(target=here))
            self._robot.move(motion, asynchronous=True)
        try:
            yield Spring(self, motion, np.array(here.matrix))
        finally:
            self.stop()

    def stop(self) -> None:
        """Bring the arm to rest, if it moves.

        Raises:
            ArmStopped: it had been stopped, or the connection is lost.
        """
        import franky

        robot = self._robot
        if robot is None or not robot.is_in_control:
            return
        torques = robot.current_control_signal_type == franky.ControlSignalType.Torques
        gently = franky.TorqueStopMotion() if torques else franky.JointStopMotion()
        with self._told("stopping"):
            robot.move(gently, asynchronous=True)
            began_s, waits = robot.state.time.to_sec(), 0
            while not robot.join_motion(timeout=WAIT_S):
                waits += 1
                took_s = max(robot.state.time.to_sec() - began_s, WAIT_S * waits / SLOWEST)
                if took_s > self.config.stop_s:
                    self._stop_at_once()
                    return

    def _stop_at_once(self) -> None:
        """By the robot's own stop; what it says of the motion then is that it was stopped."""
        import franky

        self._robot.stop()
        try:
            self._robot.join_motion(timeout=WAIT_S)
        except franky.ControlException as error:
            if PREEMPTED not in str(error):
                raise

    # The hand.

    def open_fingers(self) -> None:
        """Set out to open; `fingers_done` says when."""
        c = self.config.grasp
        with self._told("opening its fingers"):
            self._fingers = self._hand.move_async(c.open_m, c.open_m_s)

    def close_fingers(self) -> None:
        """Set out to close on whatever is between the fingers; `fingers_done` says when."""
        c = self.config.grasp
        with self._told("closing its fingers"):
            self._fingers = self._hand.grasp_async(
                0.0, c.close_m_s, c.force_n, epsilon_inner=c.open_m, epsilon_outer=c.open_m
            )

    def fingers_done(self, wait_s: float) -> bool:
        """Whether the fingers have done what was asked, waiting no longer than this."""
        if self._fingers is None:
            return True
        with self._told("moving its fingers"):
            if not self._fingers.wait(wait_s):
                return False
            self._fingers.get()
        self._fingers = None
        return True

    def give_up_fingers(self) -> None:
        """They take too long.

        Raises:
            ArmStopped: always.
        """
        self._fingers = None
        raise ArmStopped(
            f"the hand at {self.host} did not answer within {self.config.grasp.patience_s:g} s: "
            "look at it, home it in Desk, and start again"
        )

    def _told(self, doing: str) -> AbstractContextManager[None]:
        return told(self.host, doing)


@dataclass(frozen=True, slots=True)
class Spring:
    """Holds the robot's end effector at a reference that may move."""

    link: FrankaLink
    motion: Any  # franky's
    T_world_start: FloatArray  # (4, 4) of the end effector

    def pull_to(self, T_world_ee: FloatArray, twist: FloatArray) -> None:
        """From now on: a pose (4, 4), and its speed (6,), linear first, world axes."""
        import franky

        with told(self.link.host, "moving its hand"):
            self.motion.set_reference(
                franky.CartesianReference(
                    target=franky.Affine(T_world_ee),
                    target_twist=franky.Twist(twist[:3], twist[3:]),
                )
            )
