"""Settings of the simulated Franka (`sim.robot.franka`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.arm.body.impedance import ImpedanceConfig, JointImpedanceConfig
from akm_fg.arm.body.silhouette import SilhouetteConfig
from akm_fg.arm.motion.aside import AsideConfig
from akm_fg.arm.motion.free_motion import PlanConfig
from akm_fg.arm.motion.joint_path import TimeLawConfig
from akm_fg.arm.motion.pulling import PullConfig
from akm_fg.arm.motion.reaching import ReachConfig
from akm_fg.arm.motion.reference import ReferenceConfig
from akm_fg.arm.motion.surroundings import AroundConfig
from akm_fg.arm.motion.tracking import TrackConfig
from sim.robot.gripper import GripperConfig


@dataclass(frozen=True, slots=True)
class FrankaConfig:
    """All settings of the arm."""

    reach: ReachConfig = field(default_factory=ReachConfig)
    around: AroundConfig = field(default_factory=AroundConfig)
    plan: PlanConfig = field(default_factory=PlanConfig)
    time_law: TimeLawConfig = field(default_factory=TimeLawConfig)
    joints: JointImpedanceConfig = field(default_factory=JointImpedanceConfig)
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    pull: PullConfig = field(default_factory=PullConfig)
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    silhouette: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    aside: AsideConfig = field(default_factory=AsideConfig)
    gripper: GripperConfig = field(default_factory=GripperConfig)
    approach_m_s: float = 0.08  # straight, before contact
    # Behind its reference on the approach, by the joints' damping: near a singularity the hand goes
    # so slowly. A quarter of `blocked_m`: inertia, where it starts, adds as much again.
    approach_lag_m: float = 0.003
    unseen_m_s: float = 0.03  # there where the camera could not look
    met_rad: float = 0.05  # of a joint behind its reference in free motion: it has met something
    blocked_m: float = 0.012  # behind its reference on the approach: the hand has met something
    guarded_m: float = 0.015  # the last stretch of it, where something may be touched early
    guarded_m_s: float = 0.012  # there: an impact stays within the joints' accelerations
    feel_m_s: float = 0.007  # where something may be met anywhere: as `guarded_m_s`, and slower
    # Between the gripper's z and the way it feels: towards the look of the camera, by so much.
    aslant_rad: float = 0.0
    felt_back_m: float = 0.004  # from it, before the fingers close: they do not drag along it
    arrival_m: float = 0.008  # farther than this from the grasp pose: something was in the way
    close_max_s: float = 7.0  # 40 mm at 7 mm/s, as slow as any closes, and the squeeze
    squeeze_s: float = 0.1  # at full force, before the hand is taken to hold
    open_s: float = 0.9  # 40 mm at 50 mm/s, and a little
    settle_s: float = 0.3  # at the end of a straight line
    fade_s: float = 0.4  # of the force, where a compliant motion is broken off
