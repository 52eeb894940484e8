"""An arm that stands where an object's part is put is put out of its way."""

from __future__ import annotations

import itertools

import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.body.model import N_ARM
from akm_fg.records import FloatArray
from sim.bullet import p
from sim.robot.contacts import nearby

NEAR_M = 0.03  # between robot and object: nearer is in the way
# Where the arm may be put: turned aside, and drawn back.
TURNS_RAD = tuple(np.deg2rad([90.0, -90.0, 130.0, -130.0]))  # of the first axis, from home
BACK_RAD = (0.0, -0.9)  # of the second


def clearance_m(client: int, robot: int, thing: int) -> float:
    """Between robot and object as they stand now, `NEAR_M` at most; negative in each other."""
    near = nearby(client, robot, thing, NEAR_M)
    return min((points.distance_m for points in near), default=NEAR_M)


def stand_aside(client: int, robot: int, thing: int) -> float:
    """Put the arm where it is clear of the object; else the farthest from it that there is.

    It stays where it is if it is clear of it, or nowhere farther: an object as near as the robot's
    base is near to every posture.

    Returns:
        The clearance then, as `clearance_m` has it.
    """
    best_m, best = clearance_m(client, robot, thing), arm_angles(client, robot)
    if best_m >= NEAR_M:
        return best_m
    aside = (
        Q_HOME + np.array([turn_rad, back_rad, *[0.0] * (N_ARM - 2)])
        for back_rad, turn_rad in itertools.product(BACK_RAD, TURNS_RAD)
    )
    for q in aside:
        put_arm(client, robot, q)
        apart_m = clearance_m(client, robot, thing)
        if apart_m > best_m:
            best_m, best = apart_m, q
        if best_m >= NEAR_M:
            break
    put_arm(client, robot, best)
    return best_m


def arm_angles(client: int, robot: int) -> FloatArray:
    """(7,) rad, true."""
    states = p.getJointStates(robot, range(N_ARM), physicsClientId=client)
    return np.array([state[0] for state in states])


def put_arm(client: int, robot: int, q: FloatArray) -> None:
    """The arm is at joint angles (7,) rad, at rest."""
    for j in range(N_ARM):
        p.resetJointState(robot, j, q[j], physicsClientId=client)
