"""`akm-fg convert`: other people's recordings to a recording folder, and what was understood."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.console.lines import console
from akm_fg.cli.exit_codes import DONE
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.recordings.said import said_conventions
from akm_fg.errors import InputError
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.io.sources.prepare import Prepared
    from akm_fg.io.sources.source import SourceOptions
    from akm_fg.io.sources.understood import Understood


@dataclass(frozen=True)
class ConvertArguments:
    """Example: akm-fg convert kitchen.bag kitchen/recording

    Reads TUM RGB-D folders, ROS 1 and ROS 2 bags, MCAP, RealSense .bag, Open3D and Redwood folders,
    Record3D .r3d, and video with a depth archive; says what it understood, and writes a recording
    folder. Without OUT it only says. `akm-fg fit` reads the same formats directly.
    """

    source: Annotated[Path, tyro.conf.Positional]
    """File or folder to read."""
    out: Annotated[Path | None, tyro.conf.Positional] = None
    """New folder for the recording; without it nothing is written."""
    convention: Literal["opencv", "opengl"] | None = None
    """Axes of the camera whose poses are given: opencv x right, y down, z forward; opengl y up, z
    back. As the format has it, or found out from floor, motion or gripper, if absent."""
    invert_pose: bool = False
    """Poses are T_cam_world, from the world to the camera."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Axis of the world that points up; z if absent, or as the format has it."""
    depth_unit: float | None = None
    """Metres a unit of depth (0.001 for millimetres); as the format has it if absent."""
    intrinsics: str | None = None
    """fx,fy,cx,cy of the colour pictures in pixels, perhaps ,k1,k2,p1,p2,k3 after them."""
    rate: float | None = None
    """Pictures a second, where the format has no stamps."""
    registered: bool = False
    """Depth is at the colour's pixels, whatever the format says of frames."""
    colour_topic: str | None = None
    """Of bags, the topic of colour pictures."""
    depth_topic: str | None = None
    """Of bags, the topic of depth pictures."""
    pose_topic: str | None = None
    """Of bags, the topic of the camera's poses; the tree of transforms (tf) if absent."""
    world: str | None = None
    """Of bags, the frame that stands still; the root of the camera's transforms if absent."""
    gripper: str | None = None
    """Of bags, the gripper's frame: its pose goes into the recording."""
    start: float = 0.0
    """Begin so many seconds after the first picture."""
    stop: float | None = None
    """End so many seconds after the first picture."""
    every: int = 1
    """Take one picture in so many."""
    frames: int | None = None
    """Take so many frames and no more."""
    json: str | None = None
    """Write what was understood as a JSON object to this file; - is standard output (no words)."""


def convert(arguments: ConvertArguments) -> int:
    """Run the command.

    Raises:
        InputError: the source is of no known format, or broken.
        OutputError: OUT is not empty or cannot be written.
        MissingDependency: the library that reads the format is not installed.
    """
    from akm_fg.cli.recordings.whole_folder import check_new
    from akm_fg.io.sources.registry import open_prepared
    from akm_fg.posterior_views import finite

    if arguments.out is not None:
        check_new(arguments.out)
    options, said = source_options(arguments), said_conventions(arguments)
    with json_output(arguments.json) as results:
        prepared = open_prepared(arguments.source, options, said, arguments.frames)
        if results is None or arguments.json != "-":
            print_understood(prepared.understood)
        if arguments.out is not None:
            _write(prepared, arguments.out)
        if results is not None:
            described = prepared.understood.as_json()
            described["out"] = None if arguments.out is None else str(arguments.out)
            write_line(results, json.dumps(finite(described), allow_nan=False))
    if arguments.out is not None and arguments.json != "-":
        place = printable(str(arguments.out))
        print(f"wrote {place}; next: akm-fg fit {place}")
    return DONE


def source_options(arguments: ConvertArguments) -> SourceOptions:
    """What the flags say of a source.

    Raises:
        InputError: a flag that makes no sense.
    """
    from akm_fg.io.sources.source import SourceOptions

    numbers = None
    if arguments.intrinsics is not None:
        expected = "fx,fy,cx,cy in pixels, perhaps k1,k2,p1,p2,k3 after them"
        try:
            numbers = tuple(float(n) for n in arguments.intrinsics.replace(",", " ").split())
        except ValueError as e:
            raise InputError("--intrinsics", f"is {arguments.intrinsics!r}", expected) from e
    if arguments.rate is not None and not 0 < arguments.rate < 1e6:
        raise InputError("--rate", f"is {arguments.rate:g}", "pictures a second, above 0")
    if arguments.every < 1:
        raise InputError("--every", f"is {arguments.every}", "1 or more")
    if arguments.frames is not None and arguments.frames < 2:
        raise InputError("--frames", f"is {arguments.frames}", "2 or more")
    return SourceOptions(
        intrinsics=numbers,
        rate_hz=arguments.rate,
        registered=arguments.registered or None,
        colour_topic=arguments.colour_topic,
        depth_topic=arguments.depth_topic,
        pose_topic=arguments.pose_topic,
        world=arguments.world,
        gripper=arguments.gripper,
        start_s=arguments.start,
        stop_s=arguments.stop,
        every=arguments.every,
    )


def print_understood(understood: Understood) -> None:
    """A line each; a person sees a mistake before a fit."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, words in understood.lines():
        table.add_row(name, Text(printable(words)))
    out = console()
    out.print(printable(understood.input), soft_wrap=True)
    out.print(table)


def _write(prepared: Prepared, out: Path) -> None:
    from akm_fg.cli.recordings.whole_folder import whole_folder
    from akm_fg.io.recording import RecordingWriter

    total, terminal = len(prepared.places), sys.stderr.isatty()
    with whole_folder(out) as folder:
        with RecordingWriter(folder, prepared.depth_unit_m) as writer:
            for number, (frame, grip) in enumerate(prepared.frames(), 1):
                writer.add(frame, T_world_gripper=grip)
                if terminal:
                    end = "\n" if number == total else ""
                    print(f"\r\033[K{number}/{total}", end=end, file=sys.stderr, flush=True)
