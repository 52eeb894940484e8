"""Contents as a page in a browser, by viser: live with controls, or one file that plays by itself.

The file needs no server and no network: viser's own page and the scene are inside.
"""

from __future__ import annotations

import html as html_module
import io
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from akm_fg.errors import MissingDependency
from akm_fg.model.records import ModelPart
from akm_fg.view.contents import Contents, MovingPart

POINT_M = 0.003
PART_TINT, REST_TINT = (255, 140, 40), (70, 130, 220)
AXIS_RGB = (220, 30, 60)
FRAMES_A_SECOND = 10.0
_EYE_SHARE = 0.75  # of the way from the part to where the recording's camera stood
_DIGITS = 1  # of degrees and centimetres on a slider
_END_S = 1.0  # the last frame stays


def _viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise MissingDependency("a 3-D page needs viser; install akm-fg[view]") from error
    return viser


def _server(host: str, port: int, title: str) -> Any:
    """A server that prints nothing: what is said is the command line's."""
    viser = _viser()
    with redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label=title, verbose=False)


def _stop(server: Any) -> None:
    with redirect_stdout(io.StringIO()):
        server.stop()


@dataclass
class Drawn:
    """What of a drawn scene moves or is hidden."""

    parts: list[tuple[MovingPart, Any]]  # with the handle of its frame
    tracks: Any | None
    axes: list[Any]

    def move(self, q: list[float]) -> None:
        """Put the parts where their states are."""
        for (part, frame), state in zip(self.parts, q, strict=True):
            frame.wxyz, frame.position = _placed(part.part, state)


def _placed(part: ModelPart, q: float) -> tuple[Any, Any]:
    from scipy.spatial.transform import Rotation

    T = part.T_seen_part(q).matrix()
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return np.array([w, x, y, z]), T[:3, 3]


def draw(server: Any, contents: Contents) -> Drawn:
    """Put the contents into a viser server's scene, its parts in the closed pose."""
    scene = server.scene
    scene.set_up_direction("+z")
    middle = contents.middle_world
    server.initial_camera.look_at = middle
    server.initial_camera.position = middle + _EYE_SHARE * (contents.eye_world - middle)
    scene.add_point_cloud(
        "/static",
        contents.static.p_world,
        contents.static.rgb,
        point_size=POINT_M,
        precision="float32",
    )
    parts, axes = [], []
    for moving in contents.parts:
        name = f"/{moving.part.name}"
        frame = scene.add_frame(name, show_axes=False)
        cloud = moving.cloud
        scene.add_point_cloud(
            f"{name}/cloud", cloud.p_world, cloud.rgb, point_size=POINT_M, precision="float32"
        )
        parts.append((moving, frame))
        axes += _draw_axis(scene, moving)
    tracks = None
    if contents.tracks is not None:
        moves = contents.tracks.moving[:, None, None]
        colours = np.where(moves, PART_TINT, REST_TINT).astype(np.uint8).repeat(2, axis=1)
        lines = contents.tracks.segments_world
        tracks = scene.add_line_segments("/tracks", lines, colours, thickness=0.002)
    return Drawn(parts, tracks, axes)


def _draw_axis(scene: Any, moving: MovingPart) -> list[Any]:
    name, axis = f"/axis-{moving.part.name}", moving.axis
    arrow = scene.add_arrows(
        f"{name}/arrow",
        axis.ends_world[None],
        AXIS_RGB,
        shaft_radius=0.004,
        head_radius=0.012,
        head_length=0.04,
    )
    cone = scene.add_mesh_simple(
        f"{name}/cone", axis.p_world, axis.triangles, color=AXIS_RGB, opacity=0.25, side="double"
    )
    words = scene.add_label(f"{name}/words", moving.axis_in_words, position=axis.ends_world[1])
    return [arrow, cone, words]


@contextmanager
def serving(contents: Contents, host: str = "127.0.0.1", port: int = 8080) -> Iterator[Any]:
    """A live page with controls, until the block is left.

    Args:
        contents: to be shown.
        host: where from it can be reached.
        port: the first that is tried.

    Raises:
        MissingDependency: viser is not installed.
    """
    server = _server(host, port, contents.title)
    try:
        _add_controls(server, contents, draw(server, contents))
        yield server
    finally:
        _stop(server)


def _add_controls(server: Any, contents: Contents, drawn: Drawn) -> None:
    """A slider for each part's state, one for the frames, and what is shown."""
    gui = server.gui
    for part in contents.parts:
        lines = "  \n".join(html_module.escape(line) for line in part.words)
        gui.add_markdown(lines)
    sliders = []
    for part in contents.parts:
        low, high = (part.per_unit * end for end in part.part.range_seen())
        closed = part.per_unit * part.part.closed_state
        slider = gui.add_slider(
            f"{part.part.name} [{part.unit_name}]",
            min=round(low, _DIGITS),
            max=round(high, _DIGITS),
            step=10.0**-_DIGITS,
            initial_value=round(min(max(closed, low), high), _DIGITS),
        )
        sliders.append(slider)

    def moved(_: Any) -> None:
        scales = [part.per_unit for part in contents.parts]
        drawn.move([slider.value / scale for slider, scale in zip(sliders, scales, strict=True)])

    for slider in sliders:
        slider.on_update(moved)
    frames = list(contents.frames())
    if len(frames) > 1:

        def played(_: Any) -> None:
            for _number, q in frames:
                for slider, part, state in zip(sliders, contents.parts, q, strict=True):
                    shown = part.per_unit * state  # moves the part: the slider says so
                    slider.value = min(max(shown, slider.min), slider.max)
                time.sleep(1 / FRAMES_A_SECOND)

        gui.add_button("Play the recording").on_click(played)
    for words, handles in (("axis", drawn.axes), ("tracks", [drawn.tracks])):
        shown = [handle for handle in handles if handle is not None]
        if shown:
            _add_switch(gui, words, shown)


def _add_switch(gui: Any, words: str, handles: list[Any]) -> None:
    box = gui.add_checkbox(f"Show {words}", initial_value=True)

    def switched(_: Any) -> None:
        for handle in handles:
            handle.visible = box.value

    box.on_update(switched)


def html_page(contents: Contents) -> str:
    """One self-contained page that plays the recording, with a slider over its frames.

    Raises:
        MissingDependency: viser is not installed.
    """
    server = _server("127.0.0.1", 0, contents.title)
    try:
        drawn = draw(server, contents)
        recorder = server.get_scene_serializer()
        for number, q in contents.frames():
            drawn.move(q)
            for part, state in zip(contents.parts, q, strict=True):
                sd = float(part.sd[number])
                words = part.state_in_words(state, sd if np.isfinite(part.q[number]) else None)
                place = part.part.T_seen_part(state).transformFrom(part.cloud.p_world.mean(axis=0))
                server.scene.add_label(f"/state-{part.part.name}", words, position=place)
            recorder.insert_sleep(1 / FRAMES_A_SECOND)
        recorder.insert_sleep(_END_S)
        page = str(recorder.as_html())
    finally:
        _stop(server)
    return _titled(page, contents.title)


def _titled(page: str, title: str) -> str:
    start, end = page.find("<title>"), page.find("</title>")
    if start < 0 or end < start:
        return page
    return page[: start + len("<title>")] + html_module.escape(title) + page[end:]
