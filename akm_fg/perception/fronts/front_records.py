"""What is found on an object's outside: fronts, what sticks out of them, places to take hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from akm_fg.records import BoolArray, FloatArray

ContactKind = Literal["protrusion", "edge", "recess", "plain"]

PARALLEL = 0.97  # cosine between normals of parallel planes: 14 deg


@dataclass(frozen=True, slots=True)
class FrontFrame:
    """A plane with axes in it: x to the right and y upwards as seen from before it, z out of it."""

    origin_world: FloatArray  # (3,) a point of the plane
    axes_world: FloatArray  # (3, 3) columns x, y, z; unit

    @property
    def normal_world(self) -> FloatArray:
        """(3,) unit, out of the object."""
        return np.asarray(self.axes_world[:, 2])

    def local(self, p_world: FloatArray) -> FloatArray:
        """Points (..., 3) as x, y and height over the plane, m."""
        return np.asarray((p_world - self.origin_world) @ self.axes_world)

    def world(self, p_front: FloatArray) -> FloatArray:
        """Points (..., 3) of x, y and height in the world."""
        return np.asarray(p_front @ self.axes_world.T + self.origin_world)


@dataclass(frozen=True, slots=True)
class Front:
    """A rectangle of one plane with gaps, or the plane's end, all around: it moves as one."""

    frame: FrontFrame
    lower_m: FloatArray  # (2,) corners of the rectangle, in the frame
    upper_m: FloatArray  # (2,)
    mask: BoolArray  # (H, W) pixels that show it

    @property
    def normal_world(self) -> FloatArray:
        """(3,) unit, out of the object."""
        return self.frame.normal_world

    @property
    def plane_world(self) -> FloatArray:
        """(4,) a, b, c, d with a x + b y + c z + d = 0 on the front; positive outside."""
        n = self.normal_world
        return np.append(n, -n @ self.frame.origin_world)

    @property
    def extent_m(self) -> FloatArray:
        """(2,) width and height."""
        return np.asarray(self.upper_m - self.lower_m)

    @property
    def middle_world(self) -> FloatArray:
        """(3,) of the rectangle."""
        return self.frame.world(np.append((self.lower_m + self.upper_m) / 2.0, 0.0))

    def holds(self, xy_m: FloatArray, margin_m: float) -> BoolArray:
        """(...) which points (..., 2) of its frame lie in the rectangle, or within a margin."""
        with np.errstate(invalid="ignore"):
            inside = (xy_m >= self.lower_m - margin_m) & (xy_m <= self.upper_m + margin_m)
        return np.asarray(inside.all(axis=-1))

    def distance_m(self, xy_m: FloatArray) -> float:
        """Of a point (2,) in the front's frame from the rectangle; 0 inside."""
        outside = np.maximum(np.maximum(self.lower_m - xy_m, xy_m - self.upper_m), 0.0)
        return float(np.linalg.norm(outside))


@dataclass(frozen=True, slots=True)
class Protrusion:
    """Something that sticks out of a front: a handle, a knob, a ledge."""

    p_world: FloatArray  # (3,) middle of its outer side
    uv: FloatArray  # (2,) a pixel that shows it, near that middle
    front: int  # index of the front it stands on
    axis_world: FloatArray  # (3,) unit, in the front's plane: the way it is longest
    length_m: float  # along the axis
    width_m: float  # across it, in the front's plane
    height_m: float  # over the front
    mask: BoolArray  # (H, W) pixels that show it


@dataclass(frozen=True, slots=True)
class Fronts:
    """All that was found in one view; may be empty."""

    fronts: tuple[Front, ...]
    protrusions: tuple[Protrusion, ...]


@dataclass(frozen=True, slots=True)
class ContactCandidate:
    """A place to take hold of, and how likely a pull there moves something that is free."""

    p_world: FloatArray  # (3,) on the surface that is seen
    uv: FloatArray  # (2,) its pixel
    front: int  # index of the front that it would move
    normal_world: FloatArray  # (3,) unit, out of the front
    prior: float  # in (0, 1)
    what: ContactKind
    thing: int | None = None  # which protrusion; None of edges and plain places
    serves: float = 1.0  # that it moves its front: no gap was missed, and there is a lever
