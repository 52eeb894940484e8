"""Recordings: a folder with ``recording.json`` and one numbered image a frame and channel.

Format ``akm-fg/recording/1``: ``rgb/000000.png`` (8 bit; or ``rgb/000000.jpg``),
``depth/000000.png`` (16 bit, in units of `depth_unit_m` along camera z, 0 unknown), optional
``mask/000000.png`` (object, 0/255).
The truth, where there is one, is read by its own function: an estimator never sees it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.conventions import InputConventions
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.io.png import read_depth_raw, read_mask
from akm_fg.io.recording_depth import depth_from_raw
from akm_fg.io.scoring.truths import truth_from_fields
from akm_fg.io.sources.pictures import read_colour
from akm_fg.records import (
    BoolArray,
    CalibrationErrors,
    FloatArray,
    JointTruth,
    PinholeCamera,
    Recording,
    RgbdFrame,
)

SCHEMA = "akm-fg/recording/1"
BYTES_A_PIXEL = 8  # in memory: 3 of colour, 4 of depth, 1 of the mask
COLOUR_ENDINGS = (".png", ".jpg", ".jpeg")  # what loses nothing first
CALIBRATION_SDS = ("focal_sd", "depth_scale_sd", "depth_bias_sd_m")  # of `calibration`


def frame_file(folder: Path, channel: str, index: int) -> Path:
    """The PNG of one channel ("rgb", "depth", "mask") of one frame."""
    return folder / channel / f"{index:06d}.png"


def colour_file(folder: Path, index: int) -> Path:
    """The colour image of one frame: a PNG or a JPEG, and the PNG's name where there is none."""
    png = frame_file(folder, "rgb", index)
    files = (png.with_suffix(ending) for ending in COLOUR_ENDINGS)
    return next((file for file in files if file.exists()), png)


def _open(folder: Path) -> Fields:
    what = f"a recording folder ({SCHEMA}: recording.json, rgb/, depth/)"
    if not folder.exists():
        raise InputError(folder, "does not exist", what)
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", what)
    path = folder / "recording.json"
    fields = Fields(path, load_json_object(path, f"the description of a recording ({SCHEMA})"))
    schema = fields.text("schema", f"the string {SCHEMA!r}")
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:80], f"{SCHEMA!r}")
    return fields


def _stamps(fields: Fields, min_frames: int) -> FloatArray:
    stamps_s = fields.array("stamps_s", (None,), "one finite time in seconds a frame")
    if len(stamps_s) < min_frames:
        problem = f"lists {len(stamps_s)} frame{'s' if len(stamps_s) != 1 else ''}"
        raise fields.error("stamps_s", problem, f"at least {min_frames} frames")
    late = np.flatnonzero(np.diff(stamps_s) <= 0)
    if late.size:
        i = int(late[0])
        problem = f"does not grow from frame {i} ({stamps_s[i]:g}) to {i + 1} ({stamps_s[i + 1]:g})"
        raise fields.error("stamps_s", problem, "times that grow strictly")
    return stamps_s


def _check_numbering(folder: Path, channel: str, n: int) -> None:
    """Refuse more images than stamps; one more is what an interrupted writer leaves."""
    endings = COLOUR_ENDINGS if channel == "rgb" else (".png",)
    try:
        files = [p for p in (folder / channel).glob("*") if p.suffix in endings]
    except OSError as e:
        raise InputError(folder / channel, f"cannot be read ({e.strerror})", "a folder") from e
    if not (folder / channel).is_dir():
        raise InputError(folder / channel, "is missing", f"a folder with {n} PNG images")
    numbers = {int(p.stem) for p in files if p.stem.isdigit()}
    missing = sorted(set(range(n)) - numbers)
    if missing:
        problem = f"is missing (`stamps_s` lists {n} frames, {len(missing)} without {channel})"
        raise InputError(frame_file(folder, channel, missing[0]), problem, "one image a frame")
    if numbers - set(range(n + 1)):
        problem = f"holds images up to {max(numbers):06d}.png, but `stamps_s` lists {n} frames"
        raise InputError(folder / channel, problem, "one image for each of `stamps_s`")


def _camera(fields: Fields) -> PinholeCamera:
    camera = fields.table("camera", "an object with width, height, fx, fy, cx, cy")
    return PinholeCamera(
        width=camera.positive_integer("width"),
        height=camera.positive_integer("height"),
        fx=camera.positive("fx"),
        fy=camera.positive("fy"),
        cx=camera.number("cx"),
        cy=camera.number("cy"),
    )


def _camera_poses(fields: Fields, n: int) -> tuple[gtsam.Pose3, ...]:
    """One a frame; a single one is of a camera that stands still."""
    value = fields.values.get("T_world_cam")
    for _ in range(2):  # a matrix is a list of lists, several are a list of these
        value = value[0] if isinstance(value, list) and value else None
    if isinstance(value, list):
        return fields.poses("T_world_cam", n)
    return (fields.pose("T_world_cam"),) * n


def _grasp_frames(fields: Fields, n: int) -> tuple[int, int] | None:
    if not fields.has("grasp_frames"):
        return None
    expected = f"[first, last] with 0 <= first <= last < {n}, or null"
    first, last = fields.array("grasp_frames", (2,), expected)
    if not (first.is_integer() and last.is_integer() and 0 <= first <= last < n):
        raise fields.error("grasp_frames", f"is [{first:g}, {last:g}]", expected)
    return int(first), int(last)


