"""The model of an object, as `model.json` holds it. Format: docs/model.md.

The frame of a part is the world's while the part is closed: a point with part coordinates p is at

    p_world(q) = T_world_part(q) p,   T_world_part(q) = M(q) M(closed_state)^-1,

where M(q) is the joint's motion from its state zero (`factors.joint`). Surfaces are in that frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.posterior import ArticulationPosterior, JointPosterior, StatePosterior
from akm_fg.records import BoolArray, CameraCorrection, FloatArray, PinholeCamera, RgbdFrame


@dataclass(frozen=True, slots=True)
class Surface:
    """N points of a surface, in the world frame with the part closed."""

    p_world: FloatArray  # (N, 3) metres
    normal_world: FloatArray  # (N, 3) unit, towards the cameras that saw it
    rgb: NDArray[np.uint8]  # (N, 3)
    on_object: BoolArray | None = None  # (N,) of what rests: the object's own, not floor or wall

    def __post_init__(self) -> None:
        n = len(self.p_world)
        for name, array in (("points", self.p_world), ("normals", self.normal_world)):
            if array.shape != (n, 3) or not np.isfinite(array).all():
                raise ValueError(f"{name} {array.shape}, expected ({n}, 3) finite numbers")
        if self.rgb.shape != (n, 3) or self.rgb.dtype != np.uint8:
            raise ValueError(f"colours {self.rgb.shape} {self.rgb.dtype}, expected ({n}, 3) uint8")
        own = self.on_object
        if own is not None and (own.shape != (n,) or own.dtype != np.bool_):
            raise ValueError(f"on_object {own.shape} {own.dtype}, expected ({n},) truth values")

    def select(self, chosen: BoolArray) -> Surface:
        """The points where this (N,) mask is True."""
        own = None if self.on_object is None else self.on_object[chosen]
        return Surface(self.p_world[chosen], self.normal_world[chosen], self.rgb[chosen], own)

    def moved(self, T: gtsam.Pose3) -> Surface:
        """As it is after a rigid motion."""
        R = T.rotation().matrix()
        p = self.p_world @ R.T + T.translation()
        return Surface(p, self.normal_world @ R.T, self.rgb, self.on_object)

    @property
    def objects_own(self) -> Surface:
        """Without floor and wall, where that is known."""
        return self if self.on_object is None else self.select(self.on_object)

    def __len__(self) -> int:
        return len(self.p_world)

    def __repr__(self) -> str:
        return f"<Surface of {len(self)} points>"


@dataclass(frozen=True, slots=True)
class StateLimits:
    """Where the joint stops, in its own states; `sd` is that of either."""

    lower: float
    upper: float
    sd: float

    def __post_init__(self) -> None:
        numbers = (self.lower, self.upper, self.sd)
        if not (np.isfinite(numbers).all() and self.lower < self.upper and self.sd >= 0):
            raise ValueError(f"limits {numbers}, expected lower < upper and sd >= 0, all finite")


@dataclass(frozen=True, slots=True)
class Contact:
    """A grasp that was tried, and how it went."""

    T_part_grasp: gtsam.Pose3
    state: float  # of the joint when it was taken
    succeeded: int = 0
    failed: int = 0


@dataclass(frozen=True, slots=True)
class ModelPart:
    """A part that moves.

    Raises:
        ValueError: its posterior has no joint, or the closed state is no number.
    """

    name: str
    posterior: ArticulationPosterior
    surface: Surface
    closed_state: float = 0.0  # in the joint's states, which are zero in its recording's frame 0
    limits: StateLimits | None = None  # None: not met
    contacts: tuple[Contact, ...] = ()
    sources: tuple[str, ...] = ()  # recordings of this part; none: those of the whole model
    # Surfaces are where the camera sees them. None: that is where they are.
    correction: CameraCorrection | None = None

    def __post_init__(self) -> None:
        if self.posterior.best.joint is None:
            raise ValueError(f"{self.name}: the posterior has no joint")
        if not np.isfinite(self.closed_state):
            raise ValueError(f"{self.name}: closed at {self.closed_state}, expected a number")

    @property
    def joint(self) -> JointPosterior:
        """Of the most probable kind."""
        joint = self.posterior.best.joint
        assert joint is not None
        return joint

    @property
    def states(self) -> StatePosterior | None:
        """That were seen in the recording of the posterior."""
        return self.posterior.best.states

    def T_world_part(self, q: float) -> gtsam.Pose3:
        """Where the part's frame is at a state."""
        return _motion(self.joint, q) * _motion(self.joint, self.closed_state).inverse()

    @property
    def T_world_seen(self) -> gtsam.Pose3:
        """Takes what the camera puts at a place to where it is."""
        return gtsam.Pose3() if self.correction is None else self.correction.T_world_seen

    def corrected(self, frame: RgbdFrame) -> RgbdFrame:
        """A frame of the camera that saw the part, put where the part's own joint is right."""
        return replace(frame, T_world_cam=self.T_world_seen * frame.T_world_cam)

    @property
    def seen_joint(self) -> JointPosterior:
        """The joint as the camera sees it, in the world of its calibration; see `seen_state`."""
        if self.correction is None:
            return self.joint
        T = self.correction.T_world_seen.inverse() * gtsam.Pose3(self.joint.T_world_joint)
        seen = replace(self.joint.joint, T_world_joint=T.matrix())
        return replace(self.joint, joint=seen, cov=self.correction.cov_seen_joint)

    def seen_state(self, q: float) -> float:
        """A state as the camera sees it: lengths are what they seem to it."""
        return q if self.correction is None else q / (1.0 + self.correction.length_share)

    def T_seen_part(self, q: float) -> gtsam.Pose3:
        """Where the camera sees the part's frame at a state: for its surface."""
        joint = self.seen_joint
        here, closed = (_motion(joint, self.seen_state(x)) for x in (q, self.closed_state))
        return here * closed.inverse()

    def range_seen(self) -> tuple[float, float]:
        """Least and greatest state that are known: those seen, the closed one, and limits met."""
        seen = [self.closed_state]
        if self.states is not None:
            seen += [float(q) for q in self.states.mean if np.isfinite(q)]
        low, high = min(seen), max(seen)
        if self.limits is not None:
            low, high = self.limits.lower, self.limits.upper
        return low, high


def _motion(joint: JointPosterior, q: float) -> gtsam.Pose3:
    (R,), (t,) = joint.joint.motion(np.array([q]))
    return gtsam.Pose3(gtsam.Rot3(R), t)


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """An object: parts that move, what rests, and the camera that saw them."""

    parts: tuple[ModelPart, ...]
    static: Surface  # what rests near the parts, as far as it was seen
    camera: PinholeCamera
    T_world_cam: gtsam.Pose3  # in the first frame
    sources: tuple[str, ...] = ()  # recordings it was made from

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("a model needs at least one part that moves")
        names = [part.name for part in self.parts]
        if len(set(names)) < len(names):
            raise ValueError(f"parts {names}: a name stands twice")

    def __repr__(self) -> str:
        parts = "; ".join(f"{part.name}: {part.posterior.kind}" for part in self.parts)
        return f"<ObjectModel {parts}; made from {', '.join(self.sources) or 'nothing named'}>"

    def with_part(self, part: ModelPart) -> ObjectModel:
        """With another part, or another state of knowledge of one that has its name."""
        names = [each.name for each in self.parts]
        if part.name not in names:
            return replace(self, parts=(*self.parts, part))
        kept = (part if each.name == part.name else each for each in self.parts)
        return replace(self, parts=tuple(kept))
