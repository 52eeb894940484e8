"""Everything needed to run one object: world, arm, camera and the given contact."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import gtsam

from akm_fg.records import CalibrationErrors, FloatArray, JointTruth
from sim.camera.camera import CameraConfig, SimCamera
from sim.camera.mirror import Scene
from sim.camera.noise import NOISE_LEVELS
from sim.camera.rig import PERFECT, DrawnRig, RigErrors
from sim.camera.views import FixedViewConfig, ViewConfig, camera_pose, fixed_view
from sim.objects.imported.imported_spec import ImportOptions
from sim.objects.staging import PlacementMode
from sim.robot.contacts import contacts
from sim.robot.franka import SimFranka
from sim.robot.franka_config import FrankaConfig
from sim.world import SimWorld, WorldConfig


@dataclass(frozen=True, slots=True)
class SimEpisode:
    """One object in front of one robot and one camera."""

    world: SimWorld
    arm: SimFranka
    camera: SimCamera
    pull_direction_world: FloatArray  # (3,) unit, out of the front
    rig: DrawnRig  # how camera and arm err. For scoring alone
    calibration: CalibrationErrors | None  # how they may err, as the robot knows; None: not at all

    @property
    def T_world_grasp(self) -> gtsam.Pose3:
        """The given contact: a grasp of the closed handle.

        Raises:
            ValueError: none is given, as at the published placement.
        """
        return self.world.placement.given_grasp()

    def truth(self, part: int = 0) -> JointTruth:
        """A true joint and its state now. For scoring alone."""
        return self.world.truth(part)

    def pressed_n(self) -> float:
        """Force on the object of all links but the fingers, as the last step left it."""
        world, fingers = self.world, set(self.arm.gripper.joints)
        touching = contacts(world.client, world.robot_id, world.object_id)
        return sum(contact.force_n for contact in touching if contact.link not in fingers)

    def true_T_world_gripper(self) -> gtsam.Pose3:
        """Where the gripper is, whatever the arm takes itself for. For scoring alone."""
        q = self.arm.measured_joints()[0] - self.rig.joint_offsets_rad
        return self.world.kinematics.T_world_gripper(q)


@contextmanager
def open_world(
    object_name: str,
    seed: int = 0,
    noise: str | None = None,
    *,
    joint: str | None = None,
    import_options: ImportOptions | None = None,
    world_config: WorldConfig | None = None,
    franka_config: FrankaConfig | None = None,
    camera_config: CameraConfig | None = None,
    view: ViewConfig | FixedViewConfig | None = None,
    scene: Scene | None = None,
    rig: RigErrors | None = None,
    placement: PlacementMode = "reachable",
    locked: bool = False,
) -> Iterator[SimEpisode]:
    """Opens the simulated world of one object and closes it again.

    Args:
        object_name: `door`, `drawer`, SUITE/NAME such as `furniture-dev/door-003`, a URDF file
            or a PartNet-Mobility folder (`sim.objects.staging.find_spec`).
        seed: varies size, place, mass, friction, looks and the camera's noise.
        noise: `clean`, `d455` or `harsh`; that of the camera's configuration if absent.
        joint: of a file or folder, the one that is free; needed where several move.
        import_options: what else to say of a file or folder.
        world_config: physics.
        franka_config: arm and gripper.
        camera_config: image size, rendering and noise.
        view: where the camera stands: `FixedViewConfig` is the same for every object, and its lens
            comes before the camera's focal length; `ViewConfig` is on the hinge's side. Without
            it, the one that goes with the placement.
        scene: draws the pictures; found by trial if absent (`sim.camera.rendering`).
        rig: how large the errors of camera and arm are, which the seed draws; none if absent.
        placement: `reachable`, where the arm can open the part, with the grasp for it given; or
            `published`, where the paper's ranges put the object, for exploration.
        locked: the part that would be free is jammed like every other front. Nothing on the robot
            can tell but by pulling.

    Raises:
        ValueError: no such object or noise level.
        InputError: no such suite, object, file or joint, or a broken file.
        MotionInfeasible: no pose of the object can be opened by the arm (`reachable` alone).
    """
    if noise is not None and noise not in NOISE_LEVELS:
        raise ValueError(f"noise {noise!r}, expected one of {', '.join(NOISE_LEVELS)}")
    config = camera_config or CameraConfig()
    if noise is not None:
        config = replace(config, noise=NOISE_LEVELS[noise])
    view = view or (FixedViewConfig() if placement == "published" else ViewConfig())
    if isinstance(view, FixedViewConfig):
        config = replace(config, focal_px=view.focal_px(config.height))
    with SimWorld(
        object_name,
        seed,
        world_config,
        joint=joint,
        options=import_options,
        placement=placement,
        locked=locked,
    ) as world:
        rig = rig or PERFECT
        drawn = rig.drawn(seed)
        calibration = None if rig == PERFECT else rig.calibration()
        arm = SimFranka(world, franka_config, drawn.joint_offsets_rad)
        T_world_cam = (
            fixed_view(view) if isinstance(view, FixedViewConfig) else camera_pose(world, view)
        )
        camera = SimCamera(world, T_world_cam, seed, config, scene, drawn)
        outwards = -world.placement.T_world_object.rotation().matrix()[:, 1]  # y is into it
        try:
            yield SimEpisode(world, arm, camera, outwards, drawn, calibration)
        finally:
            camera.close()