def read_recording(
    folder: Path,
    min_frames: int = 2,
    first_frames: int | None = None,
    conventions: InputConventions | None = None,
) -> Recording:
    """Read a recording without its truth.

    Args:
        folder: the recording's folder.
        min_frames: fewest frames that make sense to the caller; a fit needs two.
        first_frames: read so many from its beginning and no more; None: all.
        conventions: what a person says of its poses and depth against its description.

    Raises:
        InputError: anything that is missing, damaged or contradicts itself, or too short.
    """
    folder = Path(folder)
    fields = _open(folder)
    stamps_s = _stamps(fields, min_frames)
    n = len(stamps_s)
    grips = fields.poses("T_world_gripper", n) if fields.has("T_world_gripper") else None
    grasp_frames = _grasp_frames(fields, n)
    take = n if first_frames is None else first_frames
    if not min_frames <= take <= n:
        expected = f"{min_frames} to {n} frames, as many as the recording has"
        raise InputError(folder, f"was asked for its first {take} frames", expected)
    said = conventions or InputConventions()
    frames, masks = _read_images(folder, fields, stamps_s, take, said)
    if grasp_frames is not None:
        held = grasp_frames[0], min(grasp_frames[1], take - 1)
        grasp_frames = held if held[0] <= held[1] else None
    name = folder.name or folder.resolve().name
    held_in = None if grips is None else grips[:take]
    return Recording(name, frames, masks, held_in, grasp_frames, _calibration(fields))


def _calibration(fields: Fields) -> CalibrationErrors | None:
    """What is not known of the camera, if the recording says so."""
    if not any(map(fields.has, ("calibration", "cov_world_cam", "cov_intrinsics"))):
        return None
    expected = f"cov_world_cam 6x6, cov_intrinsics 4x4, calibration: {', '.join(CALIBRATION_SDS)}"
    table = Fields(fields.path, {})
    if fields.has("calibration"):
        table = fields.table("calibration", f"an object with {', '.join(CALIBRATION_SDS)}")
    place, lens = np.zeros((6, 6)), None
    for holder in (table, fields):  # within `calibration` it was written at first
        if holder.has("cov_world_cam"):
            place = holder.array("cov_world_cam", (6, 6), "a symmetric 6x6, rotation first")
    if fields.has("cov_intrinsics"):
        lens = fields.array("cov_intrinsics", (4, 4), "a symmetric 4x4, px^2 of fx, fy, cx, cy")
    numbers = {name: table.number(name) for name in CALIBRATION_SDS if table.has(name)}
    try:
        return CalibrationErrors(place, cov_intrinsics=lens, **numbers)
    except ValueError as e:
        raise InputError(fields.path, f"`calibration`: {e}", expected) from e


def _read_images(
    folder: Path, fields: Fields, stamps_s: FloatArray, take: int, said: InputConventions
) -> tuple[tuple[RgbdFrame, ...], tuple[BoolArray, ...] | None]:
    """The first `take` frames, and their object masks where there are any."""
    camera, poses = _camera(fields), _camera_poses(fields, len(stamps_s))
    depth_unit_m = said.depth_unit_m or fields.positive("depth_unit_m")
    has_masks = (folder / "mask").is_dir()
    for channel in ("rgb", "depth", "mask")[: 3 if has_masks else 2]:
        _check_numbering(folder, channel, len(stamps_s))
    check_memory(folder, camera, take)
    size = (camera.width, camera.height)
    frames, masks = [], []
    for i, stamp_s in enumerate(stamps_s[:take]):
        rgb = read_colour(colour_file(folder, i), *size)
        depth_m = depth_from_raw(
            read_depth_raw(frame_file(folder, "depth", i), *size), depth_unit_m
        )
        T_world_cam = said.T_world_cam(poses[i])
        frames.append(RgbdFrame(float(stamp_s), rgb, depth_m, camera, T_world_cam))
        if has_masks:
            masks.append(read_mask(frame_file(folder, "mask", i), *size))
    return tuple(frames), tuple(masks) or None


def check_memory(folder: Path, camera: PinholeCamera, frames: int) -> None:
    """Refuse more than the machine holds, before any image is read."""
    needs = frames * camera.width * camera.height * BYTES_A_PIXEL
    has = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needs > has:
        problem = f"{frames} frames of {camera.width}x{camera.height} need {needs / 1e9:.0f} GB"
        expected = f"less than the {has / 1e9:.0f} GB of this machine (--frames N takes fewer)"
        raise InputError(folder, problem, expected)


def read_truth(folder: Path) -> JointTruth | None:
    """Read the true joint of a recording, for scoring; None where it is not known.

    A rigid truth may leave its axis out (NaN).

    Raises:
        InputError: as `read_recording`, or a truth that contradicts itself.
    """
    fields = _open(Path(folder))
    if not fields.has("truth"):
        return None
    n = len(_stamps(fields, min_frames=0))
    truth = fields.table("truth", "an object with kind, axis, pivot, states, or null")
    return truth_from_fields(truth, n)


def truth_as_json(truth: JointTruth) -> dict[str, Any]:
    """The `truth` field of ``recording.json``."""
    known_axis = bool(np.isfinite(truth.axis).all())
    return {
        "kind": truth.kind,
        "axis": truth.axis.tolist() if known_axis else None,
        "pivot": None if truth.pivot is None else truth.pivot.tolist(),
        "states": truth.states.tolist(),
    }
