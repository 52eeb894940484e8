"""A browser by its DevTools protocol: what a page says, and how it looks, after it was used.

https://chromedevtools.github.io/devtools-protocol/
"""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
# WebGL without a graphics card, and no network.
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip
PATIENCE_S = 60.0


class Page:
    """The one page of a browser; `said` is what its console and its log told."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._number, self.said = socket, 0, list[str]()
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")

    def _hear(self, message: dict[str, Any]) -> None:
        told = message.get("params", {})
        if message.get("method") == "Runtime.consoleAPICalled":
            words = " ".join(str(argument.get("value")) for argument in told["args"])
            self.said.append(f"{told['type']}: {words}")
        if message.get("method") == "Runtime.exceptionThrown":
            self.said.append(f"exception: {told['exceptionDetails']}")
        if message.get("method") == "Log.entryAdded":
            self.said.append(f"{told['entry']['level']}: {told['entry']['text']}")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command, and its result."""
        self._number += 1
        asked = {"id": self._number, "method": method, "params": parameters}
        self._socket.send(json.dumps(asked))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if message.get("id") == self._number:
                return message["result"]
            self._hear(message)

    def run(self, script: str) -> Any:
        """The value of JavaScript."""
        return self.call("Runtime.evaluate", expression=script)["result"].get("value")

    def hears(self, words: str, within_s: float = PATIENCE_S) -> bool:
        """Whether the page says so in time."""
        end = time.monotonic() + within_s
        while not any(words in line for line in self.said) and time.monotonic() < end:
            self.listen(0.2)
        return any(words in line for line in self.said)

    def listen(self, seconds: float) -> None:
        """Give it time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                left = max(end - time.monotonic(), 0.01)
                self._hear(json.loads(self._socket.recv(timeout=left)))
            except TimeoutError:
                return

    def picture(self) -> np.ndarray:
        """(H, W, 3) of what is on the screen."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def shows(self, what: Callable[[np.ndarray], bool], within_s: float = PATIENCE_S) -> bool:
        """Whether the screen shows it in time: a page drawn without a GPU fills by and by."""
        end = time.monotonic() + within_s
        while not what(self.picture()):
            if time.monotonic() > end:
                return False
            self.listen(1.0)
        return True


@contextmanager
def opened(file: Path, size: tuple[int, int], profile: Path) -> Iterator[Page]:
    """A page of a file, on a screen of that width and height."""
    if BROWSER is None:
        pytest.skip("no browser is found")
    connect = pytest.importorskip("websockets.sync.client").connect
    command = [BROWSER, *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0"]
    pipe = subprocess.DEVNULL
    with subprocess.Popen([*command, "about:blank"], stdout=pipe, stderr=pipe) as browser:
        try:
            with connect(_first_tab(profile), max_size=None) as socket:
                page = Page(socket)
                width, height = size
                page.call(
                    "Emulation.setDeviceMetricsOverride",
                    width=width, height=height, deviceScaleFactor=1, mobile=width < height,
                )  # fmt: skip
                page.call("Page.navigate", url=file.as_uri())
                page.listen(2.0)
                yield page
        finally:
            browser.terminate()


def _first_tab(profile: Path) -> str:
    """The address of its page, when the browser has begun."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            port = (profile / "DevToolsActivePort").read_text().split()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=10) as answer:
                tabs = json.load(answer)
            return next(t["webSocketDebuggerUrl"] for t in tabs if t["type"] == "page")
        except (OSError, IndexError, StopIteration):
            time.sleep(0.2)
    raise AssertionError("the browser does not begin")
