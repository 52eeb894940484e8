from __future__ import annotations

import os
import subprocess
import sys

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.body.limits import MotionRecorder
from akm_fg.arm.motion.reaching import GraspConfiguration
from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.records import HandPath, WayLimits
from sim.bullet import p
from sim.episode import SimEpisode, open_world
from sim.objects.placement import opened
from sim.robot.contacts import contacts
from sim.robot.franka_config import FrankaConfig
from sim.robot.slip import SlipGauge

TICK_S = 0.05


def run(motion) -> None:
    """Iterates a motion to its end."""
    for _ in motion:
        pass


def arc(episode: SimEpisode, goal: float, duration_s: float) -> HandPath:
    """The true hand path from the present state to `goal`, in about so long."""
    start = episode.world.part_state()
    T, G = episode.world.placement.T_world_object, episode.arm.T_world_gripper()
    s = np.linspace(0.0, 1.0, 30)
    states = (goal - start) * s
    built = episode.world.built
    poses = tuple(T * opened(built, float(q)) * T.inverse() * G for q in states)
    return HandPath(
        s, poses, WayLimits(1.5 / duration_s, 6.0 / duration_s**2, 60.0 / duration_s**3)
    )


def finger_forces_n(episode: SimEpisode) -> list[float]:
    """What each finger presses with on the part, along the contacts' normals."""
    world = episode.world
    touching = contacts(world.client, world.robot_id, world.object_id)
    return [sum(c.force_n for c in touching if c.link == f) for f in episode.arm.gripper.joints]


def run_grasp(episode: SimEpisode, recorder: MotionRecorder, T_world_grasp: gtsam.Pose3) -> range:
    """Grasps; returns the samples while the fingers closed."""
    start = len(recorder)
    for _ in episode.arm.grasp(T_world_grasp, TICK_S):
        if not episode.arm.gripper.squeezing:
            start = len(recorder)
    return range(start, len(recorder))


def check_limits(recorder: MotionRecorder) -> None:
    """All of Franka's limits over all executed samples, as they were sampled."""
    whole = recorder.motion().usage()
    assert whole.position_margin_rad > 0.0
    assert whole.within, whole


@pytest.mark.parametrize(
    ("name", "distance_m", "enough", "goal"),
    [("drawer", 0.18, 0.15, 0.05), ("door", 0.2, np.deg2rad(25), np.deg2rad(10))],
)
def test_grasp_and_pull_open_the_part_by_friction_and_follow_takes_it_back(
    name: str, distance_m: float, enough: float, goal: float
):
    with open_world(name, seed=0, noise="clean") as episode:
        arm, world, recorder = episode.arm, episode.world, episode.arm.record()
        closing = run_grasp(episode, recorder, episode.T_world_grasp)
        assert 500 < len(closing) < 4000
        assert arm.holding()
        assert abs(world.part_state()) < 2e-3
        assert max(finger_forces_n(episode)) < 1.05 * arm.gripper.config.force_n
        gauge = SlipGauge(world, arm.T_world_gripper())
        run(arm.pull(episode.pull_direction_world, distance_m, TICK_S))
        assert world.part_state() > enough
        run(arm.follow(arc(episode, goal, 3.0), TICK_S))
        assert abs(world.part_state() - goal) < (0.003 if name == "drawer" else 0.02)
        assert arm.holding()
        slip = gauge.slip(arm.T_world_gripper())
        assert slip.translation_m < 0.003 and slip.rotation_rad < 0.1
        assert len(recorder) == round(world.time_s / world.config.step_s)
        check_limits(recorder)
        assert only_gear_constraints(episode)


def test_squeezing_a_board_stays_within_the_limits_while_contact_points_come_and_go():
    with open_world("furniture-dev/drawer-018", seed=0, noise="clean") as episode:
        recorder = episode.arm.record()
        run(episode.arm.grasp(episode.T_world_grasp, TICK_S))
        check_limits(recorder)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drawer", "door"])
@pytest.mark.parametrize("seed", range(1, 6))
def test_whole_episodes_are_executed_within_the_arms_limits(name: str, seed: int):
    with open_world(name, seed, noise="clean") as episode:
        arm, recorder = episode.arm, episode.arm.record()
        run(arm.grasp(episode.T_world_grasp, TICK_S))
        run(arm.pull(episode.pull_direction_world, 0.15, TICK_S))
        opened_by = episode.world.part_state()
        assert opened_by > (0.12 if name == "drawer" else np.deg2rad(15))
        run(arm.follow(arc(episode, 0.4 * opened_by, 3.0), TICK_S))
        check_limits(recorder)


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
            run(episode.arm.grasp(episode.T_world_grasp * back, TICK_S))
        left, right = episode.arm.gripper.travel_m()
        assert abs(left - right) < 5e-4
        assert not episode.arm.holding()


def put_ball(episode: SimEpisode, p_world: np.ndarray) -> None:
    """A heavy ball of 10 cm, too wide for the open fingers, that nobody has told the arm of."""
    client = episode.world.client
    shape = p.createCollisionShape(p.GEOM_SPHERE, radius=0.05, physicsClientId=client)
    p.createMultiBody(0.0, shape, basePosition=p_world.tolist(), physicsClientId=client)


