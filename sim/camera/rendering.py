"""Which renderer draws the pictures, chosen once a process.

TinyRenderer draws on any machine. The EGL plugin needs a driver, and draws faster only where a
graphics card does it: so it is chosen where a card is there and a trial in a child process comes
out right, and wherever it is asked for, by CameraConfig or by the environment.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

import gtsam
import numpy as np

from sim.bullet import p
from sim.camera.egl_process import EglScene, RendererFailed
from sim.camera.mirror import LocalScene, Scene, Shape
from sim.camera.pictures import (
    NEAR_M,
    Renderer,
    Shot,
    height_above_plane,
    projection_matrix,
    rendered_intrinsics,
    view_matrix,
)

Wanted = Literal["auto", "tiny", "egl"]
ENVIRONMENT = "AKM_FG_RENDERER"
CARDS = ("dri/renderD*", "nvidia[0-9]*", "dxg")  # under /dev
SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader")  # OpenGL without a card
EGL_MOST = (1024, 768)  # the plugin's window: larger pictures are enlarged from it
EXACT_M = 1e-4  # a trial plane must project back this closely
PLANE_M = 1.1  # distance of the trial plane


@dataclass(frozen=True, slots=True)
class Choice:
    """A renderer and why it was taken."""

    name: Renderer
    reason: str


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of drawing with EGL once."""

    device: str  # what OpenGL calls itself; empty where it did not start
    problem: str | None

    @property
    def on_card(self) -> bool:
        """Whether it works, and in hardware."""
        named = self.device.lower()
        return self.problem is None and not any(name in named for name in SOFTWARE)


def open_scene(choice: Choice) -> Scene:
    """A scene drawn by the chosen renderer.

    Raises:
        RendererFailed: EGL does not start.
    """
    return EglScene() if choice.name == "egl" else LocalScene()


def has_card(devices: Path = Path("/dev")) -> bool:
    """Whether the system names a graphics card."""
    return any(True for pattern in CARDS for _ in devices.glob(pattern))


@functools.cache
def try_egl() -> Trial:
    """Draws a plane in a child process, once a process, and looks whether it is where it is."""
    try:
        scene = EglScene()
    except (RendererFailed, OSError) as error:
        return Trial("", str(error))
    try:
        error_m = plane_error_m(scene)
    except RendererFailed as error:
        return Trial(scene.device, str(error))
    finally:
        scene.close()
    if not error_m < EXACT_M:
        return Trial(scene.device, f"a plane comes out wrong by {1e3 * error_m:.2f} mm")
    return Trial(scene.device, None)


@dataclass(frozen=True, slots=True)
class Machine:
    """What is found out of a machine before its renderer is chosen; both are asked when needed."""

    has_card: Callable[[], bool] = has_card
    try_egl: Callable[[], Trial] = try_egl


def choose_renderer(
    wanted: Wanted = "auto",
    size: tuple[int, int] = (640, 480),
    machine: Machine | None = None,
) -> Choice:
    """The renderer to draw with: `wanted`, else the environment's, else what suits the machine.

    Args:
        wanted: a renderer, or `auto`.
        size: of the pictures, (width, height).
        machine: to draw on; this one, found out by trial once a process, if absent.

    Raises:
        ValueError: the environment names no renderer.
        RendererFailed: EGL was asked for and does not work here, or not at this size.
    """
    machine = machine or Machine()
    name, by = (wanted, "asked for") if wanted != "auto" else _of_environment()
    too_large = size[0] > EGL_MOST[0] or size[1] > EGL_MOST[1]
    if name == "tiny":
        return Choice("tiny", by)
    if name == "egl":
        too_much = f"{size[0]} x {size[1]} is more than it draws"
        problem = too_much if too_large else machine.try_egl().problem
        if problem is not None:
            raise RendererFailed(f"EGL ({by}) does not work here: {problem}")
        return Choice("egl", f"{by}, {machine.try_egl().device}")
    if too_large:
        return Choice("tiny", "EGL draws smaller pictures alone")
    if not machine.has_card():
        return Choice("tiny", "no graphics card")
    trial = machine.try_egl()
    if trial.on_card:
        return Choice("egl", trial.device)
    return Choice("tiny", trial.problem or f"EGL is drawn in software ({trial.device})")


def plane_error_m(
    scene: Scene, size: tuple[int, int] = (160, 120), convention: Renderer | None = None
) -> float:
    """How far the pixels of a plane, seen askew, project back from it at the most; NaN if none.

    Args:
        scene: draws the plane.
        size: of the picture, (width, height).
        convention: of which renderer pixels are taken to be; of the scene's own if absent.
    """
    axes = np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    askew = gtsam.Rot3.RzRyRx(0.1, 0.25, -0.4)
    T_world_cam = gtsam.Pose3(askew * gtsam.Rot3(axes), np.array([0.0, 0.3, 0.2]))
    focal_px, near_m, far_m = 600.0 * size[0] / 640.0, NEAR_M[scene.renderer], 8.0
    projection = projection_matrix(size, focal_px, near_m, far_m)
    shot = Shot(*size, view_matrix(T_world_cam), projection, near_m, far_m, (-1.0, 0.6, 2.5))
    at_rest = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    half_m = 0.05
    scene.show([Shape(0, -1, p.GEOM_BOX, (2.0 * half_m, 10.0, 10.0), "", at_rest, (1.0,) * 4)])
    depth = scene.draw([((PLANE_M + half_m, 0.0, 0.0), at_rest[1])], shot).depth_m
    camera = rendered_intrinsics(*size, focal_px, convention or scene.renderer)
    return float(np.abs(height_above_plane(depth, camera, T_world_cam, 0, PLANE_M)).max())


def _of_environment() -> tuple[Wanted, str]:
    name = os.environ.get(ENVIRONMENT, "auto")
    if name not in get_args(Wanted):
        raise ValueError(f"{ENVIRONMENT}={name!r}, expected one of {', '.join(get_args(Wanted))}")
    return cast(Wanted, name), f"{ENVIRONMENT}={name}"
