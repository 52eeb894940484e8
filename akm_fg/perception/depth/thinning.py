"""Images of which every stride-th pixel was judged, back at full size."""

from __future__ import annotations

from numpy.typing import NDArray


def repeated(image: NDArray, stride: int, shape: tuple[int, ...]) -> NDArray:
    """Every pixel of (h, w) as a square of `stride` pixels, cut to the first (H, W) of them."""
    return image.repeat(stride, axis=0).repeat(stride, axis=1)[: shape[0], : shape[1]]
