"""The one door to PyBullet: import it, connect, load, without its chatter on standard output."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray


@contextmanager
def quiet() -> Iterator[None]:
    """Sends what native code prints on standard output and error to nowhere.

    PyBullet prints its build time on import and a line for each link without inertia; standard
    output belongs to the caller (it may be JSON).
    """
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        for fd in (*saved, nowhere):
            os.close(fd)


with quiet():
    import pybullet

p: Any = pybullet


def connect() -> int:
    """A client of its own, without a display.

    PyBullet would keep every mesh and texture it reads until the process ends, 25 MB an object;
    only the robot's are worth it (`load_urdf`).
    """
    with quiet():
        client = int(p.connect(p.DIRECT))
    p.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    return client


def load_urdf(
    client: int,
    path: Path,
    T_world_base: gtsam.Pose3,
    flags: int = 0,
    keep_files: bool = False,
) -> int:
    """Loads a URDF with its base fixed and the default joint motors off; returns the body id.

    Args:
        client: where to.
        path: of the URDF.
        T_world_base: where it stands.
        flags: PyBullet's, beside colours from materials.
        keep_files: whether PyBullet may keep what it reads: of bodies that are loaded again.

    Raises:
        pybullet.error: the file cannot be loaded.
    """
    p.setPhysicsEngineParameter(enableFileCaching=int(keep_files), physicsClientId=client)
    with quiet():
        body = p.loadURDF(
            str(path),
            T_world_base.translation().tolist(),
            quaternion_xyzw(T_world_base.rotation()),
            useFixedBase=True,
            flags=flags | p.URDF_USE_MATERIAL_COLORS_FROM_MTL,
            physicsClientId=client,
        )
    p.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    for joint in range(p.getNumJoints(body, physicsClientId=client)):
        kind = p.getJointInfo(body, joint, physicsClientId=client)[2]
        if kind in (p.JOINT_REVOLUTE, p.JOINT_PRISMATIC):
            p.setJointMotorControl2(
                body, joint, p.VELOCITY_CONTROL, force=0.0, physicsClientId=client
            )
    return int(body)


def joint_index(client: int, body: int, name: str) -> int:
    """Index of the joint called `name`.

    Raises:
        ValueError: the body has no such joint.
    """
    names = [
        p.getJointInfo(body, j, physicsClientId=client)[1].decode()
        for j in range(p.getNumJoints(body, physicsClientId=client))
    ]
    if name not in names:
        raise ValueError(f"no joint {name!r}; there are {', '.join(names)}")
    return names.index(name)


def quaternion_xyzw(rotation: gtsam.Rot3) -> list[float]:
    """The quaternion in PyBullet's order."""
    q: Any = rotation.toQuaternion()
    return [q.x(), q.y(), q.z(), q.w()]


def pose_from_matrix(T: NDArray) -> gtsam.Pose3:
    """A Pose3 of a 4x4 matrix."""
    return gtsam.Pose3(np.asarray(T, dtype=float))
