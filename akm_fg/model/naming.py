"""Which part of a model is meant: by its number or name, a pixel of a picture, or a point.

A pixel is the point that its depth shows. A point is on a part where the part's surface is near
it, at the state that the part is known to have, or else at any state of its range.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.spatial import cKDTree

from akm_fg.errors import InputError
from akm_fg.model.records import ModelPart, ObjectModel
from akm_fg.records import FloatArray, RgbdFrame

PLACE = "--part"
EXPECTED = "a part's number or name, a pixel U,V, or a point X,Y,Z in m"


@dataclass(frozen=True, slots=True)
class Pixel:
    """Of a picture: u to the right, v down, pixel centres at integers."""

    u: int
    v: int


@dataclass(frozen=True, slots=True)
class Point:
    """In the world."""

    p_world: tuple[float, float, float]  # m


PartName = int | str | Pixel | Point  # number from 0 on, or name


@dataclass(frozen=True, slots=True)
class NamingConfig:
    """How near is meant."""

    near_m: float = 0.03  # a surface has holes, a depth errs, and a point is read off a drawing
    apart_m: float = 0.01  # by which the next surface must be farther: two voxels of a surface
    window_px: int = 3  # around a pixel without depth, in which a depth stands for it
    states: int = 25  # of a range, at which a part is looked for whose state nobody knows


def part_name(text: str) -> PartName:
    """What a person wrote: `2`, `part-2`, `412,230` (pixel) or `0.62,-0.1,0.4` (m, world).

    Raises:
        InputError: it is none of these.
    """
    words = text.split(",")
    if len(words) == 1:
        word = text.strip()
        if not word:
            raise InputError(PLACE, "is empty", EXPECTED)
        return int(word) if re.fullmatch(r"[0-9]{1,9}", word) else word
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(PLACE, f"is {text!r}"[:80], EXPECTED) from error
    if not np.isfinite(numbers).all() or len(numbers) not in (2, 3):
        raise InputError(PLACE, f"is {text!r}"[:80], EXPECTED)
    if len(numbers) == 3:
        return Point((numbers[0], numbers[1], numbers[2]))
    return Pixel(round(numbers[0]), round(numbers[1]))


def part_named(
    model: ObjectModel,
    name: PartName | None,
    *,
    frame: RgbdFrame | None = None,
    states: Sequence[float | None] | None = None,
    config: NamingConfig | None = None,
) -> int:
    """Place of the part that is meant, among the model's.

    Args:
        model: of the object.
        name: number, name, pixel or point; None means the only part.
        frame: the picture whose pixel it is; needed for a pixel.
        states: where the parts are now, m or rad, in the model's order; None where not known.
        config: how near is meant.

    Raises:
        InputError: no part is meant, or more than one.
        ValueError: a pixel without a picture, or states of other parts.
    """
    config, names = config or NamingConfig(), [part.name for part in model.parts]
    if states is not None and len(states) != len(names):
        raise ValueError(f"{len(states)} states of {len(names)} parts")
    if name is None:
        if len(names) == 1:
            return 0
        raise InputError(PLACE, "none is named", f"one of {', '.join(names)}")
    if isinstance(name, str):
        if name not in names:
            raise InputError(PLACE, f"{name!r} is not in the model"[:80], _one_of(names))
        return names.index(name)
    if isinstance(name, int):
        if not 0 <= name < len(names):
            raise InputError(PLACE, f"there is no part {name}", f"0 to {len(names) - 1}")
        return name
    if isinstance(name, Pixel):
        if frame is None:
            raise ValueError("a pixel needs the picture that it is of")
        return _at(model, _seen_at(frame, name, config), _said(name), states, config)
    return _at(model, np.array(name.p_world), _said(name), states, config)


def _one_of(names: Sequence[str]) -> str:
    return f"one of {', '.join(names)}"


def _said(name: Pixel | Point) -> str:
    if isinstance(name, Pixel):
        return f"pixel ({name.u}, {name.v})"
    return "point ({:.3g}, {:.3g}, {:.3g})".format(*name.p_world)


def _seen_at(frame: RgbdFrame, pixel: Pixel, config: NamingConfig) -> FloatArray:
    """Point (3,) in the world that a pixel shows; without a depth, that of its nearest window."""
    camera, u, v = frame.camera, pixel.u, pixel.v
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        size = f"0 to {camera.width - 1}, 0 to {camera.height - 1}"
        raise InputError(PLACE, f"{_said(pixel)} is not in the picture", size)
    for r in range(config.window_px + 1):
        window = frame.depth_m[max(v - r, 0) : v + r + 1, max(u - r, 0) : u + r + 1]
        known = window[np.isfinite(window) & (window > 0)]
        if known.size:
            depth_m = np.asarray(np.median(known), dtype=float)
            p_cam = camera.back_project(np.array([u, v], dtype=float), depth_m)
            return np.asarray(frame.T_world_cam.transformFrom(p_cam))
    raise InputError(PLACE, f"{_said(pixel)} has no depth", "a pixel of the part that is seen")


def _at(
    model: ObjectModel,
    p_world: FloatArray,
    said: str,
    states: Sequence[float | None] | None,
    config: NamingConfig,
) -> int:
    """Place of the part whose surface is at a point (3,).

    Raises:
        InputError: none is, or two are, or it is what rests that is there.
    """
    names = [part.name for part in model.parts]
    known = [None] * len(names) if states is None else states
    off_m = np.array(
        [_off_m(part, q, p_world, config) for part, q in zip(model.parts, known, strict=True)]
    )
    best = int(off_m.argmin())
    if off_m[best] > config.near_m:
        near = f"{said} is on no part ({names[best]} is {_cm(off_m[best])} away)"
        raise InputError(PLACE, near, _one_of(names))
    close = [i for i in range(len(names)) if off_m[i] <= off_m[best] + config.apart_m]
    if len(close) > 1:
        both = " or ".join(names[i] for i in close)
        raise InputError(PLACE, f"{said} may be on {both}", "a place on one of them alone")
    rests = model.static.p_world
    if len(rests) and cKDTree(rests).query(p_world)[0] + config.apart_m < off_m[best]:
        raise InputError(PLACE, f"{said} is on what does not move", _one_of(names))
    return best


def _off_m(part: ModelPart, q: float | None, p_world: FloatArray, config: NamingConfig) -> float:
    """Distance of a point (3,) from a part's surface at a state, or at the nearest of its range."""
    tree = cKDTree(part.surface.p_world)
    states = np.linspace(*part.range_seen(), config.states) if q is None else [q]
    places: list[gtsam.Pose3] = [part.T_seen_part(float(state)) for state in states]
    return float(min(tree.query(T.transformTo(p_world))[0] for T in places))


def _cm(distance_m: float) -> str:
    return f"{100.0 * distance_m:.1f} cm"
