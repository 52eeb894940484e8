"""Contents as a recording of rerun's viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from akm_fg.errors import MissingDependency, OutputError
from akm_fg.io.png import replace_file
from akm_fg.view.contents import Contents
from akm_fg.view.page import AXIS_RGB, FRAMES_A_SECOND, PART_TINT, POINT_M, REST_TINT


def write_rerun(path: Path, contents: Contents) -> None:
    """Write an .rrd file: clouds, axis with its cone, tracks, and the parts over time.

    Raises:
        MissingDependency: rerun is not installed.
        OutputError: the disk refuses.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise MissingDependency("--rerun needs rerun-sdk; install akm-fg[rerun]") from error
    recording = rr.RecordingStream("akm-fg")
    memory = recording.memory_recording()
    _log_scene(rr, recording, contents)
    for number, q in contents.frames():
        recording.set_time("frame", sequence=number)
        recording.set_time("time", duration=number / FRAMES_A_SECOND)
        for moving, state in zip(contents.parts, q, strict=True):
            T = moving.part.T_seen_part(state).matrix()
            moved = rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
            recording.log(f"world/{moving.part.name}", moved)
            recording.log(f"state/{moving.part.name}", rr.Scalars(state))
    data = memory.drain_as_bytes()
    if not data:
        raise OutputError(f"{path}: rerun gave nothing to write")
    replace_file(path, data)


def _log_scene(rr: Any, recording: Any, contents: Contents) -> None:
    """What does not move, for all time, and the parts in their own frames."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    still = contents.static
    points = rr.Points3D(still.p_world, colors=still.rgb, radii=POINT_M / 2)
    recording.log("world/static", points, static=True)
    for moving in contents.parts:
        name, axis = moving.part.name, moving.axis
        points = rr.Points3D(moving.cloud.p_world, colors=moving.cloud.rgb, radii=POINT_M / 2)
        recording.log(f"world/{name}/cloud", points, static=True)
        start, end = axis.ends_world
        words = "; ".join(moving.words)
        arrow = rr.Arrows3D(origins=[start], vectors=[end - start], colors=AXIS_RGB, labels=words)
        recording.log(f"world/axis-{name}/arrow", arrow, static=True)
        cone = rr.Mesh3D(
            vertex_positions=axis.p_world,
            triangle_indices=axis.triangles,
            albedo_factor=[*AXIS_RGB, 64],
        )
        recording.log(f"world/axis-{name}/cone", cone, static=True)
    if contents.tracks is not None:
        colours = np.where(contents.tracks.moving[:, None], PART_TINT, REST_TINT).astype(np.uint8)
        lines = rr.LineStrips3D(contents.tracks.segments_world, colors=colours)
        recording.log("world/tracks", lines, static=True)
