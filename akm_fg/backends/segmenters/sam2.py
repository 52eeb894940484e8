"""SAM 2 (Ravi et al., 2024) from a local checkpoint, through transformers.

Where the object is, floor and walls tell, as for the default segmenter; SAM 2 is asked, by the box
around what that found, where exactly it ends: in colour, where depth frays. The checkpoint is a
folder as `save_pretrained` writes it. Images are resized and normalised here: the package's own
processor needs torchvision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.networks.crops import normalised
from akm_fg.backends.networks.loading import checkpoint_folder, packages_of
from akm_fg.backends.networks.pretrained import pretrained
from akm_fg.backends.registry import BackendSettings
from akm_fg.backends.segmenters import depth
from akm_fg.errors import TracksLost
from akm_fg.interfaces import ObjectSegmenter
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

INSTALL = "install akm-fg[foundation] and a build of torch"
WHAT = "the folder of a SAM 2 model (config.json, model.safetensors)"


@dataclass(frozen=True, slots=True)
class Sam2Config:
    """Where the weights lie, and how it is asked."""

    checkpoint: str = ""  # folder
    box_margin: float = 0.02  # of the box's sides, around what depth found
    least_overlap: float = 0.5  # with what depth found; below it SAM 2 means something else
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not self.box_margin >= 0.0 or not 0.0 <= self.least_overlap <= 1.0:
            margin = f"box_margin {self.box_margin}, expected at least 0"
            raise ValueError(f"{margin}; least_overlap {self.least_overlap}, expected 0 to 1")


class Sam2Segmenter:
    """`ObjectSegmenter`; what depth found is the prompt."""

    def __init__(self, model: Any, rough: ObjectSegmenter, config: Sam2Config) -> None:
        """Takes the model with its weights, and what finds the object roughly."""
        self._model, self._rough, self.config = model, rough, config

    def segment(self, frame: RgbdFrame) -> BoolArray:
        """(H, W), True on the object.

        Raises:
            TracksLost: nothing stands out from floor and wall, or SAM 2 sees another thing there.
        """
        rough = self._rough.segment(frame)
        mask = self._mask(frame.rgb, _box(rough, self.config.box_margin))
        overlap = (mask & rough).sum() / max(1, (mask | rough).sum())
        if overlap < self.config.least_overlap:
            share = f"only {100 * overlap:.0f} % of"
            raise TracksLost(f"no object found: SAM 2 agrees on {share} what depth shows")
        return mask

    def _mask(self, rgb: NDArray[np.uint8], box_uv: FloatArray) -> BoolArray:
        """(H, W) of the one thing inside a box (4,): left, top, right, bottom."""
        import torch

        (height, width), side = rgb.shape[:2], self._side_px()
        square = cv2.resize(rgb, (side, side), interpolation=cv2.INTER_AREA)
        picture = torch.from_numpy(normalised(np.asarray(square, dtype=np.uint8)))
        scale = np.tile([side / width, side / height], 2)
        box = torch.from_numpy((box_uv * scale).astype(np.float32))[None, None]
        with torch.inference_mode():
            said = self._model(
                pixel_values=picture.to(self.config.device),
                input_boxes=box.to(self.config.device),
                multimask_output=False,
            )
        logits = said.pred_masks.float().cpu().numpy().reshape(said.pred_masks.shape[-2:])
        return np.asarray(cv2.resize(logits, (width, height)) > 0.0)

    def _side_px(self) -> int:
        """Of the square that the network takes."""
        size = self._model.config.prompt_encoder_config.image_size
        return int(size if isinstance(size, int) else size[0])


def _box(mask: BoolArray, margin: float) -> FloatArray:
    """(4,) around a mask, with a margin, inside the image."""
    rows, columns = np.nonzero(mask)
    low = np.array([columns.min(), rows.min()], dtype=float)
    high = np.array([columns.max() + 1, rows.max() + 1], dtype=float)
    room = margin * (high - low)
    most = np.array(mask.shape[::-1], dtype=float)
    return np.concatenate([np.maximum(low - room, 0.0), np.minimum(high + room, most)])


def make(settings: BackendSettings) -> ObjectSegmenter:
    """The segmenter, from the checkpoint that `stages.own.sam2` names.

    Raises:
        InputError: no such checkpoint, or one of another model.
        MissingDependency: torch or transformers is not installed.
    """
    config = settings.own(Sam2Config())
    with packages_of("sam2", INSTALL):
        import torch  # noqa: F401
        from transformers import Sam2Model
    folder = checkpoint_folder(config.checkpoint, "stages.own.sam2.checkpoint", WHAT)
    model = pretrained(Sam2Model, folder, WHAT, config.device)
    return Sam2Segmenter(model, depth.make(settings), config)
