"""A joint and the states of some frames: where a fit starts, or how perception saw a part go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from akm_fg.records import FloatArray
from factors.joint import Joint, JointKind, cross

TURN_ABOUT_X = np.array([1.0, -1.0, -1.0])  # half a turn, as a diagonal


@dataclass(frozen=True, slots=True)
class JointGuess:
    """A joint and states."""

    joint: Joint
    q: FloatArray  # (T,), zero in frame 0

    @property
    def kind(self) -> JointKind:
        """Of the joint."""
        return self.joint.kind

    def motion(self) -> tuple[FloatArray, FloatArray]:
        """The part's motion from frame 0 in all frames: (T, 3, 3) and (T, 3), world."""
        return self.joint.motion(self.q)

    def turned(self) -> JointGuess:
        """The same motions with the axis the other way: the joint frame turned about its x."""
        T = self.joint.T_world_joint.copy()
        T[:3, :3] = T[:3, :3] @ np.diag(TURN_ABOUT_X)
        return JointGuess(replace(self.joint, T_world_joint=T), -self.q)

    def restricted(self, frames: np.ndarray) -> JointGuess:
        """Over some of its frames (indices), the first of them at state zero."""
        return replace(self, q=self.q[frames] - self.q[frames[0]])


def joint_frame(axis_world: FloatArray, origin_world: FloatArray) -> FloatArray:
    """T_world_joint (4, 4) with z along a unit axis; the heading of x is arbitrary."""
    z = axis_world / np.linalg.norm(axis_world)
    x = cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, cross(z, x), z], axis=1)
    T[:3, 3] = origin_world
    return T


def still(frames: int) -> JointGuess:
    """Nothing moved: a prismatic joint that stays at state zero."""
    return JointGuess(Joint(JointKind.PRISMATIC, np.eye(4), 0.0), np.zeros(frames))
