"""`akm-fg export`: a model for others: URDF, MJCF, GLB, ROS messages."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.console.lines import complain
from akm_fg.cli.exit_codes import DONE, UNDECIDED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import InputError, InsufficientData
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.export.description import Description
    from akm_fg.model.records import ObjectModel
    from akm_fg.records import Recording


@dataclass(frozen=True)
class ExportArguments:
    """Example: akm-fg export runs/kitchen --urdf kitchen_urdf

    Writes the joint with its limits, the parts as coloured meshes with convex pieces to touch, and
    beside them joints.json: how sure the joint is. Meshes are fused from the recording that the
    model names, if it is there. The exit code is 1 where the joint's kind is undecided.
    """

    model: Annotated[Path, tyro.conf.Positional]
    """A model.json, or the folder that holds it: one that fit --out or an exploration left."""
    urdf: Path | None = None
    """Folder for object.urdf and its meshes."""
    mjcf: Path | None = None
    """Folder for object.xml (MuJoCo) and its meshes."""
    glb: Path | None = None
    """File for meshes and joint as one binary glTF, with an animation of its range."""
    ros: bool = False
    """Print the joint and its last state as text of ROS 2 messages."""
    recording: Path | None = None
    """The recording of the first part, where it is not at the place that the model names."""
    collision: Literal["pieces", "hull"] = "pieces"
    """What is touched: convex pieces, or one convex hull a part."""
    json: str | None = None
    """Write what joints.json holds to this file, in a line; - is standard output."""
    seed: int = 0
    """Not used: nothing here is random."""


def export(arguments: ExportArguments) -> int:
    """Run the command.

    Raises:
        InputError: no such model, nothing asked for, or a recording that is not the model's.
        OutputError: the disk refuses.
        MissingDependency: what a format needs is not installed.
    """
    wanted = (arguments.urdf, arguments.mjcf, arguments.glb)
    if not any(wanted) and not arguments.ros and arguments.json is None:
        raise InputError("export", "nothing to write", "--urdf, --mjcf, --glb or --ros")
    from akm_fg.model.read import read_model

    model = read_model(arguments.model)
    if arguments.ros:
        _print_messages(model)
    if not any(wanted) and arguments.json is None:
        return DONE
    from akm_fg.export.describe import describe
    from akm_fg.export.uncertainty import uncertainty_json

    with json_output(arguments.json) as results:
        try:
            first, *more = _recordings(arguments, model)
            description = describe(model, first, more=more, one_hull=arguments.collision == "hull")
            files = _write(arguments, model, description)
        except InsufficientData as error:
            complain(str(error))
            return UNDECIDED
        if results is not None:
            fields = json_module.loads(uncertainty_json(model, description))
            write_line(results, json_module.dumps(fields, allow_nan=False))
    if arguments.json != "-" and not arguments.ros:
        for file in files:
            print(printable(str(file)))
    return DONE


def _recordings(arguments: ExportArguments, model: ObjectModel) -> list[Recording | None]:
    """One a part."""
    from akm_fg.export.describe import goes_with, recording_of

    folder = arguments.model if arguments.model.is_dir() else arguments.model.parent
    found = [recording_of(model, folder, part) for part in range(len(model.parts))]
    if arguments.recording is None:
        return found
    from akm_fg.io.recording import read_recording

    recording = read_recording(arguments.recording)
    if not goes_with(model, recording):
        states = model.parts[0].states
        count = 0 if states is None else states.mean.size
        problem = f"has {len(recording.frames)} frames"
        raise InputError(arguments.recording, problem, f"the model's recording, of {count}")
    return [recording, *found[1:]]


def _write(arguments: ExportArguments, model: ObjectModel, description: Description) -> list[Path]:
    from akm_fg.export.glb import glb
    from akm_fg.export.write import write_mjcf, write_urdf
    from akm_fg.io.png import replace_file

    files = []
    if arguments.urdf is not None:
        files.append(write_urdf(arguments.urdf, description, model))
    if arguments.mjcf is not None:
        files.append(write_mjcf(arguments.mjcf, description, model))
    if arguments.glb is not None:
        replace_file(arguments.glb, glb(description, model))
        files.append(arguments.glb)
    return files


def _print_messages(model: ObjectModel) -> None:
    from akm_fg.export.ros import ros_messages

    for part in model.parts:
        for kind, text in ros_messages(part):
            print(f"# {printable(part.name)}: {kind}\n{text}\n---")
