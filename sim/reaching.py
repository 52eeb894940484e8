"""Which arm configuration to grasp with, clear of what is around, and the straight line to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import ruckig

from akm_fg.records import FloatArray
from sim.collision import FINGERS, HAND, ArmCollisions, Obstacle, resampled
from sim.kinematics import N_ARM, Q_HOME, Q_MAX, Q_MIN, FrankaKinematics, limit_margin_rad
from sim.obstacle_map import GraspRoom, ObstacleMap

SAME_RAD = 0.05  # joint angles nearer than this belong to one branch


@dataclass(frozen=True, slots=True)
class ReachConfig:
    """How a grasp pose is approached and what is wished of the arm afterwards."""

    standoff_m: float = 0.10  # from the pre-grasp to the grasp, along the gripper's z
    approach_steps: int = 3  # poses along it that inverse kinematics is asked for
    retreat_m: float = 0.30  # a straight pull that should stay reachable: more is better
    retreat_steps: int = 6
    starts: int = 10  # of the inverse kinematics, home first
    margin_m: float = 0.02  # kept from obstacles: tracking error, and noise of the depth
    room_radius_m: float = 0.14  # about the approach, where the hand may come near to what is
    room_ahead_m: float = 0.04  # seen of handle and front: the palm stops 47 mm before the grasp
    step_m: float = 0.01  # no point of the arm moves farther between two collision checks


@dataclass(frozen=True, slots=True)
class GraspConfiguration:
    """Joint angles (7,) at the pre-grasp and at the grasp, on one branch."""

    q_pregrasp: FloatArray
    q_grasp: FloatArray


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The obstacles of one grasp, as the two parts of the way to it have to respect them."""

    free_motion: ArmCollisions  # the whole arm
    approach: ArmCollisions  # fingers anywhere, the hand before handle and front


@dataclass(frozen=True, slots=True)
class GraspOptions:
    """The configurations for a grasp, best first, and why there are not more."""

    configurations: tuple[GraspConfiguration, ...]
    reachable: bool  # whether there are any without regard to obstacles
    touched: str | None  # what would touch in the first of those that are not clear


def surroundings(
    known: list[Obstacle],
    seen: ObstacleMap | None,
    T_world_grasp: gtsam.Pose3,
    config: ReachConfig,
    modelled: Sequence[Obstacle] = (),
) -> Surroundings:
    """The arm among obstacles, for the way to a grasp.

    Args:
        known: what the arm need not see.
        seen: what a camera saw; None where none has looked.
        T_world_grasp: where the hand will close.
        config: margins.
        modelled: of exactly known shape and place; on the approach the hand may come near them.
    """
    room = GraspRoom(T_world_grasp, config.room_radius_m, config.room_ahead_m)
    whole = seen.obstacle() if seen else None
    rest = seen.obstacle(room) if seen else None
    for_arm = [] if whole is None else [_spared(whole, (HAND, *FINGERS))]
    for_hand = [] if rest is None else [_spared(rest, FINGERS)]
    near = [_spared(obstacle, (HAND, *FINGERS)) for obstacle in modelled]
    return Surroundings(
        ArmCollisions([*known, *modelled, *([whole] if whole else [])], config.margin_m),
        ArmCollisions([*known, *near, *for_arm, *for_hand], config.margin_m),
    )


def _spared(obstacle: Obstacle, links: tuple[str, ...]) -> Obstacle:
    return Obstacle(obstacle.name, obstacle.geometry, obstacle.T_world_obstacle, links)


def standoff(T_world_grasp: gtsam.Pose3, back_m: float) -> gtsam.Pose3:
    """The pose `back_m` behind a grasp, along its own z."""
    return T_world_grasp * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -back_m]))


def choose_grasp_configuration(
    kinematics: FrankaKinematics, T_world_grasp: gtsam.Pose3, config: ReachConfig | None = None
) -> GraspConfiguration | None:
    """The best of `grasp_options` where nothing is around, or None."""
    options = grasp_options(kinematics, T_world_grasp, None, config).configurations
    return options[0] if options else None


def grasp_options(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    around: Surroundings | None,
    config: ReachConfig | None = None,
) -> GraspOptions:
    """The inverse-kinematics branches of a grasp that are clear of what is around.

    Those that can pull back farthest with the widest joint margin come first. Knows nothing of
    the joint: a straight retreat stands for the pull to come.
    """
    config = config or ReachConfig()
    scored: list[tuple[float, GraspConfiguration]] = []
    tried: list[FloatArray] = []
    touched: str | None = None
    for q_start in _starts(config.starts):
        q_grasp = kinematics.solve(T_world_grasp, q_start)
        if q_grasp is None or any(np.abs(q_grasp - q).max() < SAME_RAD for q in tried):
            continue
        way = [
            standoff(T_world_grasp, float(back))
            for back in np.linspace(0.0, config.standoff_m, config.approach_steps)[1:]
        ]
        approach = kinematics.chain(way, q_grasp)
        if approach is None:
            continue
        tried.append(q_grasp)
        choice = GraspConfiguration(approach[-1], q_grasp)
        if around is not None:
            hit = _touched(np.array([q_grasp, *approach]), around, config)
            if hit is not None:
                touched = touched or hit
                continue
        scored.append((_score(kinematics, T_world_grasp, choice, config), choice))
    scored.sort(key=lambda pair: -pair[0])  # stable: home's branch first among equals
    return GraspOptions(tuple(choice for _, choice in scored), bool(tried), touched)


def _touched(approach: FloatArray, around: Surroundings, config: ReachConfig) -> str | None:
    """What the arm would touch at the pre-grasp or on the way in, from the grasp outwards."""
    touched = around.free_motion.touched(approach[-1])
    if touched is not None:
        return touched
    hits = (around.approach.touched(q) for q in resampled(approach, config.step_m))
    return next((hit for hit in hits if hit is not None), None)


def _score(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    choice: GraspConfiguration,
    config: ReachConfig,
) -> float:
    """How far the arm can pull back in a straight line, m, plus its joint margin, rad up to 0.5."""
    reached, margin, q = 0.0, limit_margin_rad(choice.q_grasp), choice.q_pregrasp
    backs = np.linspace(config.standoff_m, config.retreat_m, config.retreat_steps)[1:]
    for back in backs:
        step = kinematics.chain([standoff(T_world_grasp, float(back))], q)
        if step is None:
            break
        q, reached = step[0], float(back)
        margin = min(margin, limit_margin_rad(q))
    return reached + min(margin, 0.5)


def _starts(count: int) -> Iterator[FloatArray]:
    yield Q_HOME
    rng = np.random.default_rng(0)
    for _ in range(count - 1):
        yield Q_HOME + rng.uniform(-1.0, 1.0, N_ARM) * 0.35 * (Q_MAX - Q_MIN)


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
