"""The doors to hardware, simulators and perception backends.

Each Protocol has a default that needs no weights and no network. The simulator's camera and
arm fit by shape alone, so that a real one can too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import BoolArray, FloatArray, HandPath, RgbdFrame


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

    def reachable(self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3] = ()) -> float:
        """Share of the poses that the hand gets to from a grasp, one after the other.

        Raises:
            MotionInfeasible: the grasp cannot be reached, or not without touching something.
        """
        ...

    def can_follow(self, poses: Sequence[gtsam.Pose3]) -> int:
        """How many of the poses the hand gets to from where it is, one after the other."""
        ...

    def grasp(
        self,
        T_world_grasp: gtsam.Pose3,
        tick_s: float,
        feel_m: float = 0.0,
        onward: Sequence[gtsam.Pose3] = (),
    ) -> Iterator[None]:
        """Move clear of what was seen to a pre-grasp, approach along the gripper's z, close.

        With `feel_m`, how far that is along z is only known to so much: the hand goes on by as far
        until something stops it, which may be as far before the grasp, and closes there. `onward`
        is where the hand will go while it holds, as far as that is known.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: the fingers met with nothing between them.
        """
        ...

    def close_and_reach(
        self, T_world_wanted: gtsam.Pose3, tick_s: float, onward: Sequence[gtsam.Pose3] = ()
    ) -> Iterator[None]:
        """Let go, and move clear of what was seen to a pose, with closed fingers: to push.

        `onward` is where the hand will go from there, as far as that is known.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: something was met on the way.
        """
        ...

    def step_aside(self, frame: RgbdFrame, tick_s: float, unseen: bool = False) -> Iterator[None]:
        """Let go, and go where the arm hides little from the camera that took the frame.

        With `unseen`, little of what this frame does not show: for a second look.
        Stays where it is after letting go if no such place can be reached.
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

    def relax(self, tick_s: float) -> Iterator[None]:
        """After a motion that was not iterated to its end: come to rest, and let the force fade."""
        ...

    def follow(self, path: HandPath, tick_s: float) -> Iterator[None]:
        """Follow a path compliantly, and wait until the arm has come to rest.

        Raises:
            MotionInfeasible: a pose of the path cannot be reached.
        """
        ...


class ObjectSegmenter(Protocol):
    """Finds the object in one frame."""

    def segment(self, frame: RgbdFrame) -> BoolArray:
        """(H, W), True on the object."""
        ...


@dataclass(frozen=True, slots=True)
class GraspCandidate:
    """A pose of the hand in which closing the fingers may hold something."""

    T_world_grasp: gtsam.Pose3  # of the point between the fingertips; axes as in `Arm`
    quality: float  # probability that the grasp holds when it is pulled with 40 to 80 N
    width_m: float  # between the fingers once they have closed

    def __post_init__(self) -> None:
        if not 0.0 <= self.quality <= 1.0:
            raise ValueError(f"quality {self.quality}, expected a probability")


class GraspSampler(Protocol):
    """Proposes grasps about a contact, from one frame. Whether the arm gets there it cannot know.

    Candidates come best first; none is an answer too.
    """

    def sample(
        self,
        frame: RgbdFrame,
        mask: BoolArray,
        p_world_contact: FloatArray,
        normal_world: FloatArray,
        *,
        at_edge: bool = False,
    ) -> tuple[GraspCandidate, ...]:
        """Grasps about a contact (3,), given the unit normal (3,) of the front it belongs to.

        Args:
            frame: the robot's own pixels carry no depth.
            mask: (H, W) the object.
            p_world_contact: on the surface that is seen.
            normal_world: out of the object.
            at_edge: nothing sticks out there that fingers close around, as far as is known: it is
                the edge of a board.

        Raises:
            ValueError: a mask of another size, or a contact or normal that is not finite.
        """
        ...


