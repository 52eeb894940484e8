"""`akm-fg check`: what a recording shows, and what will hinder a fit."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from akm_fg.cli.console.lines import console
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.recordings.said import said_conventions
from akm_fg.errors import InputError

if TYPE_CHECKING:
    from akm_fg.check.records import RecordingCheck
    from akm_fg.perception.config import PerceptionConfig
    from akm_fg.records import Recording

SCHEMA = "akm-fg/check/1"
OVERLAY, CHECK = "overlay.jpg", "check.json"


@dataclass(frozen=True)
class CheckArguments:
    """Example: akm-fg check kitchen/recording --out kitchen/check

    Looks at a recording before a fit: rate, depth, floor and up, what is taken for the object, what
    changes and what stands still, and what will hinder a fit. Takes seconds. The exit code is 1
    where something will.
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """The recording, as fit takes it."""
    out: Path | None = None
    """Folder for overlay.jpg (object, floor, changes, and depth over colours) and check.json."""
    json: str | None = None
    """Write what was found as one JSON object to this file; - is standard output (no table)."""
    convention: Literal["opencv", "opengl"] | None = None
    """Of recordings, axes of the camera whose poses are given: opencv x right, y down, z forward;
    opengl y up, z back. As the format has it if absent, or found out and said."""
    invert_pose: bool = False
    """Of recordings: poses are T_cam_world, from the world to the camera."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Axis of the world that points up: the floor is held against it; z if absent."""
    depth_unit: float | None = None
    """Of recordings, metres a unit of stored depth (0.001); as the format has it if absent."""
    sensor: Literal["d455", "l515", "kinect", "azure", "measured"] | None = None
    """Whose noise depth has, as in fit."""


def check(arguments: CheckArguments) -> int:
    """Run the command.

    Raises:
        InputError: no recording, or a broken one.
        OutputError: a file cannot be written.
    """
    from akm_fg.check.measure import check_recording
    from akm_fg.cli.fitting.folder import make_folder
    from akm_fg.io.inputs import read_input
    from akm_fg.io.read_options import ReadOptions
    from akm_fg.records import Recording

    if arguments.out is not None:
        make_folder(arguments.out)
    said = said_conventions(arguments)
    data = read_input(arguments.recording, options=ReadOptions(conventions=said))
    if not isinstance(data, Recording):
        raise InputError(arguments.recording, "has no pictures to look at", "a recording")
    with json_output(arguments.json) as results:
        found = check_recording(data, _perception(arguments), said.up_world)
        line = json_module.dumps(_as_dict(arguments.recording, found), allow_nan=False)
        if arguments.out is not None:
            _write(arguments.out, data, found, line)
        if results is not None:
            write_line(results, line)
    if arguments.json != "-":
        _print(arguments, found)
    return GOAL_NOT_REACHED if found.hints else DONE


def _perception(arguments: CheckArguments) -> PerceptionConfig:
    from akm_fg.perception.config import PerceptionConfig
    from akm_fg.perception.sensors import with_sensor

    usual = PerceptionConfig()
    return usual if arguments.sensor is None else with_sensor(usual, arguments.sensor)


def _write(out: Path, recording: Recording, found: RecordingCheck, line: str) -> None:
    from akm_fg.check.picture import overview
    from akm_fg.io.png import replace_file

    replace_file(out / OVERLAY, overview(recording, found))
    replace_file(out / CHECK, (line + "\n").encode())


def _print(arguments: CheckArguments, found: RecordingCheck) -> None:
    from rich.table import Table
    from rich.text import Text

    from akm_fg.report.wording import ascii_text, printable

    out = console()

    def text(words: str) -> Text:
        return Text(ascii_text(words) if out.options.ascii_only else words)

    table = Table(title=text(printable(str(arguments.recording))), title_justify="left")
    table.add_column("what", no_wrap=True)
    table.add_column("seen")
    for what, seen in _rows(found):
        table.add_row(text(what), text(seen))
    out.print(table)
    for hint in found.hints:
        out.print(text(f"- {hint}"))
    if not found.hints:
        out.print("nothing was found that will hinder a fit")
    if arguments.out is not None:
        place = printable(str(arguments.out / OVERLAY))
        out.print(f"overlay: {place}", soft_wrap=True)


