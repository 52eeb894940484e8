"""What there is to see of a model or a fitted recording, whoever draws it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.model.records import ModelPart, ObjectModel, Surface
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import FloatArray
from factors.joint import Unit

_AXIS_HALF_M = 0.4  # drawn to either side of the pivot: about the size of furniture
_RING = 32  # corners of the cone's cross-sections
_RINGS = 17
MOST_POINTS = 60_000  # of a cloud: a page stays below 5 MB
_MOST_TRACKS = 300
_PALER, _PALE = 0.4, 225.0  # what rests, so that the part stands out


@dataclass(frozen=True, slots=True)
class Cloud:
    """N points with colours."""

    p_world: FloatArray  # (N, 3)
    rgb: NDArray[np.uint8]  # (N, 3)


@dataclass(frozen=True, slots=True)
class AxisCone:
    """The axis, and the surface that holds it with 95 %: a tube that widens away from the pivot.

    At a distance s along the axis its radius is the pivot's bound plus |s| times the tangent of the
    axis' bound. It holds both bounds at once, so the axis with at least 90 %; either with 95 %.
    """

    ends_world: FloatArray  # (2, 3); the state grows along the way from the first to the second
    p_world: FloatArray  # (V, 3) of the surface
    triangles: NDArray[np.int64]  # (F, 3)


@dataclass(frozen=True, slots=True)
class MovingPart:
    """A part: its cloud in the closed pose, and where it was in each frame."""

    part: ModelPart
    cloud: Cloud
    axis: AxisCone
    q: FloatArray  # (T,) NaN where it was not seen
    sd: FloatArray  # (T,)
    words: tuple[str, ...]  # kind, axis, pivot, in lines
    recorded: range | None = None  # frames of the recording that it was opened in; None: all

    @property
    def unit(self) -> Unit:
        """Of the states."""
        return self.part.joint.kind.unit

    @property
    def per_unit(self) -> float:
        """Degrees a radian, or centimetres a metre."""
        return math.degrees(1) if self.unit == "rad" else 100.0

    @property
    def unit_name(self) -> str:
        """Of what a person reads."""
        return "deg" if self.unit == "rad" else "cm"

    @property
    def axis_in_words(self) -> str:
        """Short enough for a phone."""
        joint = self.part.joint
        bound_m = joint.pivot_bound_m()
        across = "" if bound_m is None else f", ± {100 * bound_m:.2g} cm"
        return (
            f"{self.part.posterior.kind}, ± {math.degrees(joint.axis_bound_rad()):.2g} deg{across}"
        )

    def state_in_words(self, q: float, sd: float | None = None) -> str:
        """The state as a person reads it."""
        from akm_fg.posterior import normal_bound

        scale = self.per_unit
        bound = "" if sd is None else f" ± {scale * normal_bound() * sd:.2g}"
        return f"{self.part.name}: {round(scale * q, 1) + 0.0:.1f}{bound} {self.unit_name}"


@dataclass(frozen=True, slots=True)
class Tracks:
    """Lines between the places of a tracked point in successive frames."""

    segments_world: FloatArray  # (S, 2, 3)
    moving: NDArray[np.bool_]  # (S,)


@dataclass(frozen=True, slots=True)
class Contents:
    """All that is drawn."""

    title: str
    static: Cloud
    parts: tuple[MovingPart, ...]
    eye_world: FloatArray  # (3,) where the camera stood
    tracks: Tracks | None = None

    @property
    def middle_world(self) -> FloatArray:
        """(3,) where to look."""
        return np.asarray(self.parts[0].cloud.p_world.mean(axis=0))

    def frames(self) -> Iterator[tuple[int, list[float]]]:
        """Numbers of the frames in which any part was seen, and the state of each part.

        A part that was not seen stays where it was; while another recording plays it is closed.
        """
        q = np.array([part.q for part in self.parts])
        closed = np.array([part.part.closed_state for part in self.parts])
        last = closed
        for t in np.flatnonzero(np.isfinite(q).any(axis=0)):
            last = np.where(np.isfinite(q[:, t]), q[:, t], last)
            recorded = [part.recorded is None or t in part.recorded for part in self.parts]
            last = np.where(recorded, last, closed)
            yield int(t), last.tolist()


def contents_of(
    model: ObjectModel,
    title: str,
    observed: ObservedMotion | None = None,
    most_points: int = MOST_POINTS,
) -> Contents:
    """What there is to see.

    Args:
        model: of the object.
        title: of the page.
        observed: tracks of the recording, where it was just fitted.
        most_points: of each cloud.
    """
    rng = np.random.default_rng(0)
    tracks = None if observed is None else _tracks(observed, rng)
    return Contents(
        title,
        _cloud(model.static, rng, most_points, _PALER),
        _one_after_the_other([_moving(part, rng, most_points) for part in model.parts], model),
        np.asarray(model.T_world_cam.translation()),
        tracks,
    )


def _cloud(
    surface: Surface, rng: np.random.Generator, most_points: int, paler: float = 0.0
) -> Cloud:
    """Not too many of its points; `paler` is the share of light gray."""
    chosen = np.arange(len(surface))
    if chosen.size > most_points:
        chosen = np.sort(rng.choice(chosen, most_points, replace=False))
    rgb = (1 - paler) * surface.rgb[chosen] + paler * _PALE
    return Cloud(surface.p_world[chosen], np.rint(rgb).astype(np.uint8))


def _moving(part: ModelPart, rng: np.random.Generator, most_points: int) -> MovingPart:
    states = part.states
    q = np.array([part.closed_state]) if states is None else states.mean
    sd = np.zeros(1) if states is None else states.sd
    kind, *lines = part.posterior.summary().splitlines()
    kind = kind.removeprefix(f"{part.posterior.name}: ")
    words = [kind, *(line for line in lines if not line.startswith(("note", "state")))]
    return MovingPart(
        part, _cloud(part.surface, rng, most_points), axis_cone(part), q, sd, tuple(words)
    )


def _one_after_the_other(parts: Sequence[MovingPart], model: ObjectModel) -> tuple[MovingPart, ...]:
    """With states over the frames of all recordings, which parts of one recording share."""
    recordings: dict[tuple[tuple[str, ...], int], range] = {}
    own, total = [], 0
    for moving in parts:
        recording = (moving.part.sources or model.sources, moving.q.size)
        if recording not in recordings:
            recordings[recording] = range(total, total + moving.q.size)
            total += moving.q.size
        own.append(recordings[recording])

    def placed(values: FloatArray, frames: range) -> FloatArray:
        return np.pad(values, (frames.start, total - frames.stop), constant_values=np.nan)

    return tuple(
        replace(moving, q=placed(moving.q, frames), sd=placed(moving.sd, frames), recorded=frames)
        for moving, frames in zip(parts, own, strict=True)
    )


def axis_cone(part: ModelPart) -> AxisCone:
    """Axis and cone of a part; of one that slides the axis is drawn through its middle."""
    joint = part.seen_joint
    middle = joint.joint.origin if joint.turns else part.surface.p_world.mean(axis=0)
    angle, across = joint.axis_bound_rad(), joint.pivot_bound_m() or 0.0
    s = np.linspace(-_AXIS_HALF_M, _AXIS_HALF_M, _RINGS)
    radius = across + np.abs(s) * math.tan(min(angle, math.radians(80)))
    turn = np.linspace(0, 2 * np.pi, _RING, endpoint=False)
    x, y, z = joint.T_world_joint[:3, :3].T
    ring = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
    points = middle + s[:, None, None] * z + radius[:, None, None] * ring
    first = np.arange(_RINGS - 1)[:, None] * _RING + np.arange(_RING)
    beside = np.arange(_RINGS - 1)[:, None] * _RING + (np.arange(_RING) + 1) % _RING
    quads = np.stack([first, beside, beside + _RING, first + _RING], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    ends = middle + np.outer([-_AXIS_HALF_M, _AXIS_HALF_M], z)
    return AxisCone(ends, points.reshape(-1, 3), triangles)


def _tracks(observed: ObservedMotion, rng: np.random.Generator) -> Tracks:
    """Of a few hundred points, most of them on the part."""
    parts, p = observed.segmentation, observed.tracks.p_world
    chosen = []
    for which in (parts.moving, parts.static):
        some = np.flatnonzero(which)
        take = min(some.size, _MOST_TRACKS // 2)
        chosen.append(rng.choice(some, take, replace=False))
    numbers = np.concatenate(chosen)
    lines = np.stack([p[:-1, numbers], p[1:, numbers]], axis=2)  # (T - 1, K, 2, 3)
    known = np.isfinite(lines).all(axis=(2, 3))
    moving = np.broadcast_to(parts.moving[numbers], known.shape)
    return Tracks(lines[known], np.asarray(moving[known]))
