"""Axes, direction and unit: as said, else as the format has it, unless what is seen says other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from akm_fg.io.conventions import Axes, InputConventions, Up, direction
from akm_fg.io.sources.scene import (
    View,
    agreement,
    bounding_planes,
    hand_is_seen,
    spread,
)
from akm_fg.io.sources.source import RawDepth, Source
from akm_fg.records import FloatArray

MOVES_M, MOVES_RAD = 0.05, 0.05  # from which two views tell how poses are written
TELLS = 0.5  # of points that agree, or frames that show the hand
CLEARLY = 1.6  # times as many as with what was believed before
LEVEL_DEG, TILTED_DEG = 6.0, 20.0
CLOSEST_M, FARTHEST_M = 0.25, 8.0  # medians of what depth cameras see indoors
UNITS_M = (1e-3, 2e-4, 1e-4, 1.0)  # of whole numbers, the usual first; then metres
AXIS_NAMES: tuple[Up, ...] = ("z", "y", "x", "-z", "-y", "-x")


@dataclass(frozen=True, slots=True)
class Guessed:
    """A value, where it comes from, and what is to be said of it."""

    reading: InputConventions  # axes and direction of the poses
    axes_from: str
    notes: tuple[str, ...]


def guess_reading(source: Source, views: Sequence[View], said: InputConventions) -> Guessed:
    """How the source's camera poses are to be read.

    Args:
        source: with what its format says.
        views: a few of its pictures, spread over it.
        said: what a person says; it is never doubted.
    """
    candidates = _candidates(source, said)
    before = candidates[0]
    was_said = said.convention is not None or bool(said.invert_pose)
    usual = "said" if was_said else "the format's"
    if source.poses is None:
        return Guessed(before, "there are no poses", ())
    told = (
        _by_motion(views, candidates)
        or _by_hand(views, candidates)
        or _by_floor(source, views, candidates, said)
    )
    if told is None:
        return Guessed(before, usual, ())
    reading, by = told
    if reading == before:
        return Guessed(before, f"{usual}; {by} agrees", ())
    note = f"camera poses read as {_words(reading)}: {by} tells ({_flags(reading)})"
    return Guessed(reading, f"guessed: {by} tells", (note,))


def _candidates(source: Source, said: InputConventions) -> list[InputConventions]:
    """All that may be meant, what is said or the format's first."""
    axes: list[Axes] = [source.convention, "opengl" if source.convention == "opencv" else "opencv"]
    turns = [source.invert_pose, not source.invert_pose]
    axes = axes if said.convention is None else [said.convention]
    turns = turns if said.invert_pose is None else [said.invert_pose]
    return [InputConventions(a, t) for t, a in product(turns, axes)]


def _words(chosen: InputConventions) -> str:
    way = "T_cam_world" if chosen.invert_pose else "T_world_cam"
    return f"{way} in {'OpenGL' if chosen.convention == 'opengl' else 'OpenCV'}'s axes"


def _flags(chosen: InputConventions) -> str:
    turned = " --invert-pose" if chosen.invert_pose else ""
    return f"--convention {chosen.convention}{turned} says so"


_Told = tuple[InputConventions, str] | None


def _clear_winner(
    scores: Sequence[float], candidates: Sequence[InputConventions], by: str
) -> _Told:
    """The candidate that is clearly best; the first where it is as good as any."""
    best = int(np.argmax(scores))
    if scores[best] < TELLS:
        return None
    if scores[0] * CLEARLY >= scores[best]:
        others = [s for c, s in zip(candidates, scores, strict=True) if c != candidates[0]]
        return (candidates[0], by) if scores[0] > max(others) else None
    second = sorted(scores)[-2]
    return (candidates[best], by) if scores[best] > CLEARLY * second else None


def _by_motion(views: Sequence[View], candidates: Sequence[InputConventions]) -> _Told:
    """A camera that moves sees one scene; read wrongly, its views do not fit."""
    poses = [view.pose for view in views]
    metres, radians = spread(poses)
    if metres < MOVES_M and radians < MOVES_RAD:
        return None
    scores = [_mean_agreement(views, candidate) for candidate in candidates]
    return _clear_winner(scores, candidates, "what the moving camera sees again")


def _mean_agreement(views: Sequence[View], reading: InputConventions) -> float:
    pairs = pairwise(views)
    return float(
        np.mean(
            [
                agreement(a, reading.T_world_cam(a.pose), b, reading.T_world_cam(b.pose))
                for a, b in pairs
            ]
        )
    )


