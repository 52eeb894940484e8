from __future__ import annotations

from itertools import islice

import gtsam
import numpy as np
import pytest

from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.records import TimedPath
from sim.bullet import p
from sim.episode import SimEpisode, open_world
from sim.kinematics import DQ_MAX, limit_margin_rad
from sim.placement import opened

TICK_S = 0.05


def run(motion, episode: SimEpisode) -> np.ndarray:
    """Iterates a motion; (n, 2, 7) joint angles and speeds at its ticks."""
    return np.array([episode.arm.measured_joints() for _ in motion])


def slip(episode: SimEpisode) -> np.ndarray:
    """(6,) how the gripper has moved in the part since the given contact, rad and m."""
    T = episode.world.placement.T_world_object
    moved = opened(episode.world.built, episode.world.part_state())
    ideal = T * moved * T.inverse() * episode.T_world_grasp
    return ideal.localCoordinates(episode.arm.T_world_gripper())


def arc(episode: SimEpisode, goal: float, duration_s: float) -> TimedPath:
    """The true hand path from the present state to `goal`."""
    start = episode.world.part_state()
    T, G = episode.world.placement.T_world_object, episode.arm.T_world_gripper()
    s = np.linspace(0.0, 1.0, 30)
    states = (goal - start) * s * s * (3.0 - 2.0 * s)
    built = episode.world.built
    poses = tuple(T * opened(built, float(q)) * T.inverse() * G for q in states)
    return TimedPath(np.linspace(0.0, duration_s, 30), poses)


@pytest.mark.parametrize(
    ("name", "distance_m", "enough", "goal"),
    [("drawer", 0.18, 0.15, 0.05), ("door", 0.2, np.deg2rad(25), np.deg2rad(10))],
)
def test_grasp_and_pull_open_the_part_by_friction_and_follow_takes_it_back(
    name: str, distance_m: float, enough: float, goal: float
):
    with open_world(name, seed=0, noise="clean") as episode:
        arm, world = episode.arm, episode.world
        samples = [run(arm.grasp(episode.T_world_grasp, TICK_S), episode)]
        assert arm.holding()
        assert abs(world.part_state()) < 2e-3
        pull = arm.pull(episode.pull_direction_world, distance_m, TICK_S)
        samples.append(run(pull, episode))
        assert world.part_state() > enough
        samples.append(run(arm.follow(arc(episode, goal, 3.0), TICK_S), episode))
        assert abs(world.part_state() - goal) < (0.003 if name == "drawer" else 0.02)
        assert arm.holding()
        offset = slip(episode)
        assert np.linalg.norm(offset[3:]) < 0.004 and np.linalg.norm(offset[:3]) < 0.1
        q, dq = np.concatenate(samples).transpose(1, 0, 2)
        assert min(limit_margin_rad(x) for x in q) > 0.0
        assert (np.abs(dq) < DQ_MAX).all()
        assert only_gear_constraints(episode)


def only_gear_constraints(episode: SimEpisode) -> bool:
    client, robot = episode.world.client, episode.world.robot_id
    ids = [
        p.getConstraintUniqueId(i, physicsClientId=client)
        for i in range(p.getNumConstraints(physicsClientId=client))
    ]
    infos = [p.getConstraintInfo(i, physicsClientId=client) for i in ids]
    return [(i[0], i[2], i[4]) for i in infos] == [(robot, robot, p.JOINT_GEAR)]


def test_a_grasp_in_free_air_fails_and_the_fingers_stay_centred():
    with open_world("drawer", seed=1, noise="clean") as episode:
        back = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.12]))
        with pytest.raises(GraspFailed, match="nothing between"):
            run(episode.arm.grasp(episode.T_world_grasp * back, TICK_S), episode)
        left, right = episode.arm.gripper.travel_m()
        assert abs(left - right) < 5e-4
        assert not episode.arm.holding()


def test_what_is_out_of_reach_is_infeasible():
    with open_world("drawer", seed=1, noise="clean") as episode:
        far = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([1.5, 0.0, 0.5]))
        with pytest.raises(MotionInfeasible):
            next(episode.arm.grasp(far, TICK_S))
        here = episode.arm.T_world_gripper()
        path = TimedPath(np.array([0.0, 1.0]), (here, far))
        with pytest.raises(MotionInfeasible):
            next(episode.arm.follow(path, TICK_S))


def test_pulling_what_does_not_give_ends():
    with open_world("drawer", seed=1, noise="clean") as episode:
        run(episode.arm.grasp(episode.T_world_grasp, TICK_S), episode)
        sideways = episode.T_world_grasp.rotation().matrix()[:, 1]  # across the bar
        start = episode.world.time_s
        run(episode.arm.pull(sideways, 0.2, TICK_S), episode)
        assert episode.world.time_s - start < 10.0
        assert episode.world.part_state() < 0.02
        assert episode.arm.holding()


def test_the_same_seed_gives_the_same_bytes():
    outcomes = []
    for _ in range(2):
        with open_world("door", seed=2, noise="d455") as episode:
            for _ in islice(episode.arm.grasp(episode.T_world_grasp, TICK_S), 30):
                pass
            frame = episode.camera.capture()
            q, dq = episode.arm.measured_joints()
            outcomes.append([x.tobytes() for x in (frame.rgb, frame.depth_m, q, dq)])
    assert outcomes[0] == outcomes[1]


def test_an_unknown_noise_level_is_refused():
    with pytest.raises(ValueError, match="clean, d455"), open_world("door", noise="loud"):
        pass