def _rows(found: RecordingCheck) -> list[tuple[str, str]]:
    camera, changes = found.camera, found.changes
    wide, high = (
        np.rad2deg(2.0 * np.arctan(n / 2.0 / f))
        for n, f in ((camera.width, camera.fx), (camera.height, camera.fy))
    )
    rate = "" if found.rate_hz is None else f", {found.rate_hz:.1f} a second"
    depth = "none"
    if found.depth_m is not None:
        low, middle, far = found.depth_m
        depth = f"{low:.2f} to {far:.2f} m (5 to 95 %), half nearer than {middle:.2f} m; "
        depth += f"{100 * found.depth_share:.0f} % of the pixels"
    noise = "cannot be told"
    if found.noise_times is not None:
        noise = f"{found.noise_times:.1f} times what is assumed"
    first = changes.first_frame
    since = "" if first is None else f", first seen in frame {first}"
    still = f"{100 * changes.still_share:.0f} % of what has depth stands still; "
    moves = "moves, as T_world_cam says" if found.camera_moves else "stands still, says T_world_cam"
    return [
        ("frames", f"{found.frames} over {found.seconds:.1f} s{rate}"),
        ("picture", f"{camera.width} x {camera.height} px, {wide:.0f} x {high:.0f} deg"),
        ("depth", depth),
        ("depth's noise", noise),
        ("floor", _floor_words(found)),
        (
            "object",
            f"{100 * found.object_share:.0f} % of the picture, {found.object_corners} points",
        ),
        ("what moves", f"{still}{100 * changes.changed_share:.1f} % of the picture changes{since}"),
        ("camera", moves),
        ("gripper", _gripper_words(found)),
    ]


def _floor_words(found: RecordingCheck) -> str:
    floor = found.floor
    if floor is None:
        return "none is seen"
    x, y, z = (np.round(floor.up_world, 2) + 0.0).tolist()
    return (
        f"{100 * floor.share:.0f} % of the depth; up is ({x:.2f}, {y:.2f}, {z:.2f}) by it, "
        f"{floor.off_up_deg:.1f} deg off; camera {floor.height_m:.2f} m above it, looking "
        f"{floor.tilt_deg:.0f} deg down"
    )


def _gripper_words(found: RecordingCheck) -> str:
    if found.gripper_frames is None:
        return "none is said to hold"
    return "holds from frame {} to {}".format(*found.gripper_frames)


def _as_dict(place: Path, found: RecordingCheck) -> dict[str, Any]:
    """As JSON (docs/conventions.md)."""
    camera, floor = found.camera, found.floor
    return {
        "schema": SCHEMA,
        "input": str(place),
        "frames": found.frames,
        "compared": list(found.compared),
        "seconds": found.seconds,
        "rate_hz": found.rate_hz,
        "longest_gap_s": found.longest_gap_s,
        "camera": {k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")},
        "depth_share": found.depth_share,
        "depth_m": None if found.depth_m is None else list(found.depth_m),
        "noise_times": found.noise_times,
        "brightness": found.brightness,
        "object": None
        if found.object_mask is None
        else {"share": found.object_share, "points": found.object_corners},
        "floor": None
        if floor is None
        else {
            "up_world": floor.up_world.tolist(),
            "off_up_deg": floor.off_up_deg,
            "height_m": floor.height_m,
            "tilt_deg": floor.tilt_deg,
            "roll_deg": floor.roll_deg,
            "share": floor.share,
        },
        "still_share": found.changes.still_share,
        "changed_share": found.changes.changed_share,
        "first_change": found.changes.first_frame,
        "camera_moves": found.camera_moves,
        "grasp_frames": None if found.gripper_frames is None else list(found.gripper_frames),
        "hints": list(found.hints),
    }
