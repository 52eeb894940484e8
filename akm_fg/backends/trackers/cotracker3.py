"""CoTracker3 (Karaev et al., 2024) from a local clone and a local checkpoint; the paper's tracker.

It is in no registry. `clone` is a folder with `hubconf.py`, as a git clone or torch.hub's cache has
it; `checkpoint` is its file of weights (`scaled_offline.pth`; licence CC-BY-NC). The network for
whole clips is asked anew with every frame, over the last `window` frames: so a frame's answer never
waits for later ones, and new points may begin at any frame. Points that are older than the window
are asked for from a frame of it in which they were seen.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.networks.loading import checkpoint_folder, packages_of
from akm_fg.backends.networks.pretrained import BROKEN, first_line
from akm_fg.backends.registry import BackendSettings
from akm_fg.errors import InputError
from akm_fg.interfaces import PointTracker, SeenPixels
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

INSTALL = "install a build of torch"
CLONE = "a clone of CoTracker (a folder with hubconf.py)"
WEIGHTS = "the file scaled_offline.pth of CoTracker3"
ENTRY = "cotracker3_offline"  # of hubconf.py


@dataclass(frozen=True, slots=True)
class CoTracker3Config:
    """Where it lies, and what its answers are worth."""

    clone: str = ""  # folder
    checkpoint: str = ""  # file
    window: int = 60  # frames, as it was trained at most
    sigma_px: float = 1.0  # of a point, either way: it says of none how sure it is
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.window < 2 or not self.sigma_px > 0.0:
            sigma = f"sigma_px {self.sigma_px}, expected above 0"
            raise ValueError(f"window {self.window}, expected at least 2; {sigma}")


class CoTracker3:
    """A `PointTracker` around CoTracker's predictor."""

    def __init__(self, predictor: Any, config: CoTracker3Config) -> None:
        """Takes the predictor with its weights."""
        self._predictor, self.config = predictor, config

    def begin(self) -> CoTrackerSession:
        """Start on a new stream."""
        return CoTrackerSession(self._predictor, self.config)


@dataclass(slots=True)
class CoTrackerSession:
    """A `TrackingSession`; memory is that of the window."""

    predictor: Any
    config: CoTracker3Config
    frames: list[NDArray[np.uint8]] = field(default_factory=list)  # (H, W, 3) of the window
    first: int = 0  # number of its first frame
    asked_at: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=int))  # (N,)
    asked_uv: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))  # (N, 2) there

    def advance(self, frame: RgbdFrame) -> SeenPixels:
        """Find the points in the next frame."""
        self.frames.append(frame.rgb)
        if not len(self.asked_at):
            self._shorten()
            return SeenPixels.none()
        uv, visible = self._tracks()
        self._forget(uv, visible)
        self._shorten()
        size = np.array([frame.camera.width, frame.camera.height])
        inside = np.isfinite(uv[-1]).all(axis=1) & (uv[-1] >= 0).all(axis=1)
        inside &= (uv[-1] <= size - 1).all(axis=1)
        return self._seen(np.flatnonzero(visible[-1] & inside), uv[-1])

    def follow(self, uv: FloatArray) -> SeenPixels:
        """Follow pixels (K, 2) of the last frame too.

        Raises:
            ValueError: no frame yet, or a pixel outside the image.
        """
        if not self.frames:
            raise ValueError("no frame yet; expected one to follow points in")
        uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        size = np.array(self.frames[-1].shape[1::-1])
        if not ((uv >= 0) & (uv <= size - 1)).all():
            raise ValueError("a query lies outside the image, or is not finite")
        n, now = len(self.asked_at), self.first + len(self.frames) - 1
        self.asked_at = np.concatenate([self.asked_at, np.full(len(uv), now)])
        self.asked_uv = np.concatenate([self.asked_uv, uv])
        return self._seen(np.arange(n, n + len(uv)), self.asked_uv)

    def _seen(self, index: NDArray[np.int_], uv: FloatArray) -> SeenPixels:
        cov = np.tile(self.config.sigma_px**2 * np.eye(2), (len(index), 1, 1))
        return SeenPixels(index, uv[index], cov)

    def _tracks(self) -> tuple[FloatArray, BoolArray]:
        """(T, N, 2) and (T, N): all points in the window's frames."""
        import torch

        video = np.stack(self.frames).transpose(0, 3, 1, 2)[None].astype(np.float32)
        at = (self.asked_at - self.first)[:, None]
        queries = np.concatenate([at, self.asked_uv], axis=1)[None].astype(np.float32)
        device = self.config.device
        with torch.inference_mode():
            tracks, visible = self.predictor(
                torch.from_numpy(video).to(device), queries=torch.from_numpy(queries).to(device)
            )
        uv = tracks[0].float().cpu().numpy().astype(np.float64)
        return uv, visible[0].cpu().numpy().astype(bool).reshape(uv.shape[:2])

    def _forget(self, uv: FloatArray, visible: BoolArray) -> None:
        """Before the window moves on: points of its first frame are asked for from a later one."""
        if len(self.frames) < self.config.window:
            return
        for i in np.flatnonzero(self.asked_at == self.first):
            later = np.flatnonzero(visible[1:, i]) + 1
            # Of a point that was never seen again: at the place where it is thought to be.
            anchor = int(later[len(later) // 2]) if later.size else 1
            self.asked_at[i], self.asked_uv[i] = self.first + anchor, uv[anchor, i]

    def _shorten(self) -> None:
        if len(self.frames) >= self.config.window:
            self.frames.pop(0)
            self.first += 1


def make(settings: BackendSettings) -> PointTracker:
    """The tracker, from the clone and the checkpoint that `stages.own.cotracker3` names.

    Raises:
        InputError: no such clone or checkpoint, or one that is broken.
        MissingDependency: torch is not installed.
    """
    config = settings.own(CoTracker3Config())
    with packages_of("cotracker3", INSTALL):
        import torch
    clone = checkpoint_folder(config.clone, "stages.own.cotracker3.clone", CLONE)
    if not (clone / "hubconf.py").is_file():
        raise InputError(clone, "has no hubconf.py", CLONE)
    if not config.checkpoint:
        problem = "is not given, and nothing is ever downloaded"
        raise InputError("stages.own.cotracker3.checkpoint", problem, WEIGHTS)
    weights = Path(config.checkpoint).expanduser()
    if not weights.is_file():
        raise InputError(weights, "is no file", WEIGHTS)
    try:
        predictor = torch.hub.load(str(clone), ENTRY, source="local", pretrained=False)
        said = torch.load(weights, map_location="cpu", weights_only=True)
        predictor.model.load_state_dict(said.get("model", said))
        predictor = predictor.eval().to(config.device)
    except (*BROKEN, ImportError, AttributeError, pickle.UnpicklingError) as e:
        raise InputError(clone, f"cannot be loaded ({first_line(e)})", CLONE) from e
    return CoTracker3(predictor, config)
