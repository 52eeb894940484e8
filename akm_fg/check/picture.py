"""What a look at a recording found, drawn over its pictures."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.check.records import RecordingCheck
from akm_fg.records import BoolArray, Recording, RgbdFrame

Image = NDArray[np.uint8]  # (H, W, 3) RGB
Colour = tuple[int, int, int]

OBJECT: Colour = (60, 220, 90)
FLOOR: Colour = (70, 130, 255)
CHANGED: Colour = (255, 70, 50)
EDGE: Colour = (255, 230, 40)
TINT = 0.35
TILE_PX = 640  # width of each picture
STEP_M, STEP_SHARE = 0.03, 0.02  # of depth, that is drawn as an edge; the second of the distance
AROUND = np.ones((7, 7))  # pixels: edges are without depth, for as long as that
QUALITY = 90


def overview(recording: Recording, found: RecordingCheck) -> bytes:
    """A JPEG: first and last frame, and the depth's edges over the colours of the first.

    Green: the outline of what is taken for the object. Blue: floor. Red: what changes, by depth.
    Yellow: edges of depth, which lie on those of the colours where the two are aligned.
    """
    frames = recording.frames
    first = _tinted(frames[0].rgb, found.floor_mask, FLOOR)
    first = _tinted(first, found.changes.changed, CHANGED)
    first = _outlined(first, found.object_mask)
    edges = _tinted(frames[0].rgb, _depth_edges(frames[0]), EDGE, 1.0)
    tiles = (
        (first, "first frame: object green, floor blue, what changes red"),
        (edges, "edges of depth over the colours"),
        (frames[-1].rgb, f"last frame ({len(frames) - 1})"),
    )
    whole = np.concatenate([_tile(image, words) for image, words in tiles], axis=1)
    settings = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    done, data = cv2.imencode(".jpg", cv2.cvtColor(whole, cv2.COLOR_RGB2BGR), settings)
    assert done, "an 8 bit image can always be encoded"
    return data.tobytes()


def _tinted(rgb: Image, mask: BoolArray | None, colour: Colour, share: float = TINT) -> Image:
    if mask is None:
        return rgb
    mixed = (1.0 - share) * rgb + share * np.array(colour)
    return np.where(mask[..., None], mixed, rgb).astype(np.uint8)


def _outlined(rgb: Image, mask: BoolArray | None) -> Image:
    if mask is None:
        return rgb
    drawn = rgb.copy()
    outlines, _ = cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    cv2.drawContours(drawn, outlines, -1, OBJECT, max(1, rgb.shape[1] // 320))
    return drawn


def _depth_edges(frame: RgbdFrame) -> BoolArray:
    """(H, W) the nearer side of each step."""
    z = np.nan_to_num(frame.depth_m, nan=np.inf)
    farther = cv2.dilate(np.where(np.isfinite(z), z, 0.0).astype(np.float32), AROUND)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(z) & (farther - z > STEP_M + STEP_SHARE * z))


def _tile(rgb: Image, words: str) -> Image:
    height = round(TILE_PX * rgb.shape[0] / rgb.shape[1])
    tile = np.array(cv2.resize(rgb, (TILE_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    (_, tall), below = cv2.getTextSize(words, font, size, 1)
    bar = tall + below + 10
    tile[:bar] = tile[:bar] // 5 + 204
    cv2.putText(tile, words, (8, tall + 5), font, size, (20, 20, 20), 1, cv2.LINE_AA)
    return tile