@pytest.mark.parametrize(
    ("before_m", "told", "left_m", "most_n"),
    [(0.03, "blocked", 0.06, 25.0), (None, "met something", 0.10, np.inf)],
)
def test_a_hand_that_meets_something_unexpected_stops(
    before_m: float | None, told: str, left_m: float, most_n: float
):
    """On the straight approach, and in the free motion before it."""
    with open_world("drawer", seed=1, noise="clean") as episode:
        arm, grasp = episode.arm, episode.T_world_grasp
        if before_m is None:
            pregrasp = grasp * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.10]))
            start = arm.T_world_gripper().translation()
            put_ball(episode, start + 0.6 * (pregrasp.translation() - start))
        else:
            ahead = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -before_m]))
            put_ball(episode, (grasp * ahead).translation())
        recorder = arm.record()
        with pytest.raises(GraspFailed, match=told):
            run(arm.grasp(grasp, TICK_S))
        off_m = np.linalg.norm(arm.T_world_gripper().translation() - grasp.translation())
        assert off_m > left_m
        world = episode.world
        touching = contacts(world.client, world.robot_id)
        ball = p.getNumBodies(physicsClientId=world.client) - 1
        assert 0.0 < sum(c.force_n for c in touching if c.other_body == ball) < most_n
        assert recorder.motion().usage().torque < 1.0


def test_the_hand_goes_slowly_where_nobody_could_look_and_where_joints_turn_far():
    """Counted in control steps, with an arm that stands still.

    For an arm that is fairly stretched the static balance is solved by itself: forces and moments
    that exert the damping torques of the joint speeds, over the stiffness, are its lag. Fully
    stretched it goes no more slowly than at the end of every approach.
    """
    config = FrankaConfig(blocked_m=np.inf)
    stretched, singular = (np.array([0.0, 0.4, 0.0, q4, 0.0, 2.4, 0.0]) for q4 in (-0.82, -0.5))
    far, farther = (GraspConfiguration(q, Q_HOME, 0.1) for q in (stretched, singular))
    seen, unseen = (GraspConfiguration(Q_HOME, Q_HOME, 0.1, unseen) for unseen in (False, True))
    with open_world("drawer", seed=1, noise="clean", franka_config=config) as episode:
        arm = episode.arm
        arm.measured_joints()
        grasp = arm.T_world_gripper()
        times_s = [
            1e-3 * sum(1 for _ in arm._approach(grasp, x)) for x in (seen, unseen, far, farther)
        ]
        J = episode.world.kinematics.update(stretched)[1]
    n = np.append(grasp.rotation().matrix()[:, 2], np.zeros(3))
    torques = config.impedance.joint_damping * np.linalg.pinv(J) @ n  # at 1 m/s
    lag_s = n @ np.linalg.lstsq(J.T, torques)[0] / config.impedance.stiffness_n_m
    way_m = 0.1 - config.guarded_m
    speeds_m_s = (config.unseen_m_s, config.approach_lag_m / lag_s, config.guarded_m_s)
    assert config.guarded_m_s < speeds_m_s[1] < 0.05
    for time_s, speed_m_s in zip(times_s[1:], speeds_m_s, strict=True):
        slower_s = way_m / speed_m_s - way_m / config.approach_m_s
        assert time_s - times_s[0] == pytest.approx(slower_s, abs=0.3)


def test_what_is_out_of_reach_is_infeasible():
    with open_world("drawer", seed=1, noise="clean") as episode:
        far = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([1.5, 0.0, 0.5]))
        with pytest.raises(MotionInfeasible):
            next(episode.arm.grasp(far, TICK_S))
        here = episode.arm.T_world_gripper()
        path = HandPath(np.array([0.0, 1.0]), (here, far), WayLimits(1.0, 1.0, 1.0))
        with pytest.raises(MotionInfeasible):
            next(episode.arm.follow(path, TICK_S))


def test_an_off_centre_grasp_is_centred_and_pulling_what_does_not_give_ends():
    with open_world("drawer", seed=1, noise="clean") as episode:
        arm, world = episode.arm, episode.world
        aside = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.006, 0.0]))
        run(arm.grasp(episode.T_world_grasp * aside, TICK_S))
        left, right = arm.gripper.travel_m()
        assert abs(left - right) < 5e-4
        forces = finger_forces_n(episode)
        assert 50.0 < min(forces) and max(forces) < 1.1 * arm.gripper.config.force_n
        sideways = episode.T_world_grasp.rotation().matrix()[:, 1]  # across the bar
        start = world.time_s
        run(arm.pull(sideways, 0.2, TICK_S))
        assert world.time_s - start < 10.0
        assert world.part_state() < 0.02
        assert arm.holding()


REPEATED = """
import hashlib, sys
from itertools import islice
from sim.episode import open_world
with open_world("door", 2, "d455") as episode:
    arm, recorder, digest = episode.arm, episode.arm.record(), hashlib.sha256()
    motions = [arm.grasp(episode.T_world_grasp, 0.3)]
    ticks = 5
    if "whole" in sys.argv:
        motions, ticks = [*motions, arm.pull(episode.pull_direction_world, 0.1, 0.3)], None
    for motion in motions:
        for _ in islice(motion, ticks):
            pass
        frame = episode.camera.capture()
        digest.update(frame.rgb.tobytes() + frame.depth_m.tobytes())
    motion = recorder.motion()
    digest.update(motion.q.tobytes() + motion.dq.tobytes() + motion.tau.tobytes())
    print(len(motion.q), digest.hexdigest())
"""


@pytest.mark.parametrize("part", ["start", pytest.param("whole", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bytes_in_another_process(part: str):
    command = [sys.executable, "-c", REPEATED, part]
    processes = [
        subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONHASHSEED": seed}
        )
        for seed in ("1", "2")
    ]
    outcomes = [process.communicate()[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert int(outcomes[0].split()[0]) >= 1500
    assert outcomes[0] == outcomes[1]


def test_an_unknown_noise_level_is_refused():
    with pytest.raises(ValueError, match="clean, d455"), open_world("door", noise="loud"):
        pass
