"""DINOv2 (Oquab et al., 2023) from a local checkpoint, through transformers.

The checkpoint is a folder as `save_pretrained` writes it, of the plain model or of the one with
registers. Tokens of the last layer are the features, one for each patch of 14 pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.networks.crops import SquareCrop, normalised, require_same_size
from akm_fg.backends.networks.loading import checkpoint_folder, packages_of
from akm_fg.backends.networks.pretrained import pretrained
from akm_fg.backends.registry import BackendSettings
from akm_fg.errors import InputError
from akm_fg.interfaces import DenseFeatures, FeatureMap
from akm_fg.records import BoolArray

INSTALL = "install akm-fg[foundation] and a build of torch"
WHAT = "the folder of a DINOv2 model (config.json, model.safetensors)"
TYPES = ("dinov2", "dinov2_with_registers")


@dataclass(frozen=True, slots=True)
class DinoConfig:
    """Where the weights lie, and how finely it looks."""

    checkpoint: str = ""  # folder
    cells: int = 32  # patches along either side: 448 pixels at 14 each
    margin: float = 1.1  # of the crop around the mask
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.cells < 1 or not self.margin >= 1.0:
            raise ValueError(f"cells {self.cells}, margin {self.margin}, expected at least 1")


class DinoFeatures:
    """`DenseFeatures` of a DINOv2 model."""

    def __init__(self, model: Any, config: DinoConfig) -> None:
        """Takes the model with its weights."""
        self._model, self.config = model, config

    def describe(self, rgb: NDArray[np.uint8], mask: BoolArray) -> FeatureMap:
        """The features over the object.

        Raises:
            ValueError: sizes that differ, or a mask without a pixel.
        """
        require_same_size(rgb, mask)
        import torch

        cells = self.config.cells
        side = cells * int(self._model.config.patch_size)
        crop = SquareCrop.around(mask, side, self.config.margin)
        picture = torch.from_numpy(normalised(crop.cut(rgb))).to(self.config.device)
        with torch.inference_mode():
            tokens = self._model(pixel_values=picture).last_hidden_state[0]
        # The class's token comes first, and then the registers, if there are any.
        patches = tokens[len(tokens) - cells * cells :].float().cpu().numpy()
        features = np.ascontiguousarray(patches.reshape(cells, cells, -1))
        made_by = f"{self._model.config.model_type}-{features.shape[2]}/last/{side}"
        return crop.feature_map(features, mask, made_by)


def make(settings: BackendSettings) -> DenseFeatures:
    """The features, from the checkpoint that `stages.own.dinov2` names.

    Raises:
        InputError: no such checkpoint, or one of another model.
        MissingDependency: torch or transformers is not installed.
    """
    config = settings.own(DinoConfig())
    with packages_of("dinov2", INSTALL):
        import torch  # noqa: F401
        from transformers import AutoModel
    folder = checkpoint_folder(config.checkpoint, "stages.own.dinov2.checkpoint", WHAT)
    model = pretrained(AutoModel, folder, WHAT, config.device)
    if model.config.model_type not in TYPES:
        raise InputError(folder, f"is a model of type {model.config.model_type}", WHAT)
    return DinoFeatures(model, config)
