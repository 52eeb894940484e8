"""Which arm configuration to grasp with, and jerk-limited joint motion to it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
import ruckig

from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray
from sim.kinematics import (
    DDDQ_MAX,
    DDQ_MAX,
    DQ_MAX,
    N_ARM,
    Q_HOME,
    Q_MAX,
    Q_MIN,
    FrankaKinematics,
    limit_margin_rad,
)


@dataclass(frozen=True, slots=True)
class ReachConfig:
    """How a grasp pose is approached and what is wished of the arm afterwards."""

    standoff_m: float = 0.10  # from the pre-grasp to the grasp, along the gripper's z
    retreat_m: float = 0.30  # a straight pull that should stay reachable: more is better
    retreat_steps: int = 6
    starts: int = 10  # of the inverse kinematics, home first
    speed: float = 0.25  # share of Franka's velocity limits
    acceleration: float = 0.15  # share of its acceleration limits
    jerk: float = 0.02  # share of its jerk limits


@dataclass(frozen=True, slots=True)
class GraspConfiguration:
    """Joint angles (7,) at the pre-grasp and at the grasp, on one branch."""

    q_pregrasp: FloatArray
    q_grasp: FloatArray


def standoff(T_world_grasp: gtsam.Pose3, back_m: float) -> gtsam.Pose3:
    """The pose `back_m` behind a grasp, along its own z."""
    return T_world_grasp * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -back_m]))


def choose_grasp_configuration(
    kinematics: FrankaKinematics, T_world_grasp: gtsam.Pose3, config: ReachConfig | None = None
) -> GraspConfiguration | None:
    """The inverse-kinematics branch that can pull back farthest with the widest joint margin.

    Knows nothing of the joint: a straight retreat stands for the pull to come. None where the
    grasp or its pre-grasp is out of reach.
    """
    config = config or ReachConfig()
    best: GraspConfiguration | None = None
    best_score = -np.inf
    for q_start in _starts(config.starts):
        choice, score = _try_branch(kinematics, T_world_grasp, q_start, config)
        if choice is not None and score > best_score + 1e-6:
            best, best_score = choice, score
    return best


def _try_branch(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    q_start: FloatArray,
    config: ReachConfig,
) -> tuple[GraspConfiguration | None, float]:
    q_grasp = kinematics.solve(T_world_grasp, q_start)
    if q_grasp is None:
        return None, -np.inf
    way = [standoff(T_world_grasp, b) for b in np.linspace(0, config.standoff_m, 3)[1:]]
    approach = kinematics.chain(way, q_grasp)
    if approach is None:
        return None, -np.inf
    reached, margin, q = 0.0, limit_margin_rad(q_grasp), approach[-1]
    backs = np.linspace(config.standoff_m, config.retreat_m, config.retreat_steps)[1:]
    for back in backs:
        step = kinematics.chain([standoff(T_world_grasp, float(back))], q)
        if step is None:
            break
        q, reached = step[0], float(back)
        margin = min(margin, limit_margin_rad(q))
    score = reached + min(margin, 0.5)
    return GraspConfiguration(approach[-1], q_grasp), score


def _starts(count: int) -> Iterator[FloatArray]:
    yield Q_HOME
    rng = np.random.default_rng(0)
    for _ in range(count - 1):
        yield Q_HOME + rng.uniform(-1.0, 1.0, N_ARM) * 0.35 * (Q_MAX - Q_MIN)


def joint_motion(
    q_from: FloatArray, q_to: FloatArray, step_s: float, config: ReachConfig
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Jerk-limited motion from rest to rest: (q, dq, ddq), each (7,), every `step_s`.

    Raises:
        MotionInfeasible: an end lies outside the joint limits.
    """
    for q in (q_from, q_to):
        if limit_margin_rad(q) < -1e-3:
            raise MotionInfeasible(f"joint angles {np.round(q, 3)} are outside the limits")
    otg = ruckig.Ruckig(N_ARM, step_s)
    inp = ruckig.InputParameter(N_ARM)
    inp.current_position, inp.target_position = q_from.tolist(), q_to.tolist()
    inp.max_velocity = (config.speed * DQ_MAX).tolist()
    inp.max_acceleration = (config.acceleration * DDQ_MAX).tolist()
    inp.max_jerk = (config.jerk * DDDQ_MAX).tolist()
    out = ruckig.OutputParameter(N_ARM)
    result = ruckig.Result.Working
    while result == ruckig.Result.Working:
        result = otg.update(inp, out)
        if result < 0:
            raise MotionInfeasible(f"no jerk-limited motion to {np.round(q_to, 3)}: {result}")
        yield (
            np.array(out.new_position),
            np.array(out.new_velocity),
            np.array(out.new_acceleration),
        )
        out.pass_to_input(inp)


def line_motion(length_m: float, step_s: float, speed_m_s: float) -> Iterator[float]:
    """Jerk-limited way along a line from 0 to `length_m`, every `step_s`."""
    otg = ruckig.Ruckig(1, step_s)
    inp = ruckig.InputParameter(1)
    inp.target_position = [length_m]
    inp.max_velocity, inp.max_acceleration, inp.max_jerk = [speed_m_s], [0.3], [3.0]
    out = ruckig.OutputParameter(1)
    result = ruckig.Result.Working
    while result == ruckig.Result.Working:
        result = otg.update(inp, out)
        yield float(out.new_position[0])
        out.pass_to_input(inp)
