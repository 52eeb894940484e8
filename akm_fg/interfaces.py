"""The doors to hardware, simulators and perception backends.

Each Protocol has a default that needs no weights and no network. The simulator's camera and
arm fit by shape alone, so that a real one can too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import gtsam

from akm_fg.records import BoolArray, FloatArray, PixelTracks, RgbdFrame, TimedPath

NewQueries = Callable[[int, FloatArray], FloatArray]
"""(number of a frame, pixels (M, 2) that are followed in it) -> more pixels (K, 2) to follow."""


class Camera(Protocol):
    """A fixed, calibrated RGB-D camera."""

    def capture(self) -> RgbdFrame:
        """The scene now. Pixels that show the robot carry no depth."""
        ...


class Arm(Protocol):
    """A robot arm with a parallel gripper. Poses are of the point between the fingertips.

    Gripper axes: z forward (approach), y along the finger opening. Motions are iterators: they
    execute while iterated and hand control back every `tick_s` seconds of motion, so that the
    caller can look (``for _ in arm.pull(...): frames.append(camera.capture())``).
    """

    def T_world_gripper(self) -> gtsam.Pose3:
        """The measured gripper pose (forward kinematics of the measured joints)."""
        ...

    def see(self, frame: RgbdFrame) -> None:
        """Keep clear, from now on, of what this frame shows.

        The frame is of this moment; it replaces what was seen before. Without any, the arm knows
        only what it was set up with, such as the floor.
        """
        ...

    def grasp(self, T_world_grasp: gtsam.Pose3, tick_s: float) -> Iterator[None]:
        """Move clear of what was seen to a pre-grasp, approach along the gripper's z, close.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: the fingers met with nothing between them.
        """
        ...

    def holding(self) -> bool:
        """Whether something is between the closed fingers."""
        ...

    def pull(self, direction_world: FloatArray, distance_m: float, tick_s: float) -> Iterator[None]:
        """Pull gently, starting along a unit vector, and follow where the part lets the hand go.

        Ends after `distance_m` of travelled path, or when the part does not give.
        """
        ...

    def follow(self, path: TimedPath, tick_s: float) -> Iterator[None]:
        """Follow a timed path compliantly, and wait until the arm has come to rest.

        Raises:
            MotionInfeasible: a pose of the path cannot be reached.
        """
        ...


class ObjectSegmenter(Protocol):
    """Finds the object in one frame."""

    def segment(self, frame: RgbdFrame) -> BoolArray:
        """(H, W), True on the object."""
        ...


class PointTracker(Protocol):
    """Follows given pixels through a clip.

    Returns exactly the queried points in the given order, then those asked for on the way; where
    a point is lost, `visible` is False, `uv` and `cov_px2` are NaN.
    """

    def track(
        self,
        frames: Sequence[RgbdFrame],
        queries_uv: FloatArray,
        query_frames: Sequence[int],
        new_queries: NewQueries | None = None,
    ) -> PixelTracks:
        """Tracks of N pixels (N, 2), each starting in its frame of `query_frames` (N,).

        Frames before the start are lost (not tracked backwards). `new_queries` is asked in every
        frame, in their order, for pixels to follow from that frame on: where what is followed
        decides what else to follow, one pass through the clip does.
        """
        ...
