"""The scripted pull: the gripper rides on the handle along the true motion."""

from __future__ import annotations

import numpy as np
import pytest

from akm_fg.errors import MotionInfeasible
from sim.bullet import joint_index, p
from sim.episode import open_world
from sim.robot.contacts import finger_links, nearby
from sim.robot.scripted_pull import ScriptedPull

GRASP_LINK = "panda_grasptarget_hand"


@pytest.mark.parametrize(
    ("name", "states"),
    [("furniture-dev/drawer-003", [0.0, 0.1, 0.25]), ("furniture-dev/door-003", [0.0, 0.3, 0.69])],
)
def test_the_gripper_is_rigid_in_the_part_with_the_handle_between_its_fingers(name, states):
    with open_world(name, 0, "clean") as episode:
        world = episode.world
        if world.spec.kind == "prismatic":
            with pytest.raises(MotionInfeasible, match="cannot follow"):
                ScriptedPull(world, episode.T_world_grasp, [0.0, 1.5])
        pull = ScriptedPull(world, episode.T_world_grasp, states)
        relative = []
        for i, state in enumerate(states):
            pull.show(i)
            assert world.part_state() == pytest.approx(state)
            assert pull.overlap_m() < 0.004
            T_world_gripper = simulated_gripper(world)
            np.testing.assert_allclose(pull.T_world_gripper(i).matrix(), T_world_gripper, atol=1e-4)
            relative.append(np.linalg.inv(simulated_part(world)) @ T_world_gripper)
        np.testing.assert_allclose(relative[1:], [relative[0]] * (len(states) - 1), atol=1e-3)
        points = nearby(world.client, world.robot_id, world.object_id, 0.003)
        touching = {c.link for c in points if c.other_link == world.part_joint}
        assert set(finger_links(world.client, world.robot_id)) <= touching


def simulated_gripper(world) -> np.ndarray:
    return link_pose(world, world.robot_id, joint_index(world.client, world.robot_id, GRASP_LINK))


def simulated_part(world) -> np.ndarray:
    return link_pose(world, world.object_id, world.part_joint)


def link_pose(world, body: int, link: int) -> np.ndarray:
    state = p.getLinkState(body, link, computeForwardKinematics=True, physicsClientId=world.client)
    T = np.eye(4)
    T[:3, :3] = np.reshape(p.getMatrixFromQuaternion(state[5]), (3, 3))
    T[:3, 3] = state[4]
    return T
