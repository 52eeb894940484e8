"""The EGL renderer in a process of its own.

PyBullet's plugin can draw one scene a process (a second one draws into the first one's context),
and a driver that fails ends its process. So each scene gets a child process; what happens there is
an exception here. The child reads pickled calls from its standard input and answers on its
standard output; both ends are this file.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from typing import Any, BinaryIO

from akm_fg.errors import AkmError
from sim.camera.mirror import LocalScene, Placed, Shape
from sim.camera.pictures import Picture, Renderer, Shot

PLUGIN_MODULE = "eglRenderer"


class RendererFailed(AkmError):
    """A renderer that was asked for does not work here."""


class EglScene:
    """A scene drawn with OpenGL by a child process; see `sim.camera.mirror.Scene`."""

    renderer: Renderer = "egl"

    def __init__(self) -> None:
        """Starts the child and waits until its renderer is up.

        Raises:
            RendererFailed: there is no EGL, or no plugin, or the driver gave up.
        """
        self._child = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.device = str(self._answer())  # what OpenGL calls itself, such as llvmpipe

    def show(self, shapes: Sequence[Shape]) -> None:
        """As `Scene` says.

        Raises:
            RendererFailed: the renderer gave up.
        """
        self._call("show", list(shapes))

    def draw(self, poses: Sequence[Placed], shot: Shot) -> Picture:
        """As `Scene` says.

        Raises:
            RendererFailed: the renderer gave up.
        """
        picture = self._call("draw", list(poses), shot)
        assert isinstance(picture, Picture)
        return picture

    def close(self) -> None:
        """As `Scene` says."""
        for stream in (self._child.stdin, self._child.stdout):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()
        self._child.wait()

    def _call(self, method: str, *arguments: object) -> Any:
        assert self._child.stdin is not None
        with contextlib.suppress(OSError):  # a dead child: the answer says so
            pickle.dump((method, arguments), self._child.stdin)
            self._child.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        assert self._child.stdout is not None
        try:
            problem, value = pickle.load(self._child.stdout)
        except (EOFError, pickle.UnpicklingError):
            self.close()
            raise RendererFailed(
                f"the EGL renderer ended with code {self._child.returncode}"
            ) from None
        if problem is not None:
            self.close()
            raise RendererFailed(f"the EGL renderer: {problem}")
        return value


def _serve(calls: BinaryIO, answers: BinaryIO) -> None:
    """The child: a scene at the service of the calls until they end."""

    def answer(problem: str | None, value: object) -> None:
        pickle.dump((problem, value), answers)
        answers.flush()

    try:
        scene, device = _open()
    except RuntimeError as error:
        answer(str(error), None)
        return
    answer(None, device)
    while True:
        try:
            method, arguments = pickle.load(calls)
        except EOFError:
            return
        try:
            answer(None, getattr(scene, method)(*arguments))
        except Exception as error:  # whatever it is, the parent says so
            answer(f"{type(error).__name__}: {error}", None)


def _open() -> tuple[LocalScene, str]:
    """The scene, and what the plugin prints of its device."""
    found = importlib.util.find_spec(PLUGIN_MODULE)
    if found is None or found.origin is None:
        raise RuntimeError("this build of PyBullet has no EGL plugin")
    with tempfile.TemporaryFile() as said:
        before = os.dup(1)
        os.dup2(said.fileno(), 1)
        try:
            scene = LocalScene("egl", found.origin)
        finally:
            os.dup2(before, 1)
            os.close(before)
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    names = [line.split("=", 1)[1].strip() for line in lines if line.startswith("GL_RENDERER")]
    return scene, names[0] if names else "unknown"


def _main() -> None:
    """Keeps the answers to itself: what drivers print on standard output goes nowhere."""
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    _serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    _main()
