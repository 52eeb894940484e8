"""Where a part that stands open is pushed towards closed: on its front, with closed fingers.

For what no hand can hold: a drawer that is drawn out to the robot's base, a handle that is hidden
or has slipped away. A light part gives way before it is felt, so the hand does not feel for it: it
goes to where its tips are on the front as it should be in the end. A push only goes one way; what
it did is seen when the hand has left.
"""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.spatial import cKDTree

from akm_fg.arm.motion.reaching import standoff
from akm_fg.errors import MotionInfeasible
from akm_fg.interfaces import Arm
from akm_fg.manipulation.board_grasps import Front, front_of
from akm_fg.manipulation.carried_grasps import way_of
from akm_fg.manipulation.config import HoldConfig, PushConfig
from akm_fg.model.records import ModelPart
from akm_fg.records import FloatArray


def choose_push(
    arm: Arm, part: ModelPart, q: float, q_target: float, config: PushConfig, hold: HoldConfig
) -> tuple[gtsam.Pose3, float]:
    """The hand's pose with its tips on the front, and the share of the way that it gets to.

    Args:
        arm: is asked what it reaches.
        part: with its contacts.
        q: its state.
        q_target: where it should be: nearer to closed.
        config: tuning.
        hold: how a front is found, and how many poses of the way are asked for.

    Raises:
        MotionInfeasible: the part has no front that goes that way, or the arm gets to none.
    """
    front = front_of(part, part.contacts[0], hold.board) if part.contacts else None
    if front is None:
        raise MotionInfeasible("no front is known that could be pushed")
    best: tuple[gtsam.Pose3, float] | None = None
    refusal: MotionInfeasible | None = None
    asked = 0
    for p_part in _places(part, front, q, q_target, config):
        for roll in config.rolls_rad:
            if asked == config.most:
                break
            asked += 1
            T = part.T_world_part(q) * _pose(p_part, front.normal, roll, config)
            way = way_of(part, T, q, q_target, hold)
            try:
                reach = arm.reachable(standoff(T, config.before_m), way)
            except MotionInfeasible as error:
                refusal = refusal or error
                continue
            if best is None or reach > best[1]:
                best = T, reach
            if reach >= config.enough:
                return best
    if best is None or best[1] < config.least:
        raise refusal or MotionInfeasible("no place of its front can be pushed far enough")
    return best


def _places(
    part: ModelPart, front: Front, q: float, q_target: float, config: PushConfig
) -> list[FloatArray]:
    """Points (3,) of the front, in the part's frame, where a push moves it: the best first.

    Of what turns, those with the longest lever; of what slides, those in the middle, where it
    does not jam.
    """
    n, p = front.normal, front.p
    x = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    plane = np.column_stack([x, np.cross(n, x)])
    everything = part.surface.p_world
    sticks = everything[everything @ n > front.depth_m + config.sticks_out_m]
    uv, uv_sticks = p @ plane, sticks @ plane
    tree = cKDTree(uv)
    free = np.ones(len(p), dtype=bool)
    if len(sticks):
        free = cKDTree(uv_sticks).query(uv)[0] > config.clear_m
    T_world_part = part.T_world_part(q)
    R = T_world_part.rotation().matrix()
    p_world = p @ R.T + T_world_part.translation()
    towards = float(np.sign(q_target - q))
    velocity = towards * np.array([part.joint.joint.velocity(each) for each in p_world])
    speed = np.linalg.norm(velocity, axis=1)
    inwards = -velocity @ (R @ n)
    free &= inwards > config.facing * np.maximum(speed, 1e-9)
    middle = uv.mean(axis=0)
    score = speed if part.joint.turns else -np.linalg.norm(uv - middle, axis=1)
    chosen: list[int] = []
    for k in np.argsort(-score):
        if not free[k] or any(
            np.linalg.norm(uv[k] - uv[other]) < config.apart_m for other in chosen
        ):
            continue
        around = uv[tree.query_ball_point(uv[k], config.clear_m)] - uv[k]
        quarter = (around[:, 0] > 0.0) + 2 * (around[:, 1] > 0.0)
        if np.bincount(quarter, minlength=4).min() < config.quarter_points:
            continue
        chosen.append(int(k))
        if len(chosen) == config.most:
            break
    return [p[k] for k in chosen]


def _pose(p_part: FloatArray, normal: FloatArray, roll: float, config: PushConfig) -> gtsam.Pose3:
    """The gripper with its tips on a place of the front; its x is level at no roll."""
    z = -normal
    x = np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    R = gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])) * gtsam.Rot3.Rz(roll)
    return gtsam.Pose3(R, p_part - config.tip_m * z)
