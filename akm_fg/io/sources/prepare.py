"""From an opened source to frames: pairs, poses, unit, one camera; then a picture at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.io.conventions import InputConventions
from akm_fg.io.recording_depth import DEPTH_UNIT_M, as_stored
from akm_fg.io.sources.guesses import guess_reading, guess_unit, seen_gravity
from akm_fg.io.sources.matching import Matched, match, period_s
from akm_fg.io.sources.registration import Registration
from akm_fg.io.sources.scene import View, spread
from akm_fg.io.sources.source import Pair, RawDepth, Source, SourceOptions, Stream
from akm_fg.io.sources.understood import Understood
from akm_fg.records import FloatArray, RgbdFrame

VIEWS = 5  # pictures that are looked at before the first frame is handed out
STILL_M, STILL_RAD = 2e-3, 2e-3  # a tracker's tremor around a camera that stands
ROUNDING = 1e-8  # metres or radians: one pose, by several ways of calculating it
NO_RETURN = np.iinfo(np.uint16).max  # what some cameras write for "too far"
Frame = tuple[RgbdFrame, gtsam.Pose3 | None]  # and T_world_gripper


@dataclass(frozen=True, slots=True)
class Chosen:
    """The pictures that become frames."""

    pairs: tuple[Pair, ...]
    stamps_s: FloatArray
    apart_s: FloatArray
    poses: tuple[gtsam.Pose3, ...]  # as written
    left_out: dict[str, int]


@dataclass(frozen=True, slots=True)
class Prepared:
    """A source that is understood; `frames` decodes it."""

    source: Source
    chosen: Chosen
    registration: Registration
    unit_m: float
    places: tuple[gtsam.Pose3, ...]  # T_world_cam, ours
    grippers: tuple[gtsam.Pose3, ...] | None  # T_world_gripper
    understood: Understood
    depth_unit_m: float  # in which its frames are stored, without loss where it can be

    def frames(self) -> Iterator[Frame]:
        """Each frame, its depth in whole units of `depth_unit_m`, and the gripper's pose.

        Raises:
            InputError: a picture that is damaged, or of another size.
        """
        grippers = self.grippers or (None,) * len(self.places)
        images = self.source.images(self.chosen.pairs)
        for (rgb, raw), place, grip, stamp_s in zip(
            images, self.places, grippers, self.chosen.stamps_s, strict=True
        ):
            check_sizes(self.source, rgb, raw)
            depth_m = self.registration.depth(metres(raw, self.unit_m))
            colour, camera = self.registration.colour(rgb), self.registration.camera
            frame = RgbdFrame(float(stamp_s), colour, depth_m, camera, place)
            yield as_stored(frame, self.depth_unit_m), grip


def metres(raw: RawDepth, unit_m: float) -> NDArray[np.float32]:
    """Depth in metres, NaN where nothing was measured."""
    units = raw.astype(np.float64)
    known = np.isfinite(units) & (units > 0)
    if raw.dtype == np.uint16:
        known &= raw != NO_RETURN
    return np.where(known, units * unit_m, np.nan).astype(np.float32)


def check_sizes(source: Source, rgb: NDArray[np.uint8], raw: RawDepth) -> None:
    """Refuse pictures that are not of their camera's size.

    Raises:
        InputError: they are not.
    """
    for stream, image in ((source.colour, rgb), (source.depth, raw)):
        height, width = image.shape[:2]
        camera = stream.lens.camera
        if (width, height) != (camera.width, camera.height):
            expected = f"{camera.width}x{camera.height}, as its camera says"
            raise InputError(source.path, f"{stream.name} holds {width}x{height} pixels", expected)


def prepare(
    source: Source,
    options: SourceOptions,
    said: InputConventions,
    first_frames: int | None = None,
) -> Prepared:
    """Find out all that does not need every picture.

    Args:
        source: an opened one.
        options: what a person says of it.
        said: what a person says of poses and depth.
        first_frames: take so many and no more; None: all.

    Raises:
        InputError: nothing to make frames of, or pictures that contradict their description.
    """
    chosen = _choose(source, options, first_frames)
    registration = Registration(source.colour.lens, source.depth.lens, source.T_colour_depth)
    at, raws = _samples(source, chosen)
    unit_m, unit_from, notes = guess_unit(source, raws, said)
    views = [
        _view(source, chosen, registration, k, metres(raw, unit_m))
        for k, raw in zip(at, raws, strict=True)
    ]
    guessed = guess_reading(source, views, said)
    places, trembles = _steady(tuple(map(guessed.reading.T_world_cam, chosen.poses)))
    grippers, missing = _grippers(source, chosen)
    notes = (*source.notes, *notes, *guessed.notes, *trembles, *missing)
    exact = source.depth.whole_units and not registration.changes_depth
    understood = Understood(
        input=str(source.path),
        format=source.format,
        depth_unit_m=unit_m,
        depth_unit_from=unit_from,
        axes=_axes(guessed.reading),
        axes_from=guessed.axes_from,
        gravity=seen_gravity(source, views, guessed.reading, said.up or source.up),
        notes=notes,
        **_pictures(source, chosen, registration),
        **_seen(views),
        **_places(source, places),
    )
    unit = unit_m if exact else DEPTH_UNIT_M
    return Prepared(source, chosen, registration, unit_m, places, grippers, understood, unit)


def _choose(source: Source, options: SourceOptions, first_frames: int | None) -> Chosen:
    colour_s, depth_s = source.colour.stamps_s, source.depth.stamps_s
    matched = match(colour_s, depth_s)
    if not matched.pairs:
        problem = f"{len(colour_s)} colour and {len(depth_s)} depth pictures, no two together"
        if len(colour_s) and len(depth_s):
            problem += f" (the first at {colour_s[0]:.3f} and {depth_s[0]:.3f} s)"
        raise InputError(source.path, problem, "colour and depth at the same times")
    wanted = _wanted(matched, options)
    poses = [_pose(source, matched, k) for k in wanted]
    kept = [k for k, pose in zip(wanted, poses, strict=True) if pose is not None][:first_frames]
    if len(kept) < 2:
        raise _too_few(source, matched, wanted, poses)
    left_out = {"without depth": matched.alone, "without a pose": sum(p is None for p in poses)}
    return Chosen(
        tuple(matched.pairs[k] for k in kept),
        matched.stamps_s[kept],
        matched.apart_s[kept],
        tuple(pose for pose in poses if pose is not None)[:first_frames],
        left_out,
    )


def _wanted(matched: Matched, options: SourceOptions) -> list[int]:
    since = matched.stamps_s - matched.stamps_s[0]
    stop_s = np.inf if options.stop_s is None else options.stop_s
    inside = np.flatnonzero((since >= options.start_s) & (since <= stop_s))
    return [int(k) for k in inside[:: options.every]]


def _pose(source: Source, matched: Matched, k: int) -> gtsam.Pose3 | None:
    if source.poses is None:
        return gtsam.Pose3()
    return source.poses.at(float(matched.stamps_s[k]))


def _too_few(
    source: Source, matched: Matched, wanted: Sequence[int], poses: Sequence[gtsam.Pose3 | None]
) -> InputError:
    found = f"{len(matched.pairs)} pairs of colour and depth"
    if len(wanted) < len(matched.pairs):
        found += f", {len(wanted)} of them chosen"
    if source.poses is not None and None in poses:
        times = source.poses.stamps_s
        found += (
            f", {sum(p is None for p in poses)} without a pose (pictures from "
            f"{matched.stamps_s[0]:.3f} to {matched.stamps_s[-1]:.3f} s, poses from "
            f"{times[0]:.3f} to {times[-1]:.3f} s)"
        )
    return InputError(source.path, f"holds {found}", "at least 2 frames")


def _samples(source: Source, chosen: Chosen) -> tuple[list[int], list[RawDepth]]:
    """A few depth pictures spread over the source, and which frames they are."""
    n = len(chosen.pairs)
    at = sorted(set(np.linspace(0, n - 1, min(n, VIEWS)).astype(int).tolist()))
    raws = []
    for rgb, raw in source.images([chosen.pairs[k] for k in at]):
        check_sizes(source, rgb, raw)
        raws.append(raw)
    return at, raws


def _view(
    source: Source,
    chosen: Chosen,
    registration: Registration,
    k: int,
    depth_m: NDArray[np.float32],
) -> View:
    grip = None if source.grippers is None else source.grippers.at(float(chosen.stamps_s[k]))
    hand = None if grip is None else grip.translation()
    return View(registration.camera, registration.depth(depth_m), chosen.poses[k], hand)


def _steady(
    places: tuple[gtsam.Pose3, ...],
) -> tuple[tuple[gtsam.Pose3, ...], tuple[str, ...]]:
    """One place where the camera only trembles, and a note that it does."""
    metres_, radians = spread(places)
    if metres_ > STILL_M or radians > STILL_RAD:
        return places, ()
    if max(metres_, radians) < ROUNDING:
        return (places[0],) * len(places), ()
    away = np.mean([places[0].logmap(place) for place in places], axis=0)
    note = f"the camera's poses tremble by {1e3 * metres_:.1f} mm: one place for all frames"
    return (places[0].retract(away),) * len(places), (note,)


def _grippers(
    source: Source, chosen: Chosen
) -> tuple[tuple[gtsam.Pose3, ...] | None, tuple[str, ...]]:
    """One a frame, or none, and a note where some are missing."""
    if source.grippers is None:
        return None, ()
    found = [source.grippers.at(float(stamp_s)) for stamp_s in chosen.stamps_s]
    missing = sum(grip is None for grip in found)
    if missing:
        return None, (f"the gripper is left out: no pose of it in {missing} frames",)
    return tuple(grip for grip in found if grip is not None), ()


def _pictures(source: Source, chosen: Chosen, registration: Registration) -> dict[str, Any]:
    apart_ms = 1e3 * np.abs(chosen.apart_s)
    return {
        "frames": len(chosen.pairs),
        "seconds": float(chosen.stamps_s[-1] - chosen.stamps_s[0]),
        "rate_hz": 1.0 / period_s(chosen.stamps_s),
        "colour": _described(source.colour),
        "depth": _described(source.depth),
        "camera": registration.camera,
        "bend_px": registration.largest_bend_px(),
        "reduction": registration.reduction,
        "aligned": registration.changes_depth,
        "apart_ms": (float(np.median(apart_ms)), float(apart_ms.max())),
        "left_out": chosen.left_out,
    }


def _seen(views: Sequence[View]) -> dict[str, Any]:
    seen = np.concatenate([v.depth_m[np.isfinite(v.depth_m)] for v in views])
    near, far = np.percentile(seen, [5, 95]) if len(seen) else (np.nan, np.nan)
    known = float(np.mean([np.isfinite(v.depth_m).mean() for v in views]))
    return {"depth_m": (float(near), float(far)), "known": known}


def _places(source: Source, places: Sequence[gtsam.Pose3]) -> dict[str, Any]:
    metres_, radians = (0.0 if x < ROUNDING else x for x in spread(places))
    poses = source.poses_from or "no poses, so the world is the camera's own frame"
    return {"poses": poses, "moves": (metres_, float(np.degrees(radians)))}


def _axes(reading: InputConventions) -> str:
    name = "OpenGL" if reading.convention == "opengl" else "OpenCV"
    return f"{name}, {'T_cam_world' if reading.invert_pose else 'T_world_cam'}"


def _described(stream: Stream) -> str:
    size = f"{stream.lens.camera.width}x{stream.lens.camera.height}"
    return f"{stream.name}: {len(stream.stamps_s)} pictures of {size}"
