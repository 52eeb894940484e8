"""What stands out from floor and walls in depth: no weights."""

from __future__ import annotations

from akm_fg.backends.registry import BackendSettings
from akm_fg.interfaces import ObjectSegmenter
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter


def make(settings: BackendSettings) -> ObjectSegmenter:
    """The segmenter, tuned by `perception.observe.mask`."""
    observe = settings.perception.observe
    return DepthObjectSegmenter(observe.mask, observe.noise)
