"""The tree of transforms of a bag (tf), looked up over time."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from akm_fg.io.sources.stamped_poses import StampedPoses, pose_of
from akm_fg.records import FloatArray


def seconds(stamp: Any) -> float:
    """Of a ROS 1 or ROS 2 time."""
    fraction = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    return float(stamp.sec) + 1e-9 * float(fraction)


def pose_of_message(pose: Any) -> gtsam.Pose3 | None:
    """Of a geometry_msgs Pose or Transform; None where it is no rotation."""
    p = pose.position if hasattr(pose, "position") else pose.translation
    r = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return pose_of(np.array([p.x, p.y, p.z]), np.array([r.x, r.y, r.z, r.w]))


def frame_name(name: str) -> str:
    """Without the slash that ROS 1 put before it."""
    return str(name).lstrip("/")


class Transforms:
    """Collects transforms from parent to child and chains them."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._stamps: dict[str, list[float]] = {}
        self._poses: dict[str, list[gtsam.Pose3]] = {}
        self._edges: dict[str, StampedPoses] = {}
        self._static: set[str] = set()

    def add(self, transform: Any, static: bool) -> None:
        """One TransformStamped."""
        pose = pose_of_message(transform.transform)
        child, parent = frame_name(transform.child_frame_id), frame_name(transform.header.frame_id)
        if pose is None or child == parent:
            return
        self._edges.pop(child, None)
        if static or self._parent.get(child, parent) != parent:
            self._stamps[child], self._poses[child] = [], []
        self._parent[child] = parent
        self._stamps.setdefault(child, []).append(seconds(transform.header.stamp))
        self._poses.setdefault(child, []).append(pose)
        (self._static.add if static else self._static.discard)(child)

    def chain(self, frame: str) -> list[str]:
        """The frame and all above it, the root last."""
        found = [frame_name(frame)]
        while (parent := self._parent.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def moves(self, frame: str, above: str) -> bool:
        """Whether anything on the way up is told more than once."""
        chain = self.chain(frame)
        way = chain[: chain.index(frame_name(above))]
        return any(child not in self._static for child in way)

    def T_above_frame(self, frame: str, above: str, stamp_s: float) -> gtsam.Pose3 | None:
        """The pose of a frame in one above it; None where nothing is known at this time."""
        chain, T = self.chain(frame), gtsam.Pose3()
        for child in chain[: chain.index(frame_name(above))]:
            edge = self._edge(child).at(stamp_s)
            if edge is None:
                return None
            T = edge * T
        return T

    def between(self, one: str, other: str, stamp_s: float) -> gtsam.Pose3 | None:
        """T_one_other by the nearest frame above both; None where they hang on nothing common."""
        above_other = self.chain(other)
        shared = next((name for name in self.chain(one) if name in above_other), None)
        if shared is None:
            return None
        T_shared_one = self.T_above_frame(one, shared, stamp_s)
        T_shared_other = self.T_above_frame(other, shared, stamp_s)
        if T_shared_one is None or T_shared_other is None:
            return None
        return T_shared_one.inverse() * T_shared_other

    def poses(self, frame: str, world: str, stamps_s: FloatArray) -> StampedPoses | None:
        """T_world_frame at these times, as far as known; None if never."""
        found = [(s, self.between(world, frame, float(s))) for s in stamps_s]
        known = [(s, pose) for s, pose in found if pose is not None]
        if not known:
            return None
        return StampedPoses.ordered(np.array([s for s, _ in known]), [pose for _, pose in known])

    def _edge(self, child: str) -> StampedPoses:
        if child not in self._edges:
            stamps = np.array(self._stamps[child])
            self._edges[child] = StampedPoses.ordered(stamps, self._poses[child])
        return self._edges[child]