def _by_hand(views: Sequence[View], candidates: Sequence[InputConventions]) -> _Told:
    held = [view for view in views if view.p_world_gripper is not None]
    if not held:
        return None
    scores = [
        float(np.mean([hand_is_seen(v, c.T_world_cam(v.pose)) for v in held])) for c in candidates
    ]
    return _clear_winner(scores, candidates, "the gripper in the pictures")


def _by_floor(
    source: Source,
    views: Sequence[View],
    candidates: Sequence[InputConventions],
    said: InputConventions,
) -> _Told:
    """One reading alone in which a plane that bounds the scene is level, below the camera."""
    start = views[0].pose.matrix()
    if said.up is None and source.up is None and np.allclose(start, np.eye(4), atol=1e-3):
        return None  # the first camera's own frame: nobody says where its up is
    up = direction(said.up or source.up or "z")
    normals = [normal for normal, _ in bounding_planes(views[0])]
    if not normals:
        return None
    tilts = [_tilt_deg(normals, c, views[0], up) for c in candidates]
    level = [c for c, tilt in zip(candidates, tilts, strict=True) if tilt < LEVEL_DEG]
    if tilts[0] < LEVEL_DEG:
        return candidates[0], "the floor"
    if len(level) != 1 or tilts[0] < TILTED_DEG:
        return None
    return level[0], "the floor"


def _tilt_deg(
    normals: Sequence[FloatArray], reading: InputConventions, view: View, up: FloatArray
) -> float:
    R = reading.T_world_cam(view.pose).rotation().matrix()
    return min(float(np.degrees(np.arccos(np.clip(up @ R @ n, -1, 1)))) for n in normals)


def seen_gravity(
    source: Source, views: Sequence[View], reading: InputConventions, up: Up | None
) -> str:
    """What is seen of up and down, for a person."""
    planes = bounding_planes(views[0])
    if not planes:
        return "no floor or wall bounds what is seen"
    if source.poses is None:
        normal, distance = planes[0]
        where = np.array2string(normal, precision=2, suppress_small=True)
        return f"largest plane {distance:.2f} m from the camera, normal {where} in its axes"
    R = reading.T_world_cam(views[0].pose).rotation().matrix()
    names = AXIS_NAMES if up is None else (up,)
    for name in names:
        for normal, distance in planes:
            tilt = float(np.degrees(np.arccos(np.clip(direction(name) @ R @ normal, -1, 1))))
            if tilt < LEVEL_DEG:
                kind = "floor" if name == (up or "z") else "plane"
                return f"{kind} {distance:.2f} m below the camera, {tilt:.1f} deg off world {name}"
    return "no plane that is seen stands across an axis of the world"


def guess_unit(
    source: Source, depths: Sequence[RawDepth], said: InputConventions
) -> tuple[float, str, tuple[str, ...]]:
    """Metres a unit of depth, who says so, and what is to be said of it.

    Args:
        source: with what its format says.
        depths: a few depth pictures.
        said: what a person says; it is never doubted.
    """
    if said.depth_unit_m is not None:
        return said.depth_unit_m, "said", ()
    known = [depth[np.isfinite(depth) & (depth > 0)].astype(np.float64) for depth in depths]
    seen = np.concatenate(known)
    median = float(np.median(seen)) if len(seen) else float("nan")
    believed = source.unit_m
    if believed is not None and (not np.isfinite(median) or _plausible(median * believed)):
        return believed, source.unit_from, ()
    plausible = [unit for unit in UNITS_M if _plausible(median * unit)]
    if not plausible:
        unit_m = believed or UNITS_M[0]
        odd = f"half of what is seen lies within {median * unit_m:.3g} m, odd for a unit of "
        return unit_m, source.unit_from or "usual", (f"{odd}{unit_m:g} m (--depth-unit)",)
    unit_m = plausible[0]
    was = f", not {believed:g} m ({source.unit_from})" if believed is not None else ""
    note = (
        f"unit of depth read as {unit_m:g} m{was}: half of what is seen lies within "
        f"{median * unit_m:.2f} m then (--depth-unit says so)"
    )
    return unit_m, "guessed from the size of what is seen", (note,)


def _plausible(median_m: float) -> bool:
    return CLOSEST_M <= median_m <= FARTHEST_M
