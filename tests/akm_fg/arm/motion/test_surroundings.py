from __future__ import annotations

import gtsam
import numpy as np
from numpy.testing import assert_allclose

from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.motion.obstacle_map import MapConfig, ObstacleMap
from akm_fg.arm.motion.surroundings import AroundConfig, KnownScene
from akm_fg.records import PinholeCamera, RgbdFrame

FRAME = RgbdFrame(
    0.0,
    np.zeros((3, 4, 3), np.uint8),
    np.full((3, 4), np.nan, np.float32),
    PinholeCamera(4, 3, 5.0, 5.0, 1.5, 1.0),
    gtsam.Pose3(),
)


def test_the_finer_map_is_about_the_grasp():
    """One map of the whole when the frame comes, a finer one for each grasp."""
    asked: list[MapConfig] = []

    def mapped(
        frame: RgbdFrame,
        q: np.ndarray,
        floor_m: float,
        config: MapConfig,
        description: ArmDescription | None,
    ) -> ObstacleMap:
        assert frame is FRAME and q is Q_HOME and floor_m == -0.3 and description is arm
        asked.append(config)
        return ObstacleMap(np.empty((0, 3)), np.empty(0, dtype=bool), config.voxel_m)

    arm, config = franka_description(), AroundConfig()
    scene = KnownScene(-0.3, description=arm, make_map=mapped)
    scene.see(FRAME, Q_HOME)
    at = np.array([0.6, -0.2, 0.4])
    around = scene.around(gtsam.Pose3(gtsam.Rot3(), at), 0.02)
    assert around.unseen is None and around.free_motion.margin_m == 0.02
    assert asked[0] == config.obstacles and len(asked) == 2
    near = asked[1]
    assert near.voxel_m == config.near_voxel_m
    assert_allclose([near.lower_m, near.upper_m], [at - config.near_m, at + config.near_m])


def test_without_a_frame_floor_and_pedestal_are_around():
    around = KnownScene(0.0).around(gtsam.Pose3(), 0.0)
    assert around.free_motion.free(Q_HOME) and around.unseen is None
    touched = around.free_motion.touched(np.array([0.0, 1.7, 0.0, -0.3, 0.0, 2.0, 0.8]))
    assert touched is not None and "floor" in touched
