"""Settings of a real Franka: how it is planned for, how stiff it is, and when it gives up."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.arm.body.silhouette import SilhouetteConfig
from akm_fg.arm.motion.aside import AsideConfig
from akm_fg.arm.motion.free_motion import PlanConfig
from akm_fg.arm.motion.joint_path import TimeLawConfig
from akm_fg.arm.motion.pulling import PullConfig
from akm_fg.arm.motion.reaching import ReachConfig
from akm_fg.arm.motion.reference import ReferenceConfig
from akm_fg.arm.motion.surroundings import AroundConfig
from akm_fg.arm.motion.tracking import TrackConfig


@dataclass(frozen=True, slots=True)
class SpringConfig:
    """Of a spring between the hand and a reference; franky damps it critically."""

    stiffness_n_m: float
    stiffness_rot: float  # N m/rad
    stretch_max_m: float  # of each axis: no reference pulls with more than stiffness times this
    stretch_max_rad: float


@dataclass(frozen=True, slots=True)
class ReflexConfig:
    """Outer torques and forces at which the robot stops itself."""

    torque_n_m: float  # of each joint
    force_n: float  # and N m, of the hand


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """How the fingers close and open."""

    force_n: float = 70.0  # continuous grasping force (Franka hand data sheet)
    close_m_s: float = 0.02
    open_m_s: float = 0.05
    open_m: float = 0.08  # between the fingertips
    nothing_m: float = 0.004  # opening below which the fingers have met
    patience_s: float = 15.0  # for an answer of the hand


@dataclass(frozen=True, slots=True)
class ApproachConfig:
    """The straight way to a grasp, and back from it."""

    speed_m_s: float = 0.05
    unseen_m_s: float = 0.03  # there where the camera could not look
    guarded_m: float = 0.015  # the last stretch, where something may be touched early
    guarded_m_s: float = 0.012
    feel_m_s: float = 0.007  # where something may be met anywhere
    aslant_rad: float = 0.0  # between the gripper's z and the way it feels, towards the look
    felt_back_m: float = 0.004  # from it, before the fingers close
    blocked_m: float = 0.015  # behind its reference: the hand has met something
    arrival_m: float = 0.008  # farther than this from the grasp: something was in the way
    makeup_1_s: float = 1.5  # rate at which the reference makes up for what joint friction holds
    makeup_max_m: float = 0.010  # and by how much at most: 15 N
    settle_s: float = 0.5  # at the end of a line


@dataclass(frozen=True, slots=True)
class FrankaArmConfig:
    """All settings of the arm."""

    reach: ReachConfig = field(default_factory=ReachConfig)
    around: AroundConfig = field(default_factory=AroundConfig)
    plan: PlanConfig = field(default_factory=PlanConfig)
    time_law: TimeLawConfig = field(default_factory=TimeLawConfig)
    pull: PullConfig = field(default_factory=PullConfig)
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    silhouette: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    aside: AsideConfig = field(default_factory=AsideConfig)
    grasp: GraspConfig = field(default_factory=GraspConfig)
    approach: ApproachConfig = field(default_factory=ApproachConfig)
    # Stiff enough that joint friction (a few N at the hand) costs millimetres.
    stiff: SpringConfig = field(default_factory=lambda: SpringConfig(1500.0, 60.0, 0.03, 0.2))
    # Soft: the pull's own law says the force, the spring carries it (`compliance`). 0.18 m is 72 N,
    # a little more than the law ever asks for.
    pulling: SpringConfig = field(default_factory=lambda: SpringConfig(400.0, 15.0, 0.18, 0.3))
    following: SpringConfig = field(default_factory=lambda: SpringConfig(700.0, 25.0, 0.12, 0.3))
    free_reflex: ReflexConfig = field(default_factory=lambda: ReflexConfig(25.0, 30.0))
    held_reflex: ReflexConfig = field(default_factory=lambda: ReflexConfig(50.0, 90.0))
    period_s: float = 0.005  # between two references, by the robot's clock
    late_s: float = 0.05  # a longer pause between two references counts as this
    # A caller who is away for longer than this (who looks and thinks between two ticks) finds the
    # hand waiting: what is not watched does not go on.
    patience_s: float = 0.5
    # Of a joint behind its reference in free motion, for so long: it has met something. The
    # robot's own reflex comes before that where it measures torques.
    met_rad: float = 0.15
    met_s: float = 0.3
    look_s: float = 0.02  # between two looks at that
    rest_rad: float = 0.05  # of a joint: nearer than this to a place is there
    stop_s: float = 5.0  # to come to rest in
    hand_off_m: float = 0.02  # between the robot's end effector and ours: it is another hand
    hand_off_rad: float = 0.03
