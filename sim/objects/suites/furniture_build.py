"""Writes a piece of furniture as URDF, meshes and textures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.library_boxes import shifted
from sim.objects.meshes import Box
from sim.objects.part_spec import BuiltObject
from sim.objects.suites.finishes import write_textures
from sim.objects.suites.fronts import dress
from sim.objects.suites.furniture_body import Body, make_body
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.objects.suites.handles import edge_strip, handle_boxes, handle_pose
from sim.objects.urdf.urdf_files import MovingBoxes, write_urdf


def build_furniture(spec: FurnitureSpec, folder: Path) -> BuiltObject:
    """Writes the object's files into `folder`; the same spec gives the same bytes."""
    pieces = _pieces_of(spec)
    write_textures(spec, folder)
    body = pieces.body
    urdf = write_urdf(
        spec,
        pieces.corpus,
        pieces.part,
        body.origin,
        body.axis,
        folder,
        one_grain=True,
        more=[
            MovingBoxes(front, boxes, moving.origin, moving.axis)
            for front, boxes, moving in zip(spec.more, pieces.more, body.more, strict=True)
        ],
    )
    return _built(spec, pieces, urdf)


def measure_furniture(spec: FurnitureSpec) -> BuiltObject:
    """The object's geometry alone: no file is written, and its URDF is nowhere."""
    return _built(spec, _pieces_of(spec), Path())


@dataclass(frozen=True, slots=True)
class _Pieces:
    body: Body
    corpus: list[Box]  # with what the locked fronts carry
    part: list[Box]
    T_part_handle: gtsam.Pose3
    p_locked: list[FloatArray]  # (3,) of handles on locked fronts, object frame
    more: list[list[Box]]  # of the further parts, in their frames
    p_more: list[FloatArray]  # (3,) of their handles, object frame


def _pieces_of(spec: FurnitureSpec) -> _Pieces:
    body = make_body(spec)
    lower, upper = body.front()
    T_part_handle = handle_pose(spec, lower, upper)
    part = body.part + handle_boxes(spec.handle, T_part_handle)
    if spec.handle.style == "edge":
        part = [*part, edge_strip(spec, spec.hinge, lower, upper)]
    dressed = dress(spec, body)
    corpus = [*body.corpus, *dressed.boxes]
    more = [
        [*moving.boxes, *(shifted(box, -moving.origin) for box in boxes)]
        for moving, boxes in zip(body.more, dressed.more, strict=True)
    ]
    return _Pieces(body, corpus, part, T_part_handle, dressed.p_handles, more, dressed.p_more)


def _built(spec: FurnitureSpec, pieces: _Pieces, urdf: Path) -> BuiltObject:
    body, T_part_handle = pieces.body, pieces.T_part_handle
    lower, upper = body.front()
    middle = (lower + upper) / 2.0
    middle[1] = lower[1]
    return BuiltObject(
        spec=spec,
        urdf=urdf,
        axis_object=body.axis,
        pivot_object=body.origin,
        T_object_handle=_moved(T_part_handle, body.origin),
        p_object_front=body.origin + middle,
        handle_thickness_m=spec.handle.thickness_m,
        p_object_handles=np.array(
            [T_part_handle.translation() + body.origin, *pieces.p_more, *pieces.p_locked]
        ),
        more_axes_object=np.array([moving.axis for moving in body.more]).reshape(-1, 3),
        more_pivots_object=np.array([moving.origin for moving in body.more]).reshape(-1, 3),
    )


def _moved(T_part_handle: gtsam.Pose3, origin: FloatArray) -> gtsam.Pose3:
    """T_object_handle: closed, the part's frame is only shifted."""
    return gtsam.Pose3(T_part_handle.rotation(), T_part_handle.translation() + origin)
