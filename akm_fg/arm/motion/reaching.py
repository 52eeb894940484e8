"""Which arm configuration to grasp with, clear of what is around, and the straight line to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import ruckig

from akm_fg.arm.body.collision import resampled
from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics, limit_margin_rad
from akm_fg.arm.body.model import N_ARM
from akm_fg.arm.motion.surroundings import Surroundings
from akm_fg.arm.motion.time_law import sampled
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray

# Of the joints' limits, kept while the hand holds: nearer, the soft springs there hold it back
# (`akm_fg.arm.body.impedance.ImpedanceConfig.limit_zone_rad`).
CLEAR_RAD = 0.06
ON_PAR = 0.2  # of the way: so much of it is worth half a radian of joint margin


@dataclass(frozen=True, slots=True)
class ReachConfig:
    """How a grasp pose is approached and what is wished of the arm afterwards."""

    # From the pre-grasp to the grasp, along the gripper's z: the first from which the way is clear.
    # Beside a front's edge the hand comes out of its shadow only farther back.
    standoffs_m: tuple[float, ...] = (0.10, 0.15, 0.20)
    approach_step_m: float = 0.05  # between the poses that inverse kinematics is asked for
    retreat_m: float = 0.30  # a straight pull that should stay reachable: more is better
    retreat_steps: int = 6
    starts: int = 10  # of the inverse kinematics, home first
    same_rad: float = 0.05  # joint angles nearer than this belong to one branch
    margins_m: tuple[float, ...] = (0.02, 0.01)  # kept from obstacles: the first that leaves a way
    step_m: float = 0.01  # no point of the arm moves farther between two collision checks


@dataclass(frozen=True, slots=True)
class GraspConfiguration:
    """Joint angles (7,) at the pre-grasp and at the grasp, on one branch."""

    q_pregrasp: FloatArray
    q_grasp: FloatArray
    standoff_m: float  # from the one to the other
    unseen: bool = False  # on the way in the hand goes where the camera could not look
    onward: float = 1.0  # share of the way to go while holding that it can go


@dataclass(frozen=True, slots=True)
class GraspOptions:
    """The configurations for a grasp, best first, and why there are not more."""

    configurations: tuple[GraspConfiguration, ...]
    reachable: bool  # whether there are any without regard to obstacles
    touched: str | None  # what would touch in the first of those that are not clear


def standoff(T_world_grasp: gtsam.Pose3, back_m: float) -> gtsam.Pose3:
    """The pose `back_m` behind a grasp, along its own z."""
    return T_world_grasp * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -back_m]))


def looked_along(
    T_world_grasp: gtsam.Pose3, eye_world: FloatArray | None, most_rad: float
) -> FloatArray:
    """(3,) unit: how a camera at `eye_world` (3,) looks at a grasp, within an angle of its z.

    Depth errs along the look: who goes on this way meets what was seen wherever it is, with the
    fingers on either side of it. A look farther from z than that is across the hand: what it errs
    along y the open fingers take up, and only by coming along their own z are they still on either
    side of it; to come from nearer the camera would set the far finger before the board whose edge
    it is to reach behind. Without an eye it is the gripper's z.
    """
    R = T_world_grasp.rotation().matrix()
    y, z = R[:, 1], R[:, 2]
    if eye_world is None:
        return np.asarray(z)
    look = T_world_grasp.translation() - eye_world
    along = float(look @ z)
    across = look - along * z
    wide = float(np.linalg.norm(across))
    if np.arctan2(wide, along) > most_rad:
        across = across - (across @ y) * y
        wide = float(np.linalg.norm(across))
        slope = min(wide / max(along, 1e-9), np.tan(most_rad)) if wide > 0.0 else 0.0
        look = z + slope * across / max(wide, 1e-9)
    return np.asarray(look / np.linalg.norm(look))


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
    onward: Sequence[gtsam.Pose3] = (),
) -> GraspOptions:
    """The inverse-kinematics branches of a grasp that are clear of what is around.

    Those that can go on farthest with the widest joint margin come first. Leaves `around` with the
    first of the margins at which there are any.

    Args:
        kinematics: of the arm.
        T_world_grasp: where the hand will close.
        around: what is around; None is nothing.
        config: how a grasp is approached.
        onward: where the hand will go while it holds; if nothing is known of that, a straight
            retreat stands for the pull to come.
    """
    config = config or ReachConfig()
    ways = _branches(kinematics, T_world_grasp, config)
    touched: str | None = None
    for margin_m in config.margins_m if around else (0.0,):
        if around is not None:
            around.set_margin(margin_m)
        clear: list[GraspConfiguration] = []
        for way in ways:
            choice = _from_clear_standoff(kinematics, T_world_grasp, way, around, config)
            if isinstance(choice, str):
                touched = touched or choice
            else:
                clear.append(choice)
        if clear:
            break
    if onward:
        clear = [replace(choice, onward=_onward(kinematics, onward, choice)) for choice in clear]
        scores = [choice.onward + min(_margin(choice), 0.5) * ON_PAR for choice in clear]
    else:
        scores = [_score(kinematics, T_world_grasp, choice, config) for choice in clear]
    order = sorted(range(len(clear)), key=lambda i: -scores[i])  # stable: home's branch first
    return GraspOptions(tuple(clear[i] for i in order), bool(ways), touched)


def clear_options(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    around: Surroundings,
    config: ReachConfig,
    onward: Sequence[gtsam.Pose3] = (),
) -> GraspOptions:
    """As `grasp_options`, at least one.

    Raises:
        MotionInfeasible: there are none: out of reach, or not clear of what is named.
    """
    options = grasp_options(kinematics, T_world_grasp, around, config, onward)
    where = f"the grasp at {np.round(T_world_grasp.translation(), 3)} m"
    if not options.reachable:
        raise MotionInfeasible(f"{where} is out of the arm's reach")
    if not options.configurations:
        raise MotionInfeasible(f"{where} is not clear: {options.touched} would touch")
    return options


def _onward(
    kinematics: FrankaKinematics, onward: Sequence[gtsam.Pose3], choice: GraspConfiguration
) -> float:
    """Share of the poses that the arm gets to from a grasp, one after the other."""
    return followed(kinematics, onward, choice.q_grasp) / len(onward)


def followed(
    kinematics: FrankaKinematics, poses: Sequence[gtsam.Pose3], q_start: FloatArray
) -> int:
    """How many poses the arm gets to from joint angles (7,), one after the other, on one branch."""
    q = q_start
    for number, pose in enumerate(poses):
        step = kinematics.chain([pose], q)
        if step is None or limit_margin_rad(step[0]) < CLEAR_RAD:
            return number
        q = step[0]
    return len(poses)


def _margin(choice: GraspConfiguration) -> float:
    return limit_margin_rad(choice.q_grasp)


def _branches(
    kinematics: FrankaKinematics, T_world_grasp: gtsam.Pose3, config: ReachConfig
) -> list[FloatArray]:
    """(K, 7) joint angles each, from the grasp back to the first standoff."""
    ways: list[FloatArray] = []
    for q_start in _starts(config.starts):
        q_grasp = kinematics.solve(T_world_grasp, q_start)
        if q_grasp is None or any(np.abs(q_grasp - way[0]).max() < config.same_rad for way in ways):
            continue
        way = _farther(kinematics, T_world_grasp, q_grasp[None], 0.0, config.standoffs_m[0], config)
        if way is not None:
            ways.append(way)
    return ways


def _farther(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    way: FloatArray,
    from_m: float,
    to_m: float,
    config: ReachConfig,
) -> FloatArray | None:
    """The way (K, 7), which ends `from_m` behind the grasp, with more rows to `to_m`; or None."""
    count = max(round((to_m - from_m) / config.approach_step_m), 1)
    backs = np.linspace(from_m, to_m, count + 1)[1:]
    rest = kinematics.chain([standoff(T_world_grasp, float(back)) for back in backs], way[-1])
    return None if rest is None else np.array([*way, *rest])


def _from_clear_standoff(
    kinematics: FrankaKinematics,
    T_world_grasp: gtsam.Pose3,
    way: FloatArray,
    around: Surroundings | None,
    config: ReachConfig,
) -> GraspConfiguration | str:
    """One branch from the first standoff that is clear, or what would touch from the first of all.

    Args:
        kinematics: of the arm.
        T_world_grasp: where the hand will close.
        way: (K, 7) from the grasp back to the first standoff.
        around: what is around; None is nothing.
        config: the standoffs.
    """
    touched, here_m = None, config.standoffs_m[0]
    if around is None:
        return GraspConfiguration(way[-1], way[0], here_m)
    for standoff_m in config.standoffs_m:
        longer: FloatArray | None = way
        if standoff_m > here_m:
            longer = _farther(kinematics, T_world_grasp, way, here_m, standoff_m, config)
        if longer is None:
            break
        way, here_m = longer, standoff_m
        hit = _touched(way, around, config)
        if hit is None:
            unseen = around.unseen is not None and not around.unseen.free_along(way, config.step_m)
            return GraspConfiguration(way[-1], way[0], here_m, unseen)
        touched = touched or hit
    assert touched is not None
    return touched


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
    backs = np.linspace(choice.standoff_m, config.retreat_m, config.retreat_steps)[1:]
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
    inp = ruckig.InputParameter(1)
    inp.target_position = [length_m]
    inp.max_velocity, inp.max_acceleration, inp.max_jerk = [speed_m_s], [0.3], [3.0]
    yield from sampled(inp, step_s)[1:, 0, 0].tolist()
