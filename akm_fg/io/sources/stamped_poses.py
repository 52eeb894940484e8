"""Poses with the times at which they hold, looked up between them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray

LONGEST_GAP_S = 0.25
"""Between two poses that are interpolated; a hand-held camera turns by ten degrees in it."""
ROW = "a row `stamp x y z qx qy qz qw`"
QUATERNION_TOLERANCE = 0.02  # of its length: four decimals, not a wrong column


@dataclass(frozen=True, slots=True)
class StampedPoses:
    """Poses in the order of their stamps; a single one holds always."""

    stamps_s: FloatArray  # (M,) strictly growing
    poses: tuple[gtsam.Pose3, ...]  # M

    @classmethod
    def ordered(cls, stamps_s: FloatArray, poses: list[gtsam.Pose3]) -> StampedPoses:
        """Of any order; of several with one stamp the first counts."""
        stamps, first = np.unique(stamps_s, return_index=True)
        return cls(stamps, tuple(poses[i] for i in first))

    def at(self, stamp_s: float) -> gtsam.Pose3 | None:
        """The pose at this time, along the geodesic between its neighbours; None if unknown."""
        if len(self.poses) == 1:
            return self.poses[0]
        after = int(np.searchsorted(self.stamps_s, stamp_s))
        if after < len(self.poses) and self.stamps_s[after] == stamp_s:
            return self.poses[after]
        if not 0 < after < len(self.poses):
            return self._nearest_end(stamp_s)
        begin_s, end_s = self.stamps_s[after - 1], self.stamps_s[after]
        if end_s - begin_s > LONGEST_GAP_S:
            return None
        share = float((stamp_s - begin_s) / (end_s - begin_s))
        return between(self.poses[after - 1], self.poses[after], share)

    def _nearest_end(self, stamp_s: float) -> gtsam.Pose3 | None:
        """The first or last pose, as far beyond it as half their usual distance in time."""
        reach_s = min(float(np.median(np.diff(self.stamps_s))) / 2.0, LONGEST_GAP_S)
        end = 0 if stamp_s < self.stamps_s[0] else -1
        near = abs(stamp_s - float(self.stamps_s[end])) <= reach_s
        return self.poses[end] if near else None


def between(one: gtsam.Pose3, other: gtsam.Pose3, share: float) -> gtsam.Pose3:
    """The pose `share` of the way: straight, turning about one axis."""
    turned = one.rotation().slerp(share, other.rotation())
    return gtsam.Pose3(turned, (1 - share) * one.translation() + share * other.translation())


def pose_of(p: FloatArray, quaternion: FloatArray) -> gtsam.Pose3 | None:
    """Of a position (3,) and a quaternion (4,) with w last; None where that is no rotation."""
    if not (np.isfinite(p).all() and np.isfinite(quaternion).all()):
        return None
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > QUATERNION_TOLERANCE:
        return None
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), np.asarray(p, dtype=np.float64))


def read_tum_poses(path: Path, text: str) -> StampedPoses:
    """Rows `stamp x y z qx qy qz qw`, # for comments.

    Raises:
        InputError: a row that is none, or no row.
    """
    stamps, poses = [], []
    for number, line in enumerate(text.splitlines(), 1):
        row = line.split("#", 1)[0].replace(",", " ").split()
        if not row:
            continue
        try:
            values = np.array([float(word) for word in row])
        except ValueError as e:
            raise InputError(path, f"line {number}: {line[:60]!r} holds a word", ROW) from e
        if len(values) != 8:
            raise InputError(path, f"line {number}: {len(values)} columns", ROW)
        pose = pose_of(values[1:4], values[4:]) if np.isfinite(values[0]) else None
        if pose is None:
            raise InputError(path, f"line {number}: no unit quaternion, or not finite", ROW)
        stamps.append(values[0])
        poses.append(pose)
    if not poses:
        raise InputError(path, "has no rows", ROW)
    return StampedPoses.ordered(np.array(stamps), poses)
