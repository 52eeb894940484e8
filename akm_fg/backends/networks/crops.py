"""A square of an image around an object, at the size that a network takes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.interfaces import FeatureMap
from akm_fg.records import BoolArray, FloatArray

# Of the pictures of ImageNet, on which these networks were trained; channels of 0..1.
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], dtype=np.float32)
IMAGENET_SD = np.array([0.229, 0.224, 0.225], dtype=np.float32)
ON_OBJECT = 0.5  # share of a cell that lies on the mask, from which on it is the object's


@dataclass(frozen=True, slots=True)
class SquareCrop:
    """`side_px` pixels along either side, of `scale` pixels of the image each."""

    uv_first: FloatArray  # (2,) pixel of the image at the middle of the crop's first pixel
    scale: float
    side_px: int

    @staticmethod
    def around(mask: BoolArray, side_px: int, margin: float) -> SquareCrop:
        """The square about a mask's bounding box, `margin` times as wide as its longer side.

        Raises:
            ValueError: the mask is empty.
        """
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            raise ValueError("the mask has no pixel: there is nothing to describe")
        low = np.array([columns[0], rows[0]], dtype=float)
        high = np.array([columns[-1], rows[-1]], dtype=float)
        scale = float(margin * (high - low + 1.0).max() / side_px)
        return SquareCrop((low + high) / 2.0 - scale * (side_px - 1) / 2.0, scale, side_px)

    def cut(self, image: NDArray, outside: int = cv2.BORDER_REPLICATE) -> NDArray:
        """The square of an image (H, W) or (H, W, C), of its type."""
        u, v = self.uv_first
        M = np.array([[self.scale, 0.0, u], [0.0, self.scale, v]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (self.side_px, self.side_px)
        return np.asarray(cv2.warpAffine(image, M, size, flags=flags, borderMode=outside))

    def feature_map(
        self, features: NDArray[np.float32], mask: BoolArray, made_by: str
    ) -> FeatureMap:
        """Of features (h, w, C) whose cells share the square evenly."""
        h, w, _ = features.shape
        inside = self.cut(mask.astype(np.float32), cv2.BORDER_CONSTANT)
        share = cv2.resize(inside, (w, h), interpolation=cv2.INTER_AREA)
        on_object = share >= min(ON_OBJECT, float(share.max()))
        descriptor = features[on_object].mean(axis=0)
        cell_px = self.side_px / w
        return FeatureMap(
            features=features - descriptor,
            descriptor=descriptor,
            uv_first=self.uv_first + self.scale * (cell_px - 1.0) / 2.0,
            step_px=self.scale * cell_px,
            made_by=made_by,
        )


def normalised(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(1, 3, H, W) of a picture (H, W, 3), as networks of ImageNet take it."""
    scaled = (rgb.astype(np.float32) / 255.0 - IMAGENET_MEAN) / IMAGENET_SD
    return np.ascontiguousarray(scaled.transpose(2, 0, 1)[None])


def require_same_size(rgb: NDArray[np.uint8], mask: BoolArray) -> None:
    """Refuse a mask of another size.

    Raises:
        ValueError: so.
    """
    if rgb.shape != (*mask.shape, 3) or rgb.dtype != np.uint8:
        raise ValueError(
            f"rgb {rgb.shape} {rgb.dtype}, mask {mask.shape}; expected one size, uint8"
        )
