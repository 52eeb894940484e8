"""Writes descriptions: meshes first, the file that names them last."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from akm_fg.errors import OutputError
from akm_fg.export.description import Description
from akm_fg.export.mjcf import mjcf
from akm_fg.export.uncertainty import uncertainty_json
from akm_fg.export.urdf import urdf
from akm_fg.export.wavefront import coloured_obj, plain_obj
from akm_fg.io.png import replace_file
from akm_fg.model.records import ObjectModel

MESHES = "meshes"
URDF_FILE = "object.urdf"
MJCF_FILE = "object.xml"


def write_urdf(folder: Path, description: Description, model: ObjectModel) -> Path:
    """`object.urdf`, its meshes, and `joints.json` with what is not sure.

    Returns:
        The path of the URDF file.

    Raises:
        InsufficientData: a joint that URDF does not have.
        OutputError: the disk refuses.
    """
    text = urdf(description, MESHES)
    write_meshes(folder, description)
    replace_file(folder / "joints.json", uncertainty_json(model, description))
    replace_file(folder / URDF_FILE, text)
    return folder / URDF_FILE


def write_mjcf(folder: Path, description: Description, model: ObjectModel) -> Path:
    """`object.xml`, its meshes, and `joints.json` with what is not sure.

    Returns:
        The path of the MJCF file.

    Raises:
        OutputError: the disk refuses.
    """
    write_meshes(folder, description)
    replace_file(folder / "joints.json", uncertainty_json(model, description))
    replace_file(folder / MJCF_FILE, mjcf(description, MESHES))
    return folder / MJCF_FILE


def write_meshes(folder: Path, description: Description) -> None:
    """All meshes of a description, in a folder of their own.

    Raises:
        OutputError: the disk refuses.
    """
    place = folder / MESHES
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{place}: cannot be made ({error.strerror})") from error
    for name, data in _files(description):
        replace_file(place / name, data)


def _files(description: Description) -> Iterator[tuple[str, bytes]]:
    for link in (description.static, *(link for _, link in description.parts)):
        yield from coloured_obj(link.visual, link.name).items()
        for i, piece in enumerate(link.pieces):
            yield f"{link.name}-hull-{i}.obj", plain_obj(piece)