@dataclass(frozen=True, slots=True)
class SeenPixels:
    """The followed points that one frame shows."""

    index: NDArray[np.int_]  # (M,) growing: points are numbered as they were given
    uv: FloatArray  # (M, 2), x right, y down, pixel centres at integers
    cov_px2: FloatArray  # (M, 2, 2) of uv: long along an edge, where a point may slip
    # (M, 2, 2) of that, what points bring from the frames before; None: nothing is known of it.
    lasting_px2: FloatArray | None = None

    def __post_init__(self) -> None:
        m = len(self.index)
        if self.uv.shape != (m, 2) or self.cov_px2.shape != (m, 2, 2):
            raise ValueError(f"{m} points, but uv {self.uv.shape}, cov_px2 {self.cov_px2.shape}")
        if self.lasting_px2 is not None and self.lasting_px2.shape != (m, 2, 2):
            raise ValueError(f"{m} points, but lasting_px2 {self.lasting_px2.shape}")

    @staticmethod
    def none() -> SeenPixels:
        """No point at all."""
        none = np.zeros((0, 2, 2))
        return SeenPixels(np.zeros(0, dtype=int), np.zeros((0, 2)), none, none)

    def joined(self, other: SeenPixels) -> SeenPixels:
        """These points, and then the others."""
        return SeenPixels(
            np.concatenate([self.index, other.index]),
            np.concatenate([self.uv, other.uv]),
            np.concatenate([self.cov_px2, other.cov_px2]),
            None
            if self.lasting_px2 is None or other.lasting_px2 is None
            else np.concatenate([self.lasting_px2, other.lasting_px2]),
        )


class TrackingSession(Protocol):
    """Points followed through one stream of frames. What a frame shows is never taken back."""

    def advance(self, frame: RgbdFrame) -> SeenPixels:
        """Find the points in the next frame. Those that are not seen in it are left out."""
        ...

    def follow(self, uv: FloatArray) -> SeenPixels:
        """Follow pixels (K, 2) of the last frame too, from there on.

        Returns these points in that frame: all of them, at these pixels, in this order.

        Raises:
            ValueError: no frame yet, or a pixel outside the image.
        """
        ...


class PointTracker(Protocol):
    """Follows pixels from frame to frame; frames are shown once, in the order of their time."""

    def begin(self) -> TrackingSession:
        """Start on a new stream, without a memory of others."""
        ...


@dataclass(frozen=True, slots=True)
class FeatureMap:
    """What a network sees at the cells of a grid that is laid over an object in an image."""

    features: NDArray[np.float32]  # (h, w, C), row by row, minus `descriptor`
    descriptor: NDArray[np.float32]  # (C,) of the whole: mean of the cells on the object
    uv_first: FloatArray  # (2,) pixel at the middle of cell (0, 0)
    step_px: float  # from one cell to the next, along u and along v
    made_by: str  # network, layer and size: other makers' features are not comparable

    def __post_init__(self) -> None:
        shape, c = self.features.shape, self.descriptor.shape
        if len(shape) != 3 or min(shape) < 1 or c != shape[2:]:
            raise ValueError(f"features {shape}, descriptor {c}; expected (h, w, C) and (C,)")
        if self.uv_first.shape != (2,) or not self.step_px > 0:
            raise ValueError(f"uv_first {self.uv_first.shape}, step_px {self.step_px}")

    def at(self, uv: FloatArray) -> NDArray[np.float32]:
        """(N, C) at pixels (N, 2), bilinear between cells; outside, of the nearest border."""
        last = np.array(self.features.shape[1::-1]) - 1.0
        cell = np.clip((uv - self.uv_first) / self.step_px, 0.0, last)
        low = np.minimum(np.floor(cell), np.maximum(last - 1.0, 0.0)).astype(int)
        high = np.minimum(low + 1, last.astype(int))
        right, down = (cell - low).astype(np.float32).T[:, :, None]
        (j0, i0), (j1, i1) = low.T, high.T
        upper = (1.0 - right) * self.features[i0, j0] + right * self.features[i0, j1]
        lower = (1.0 - right) * self.features[i1, j0] + right * self.features[i1, j1]
        return np.asarray((1.0 - down) * upper + down * lower)


class DenseFeatures(Protocol):
    """Describes the places of an object, so that alike places of other objects are found."""

    def describe(self, rgb: NDArray[np.uint8], mask: BoolArray) -> FeatureMap:
        """The features over the object.

        Args:
            rgb: (H, W, 3).
            mask: (H, W), True on the object.

        Raises:
            ValueError: sizes that differ, or a mask without a pixel.
        """
        ...
