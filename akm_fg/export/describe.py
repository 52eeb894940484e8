"""From a model, and its recording where it is at hand, to a description with meshes."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import InputError, InsufficientData
from akm_fg.export.config import ExportConfig
from akm_fg.export.description import Description, Link, Mesh, joint_of
from akm_fg.export.fusion import PlacedFrame, fused_mesh, poisson_mesh
from akm_fg.export.pieces import convex_pieces, nominal_mass
from akm_fg.io.recording import read_recording
from akm_fg.model.records import ModelPart, ObjectModel, Surface
from akm_fg.records import Recording

log = logging.getLogger("akm_fg.progress")
_LEAST_TRIANGLES = 10


def recording_of(model: ObjectModel, folder: Path, part: int = 0) -> Recording | None:
    """The recording whose states a part's posterior has, if it is where the model says.

    Args:
        model: names it, as a path or a path beside the model.
        folder: of the model.
        part: place of the part.
    """
    sources = model.parts[part].sources or model.sources
    for source in sources[:1]:
        for place in (Path(source), folder / source):
            try:
                recording = read_recording(place)
            except (InputError, OSError, ValueError):
                continue
            if goes_with(model, recording, part):
                return recording
    return None


def goes_with(model: ObjectModel, recording: Recording, part: int = 0) -> bool:
    """Whether a part's posterior may be of a recording: it has its frames' states."""
    states = model.parts[part].states
    return states is not None and states.mean.size == len(recording.frames)


def describe(
    model: ObjectModel,
    recording: Recording | None = None,
    *,
    more: Sequence[Recording | None] = (),
    name: str = "object",
    one_hull: bool = False,
    config: ExportConfig | None = None,
) -> Description:
    """Links with meshes and joints.

    Args:
        model: of the object.
        recording: whose states the first part's posterior has; None: the model's points do.
        more: the same of the parts after the first, in the model's order.
        name: of the object.
        one_hull: one convex hull a link for collisions, instead of pieces.
        config: tuning.

    Raises:
        InsufficientData: a kind is undecided, or a surface is too small for a mesh.
        MissingDependency: what cuts into convex pieces is not installed.
    """
    config = config or ExportConfig()
    joints = [joint_of(part) for part in model.parts]
    recordings = [recording, *more, *[None] * (len(model.parts) - 1 - len(more))]
    links = []
    for i, (part, joint) in enumerate(zip(model.parts, joints, strict=True)):
        own = recordings[i]
        how = "" if own is not None else ", through the model's points: no recording is at hand"
        log.info("%s: mesh and convex pieces%s", part.name, how)
        placed = [] if own is None else _placed(part, own, config)
        mesh = _mesh(part.name, part.surface.moved(part.T_world_seen), placed, config)
        link = _link(part.name, mesh.moved(-joint.origin_world), one_hull, config)
        links.append((joint, link))
    log.info("static: mesh and convex pieces")
    # What rests is in one world, the first part's.
    corrected = [replace(part, correction=model.parts[0].correction) for part in model.parts]
    resting = [
        frame
        for part, own in zip(corrected, recordings, strict=True)
        if own is not None
        for frame in _placed(part, own, config)
    ]
    still = [replace(each, T_world_surface=gtsam.Pose3()) for each in resting]
    resting_surface = model.static.objects_own.moved(model.parts[0].T_world_seen)
    mesh = _mesh("static", resting_surface, still, config)
    return Description(name, _link("static", mesh, one_hull, config), tuple(links))


def _placed(part: ModelPart, recording: Recording, config: ExportConfig) -> list[PlacedFrame]:
    """Frames spread over the states, with the part where its state puts it."""
    assert part.states is not None
    q = part.states.mean
    known = np.flatnonzero(np.isfinite(q))
    wanted = np.linspace(q[known].min(), q[known].max(), config.frames)
    chosen = sorted({int(known[np.argmin(np.abs(q[known] - w))]) for w in wanted})
    frames = [part.corrected(recording.frames[k]) for k in chosen]
    places = [part.T_world_part(float(q[k])) for k in chosen]
    return [PlacedFrame(*each) for each in zip(frames, places, strict=True)]


def _mesh(name: str, surface: Surface, frames: list[PlacedFrame], config: ExportConfig) -> Mesh:
    if not len(surface):
        raise InsufficientData(f"{name}: nothing is known of its surface")
    mesh = fused_mesh(surface, frames, config) if frames else poisson_mesh(surface, config)
    if len(mesh.triangles) < _LEAST_TRIANGLES:
        raise InsufficientData(f"{name}: too little of its surface was seen for a mesh")
    return mesh


def _link(name: str, mesh: Mesh, one_hull: bool, config: ExportConfig) -> Link:
    pieces = convex_pieces(mesh, config, one_hull)
    return Link(name, mesh, pieces, nominal_mass(pieces, config))
