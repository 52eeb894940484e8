"""What was believed before an attempt, drawn on the first look."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.exploration.records import Exploration, Hypothesis
from akm_fg.records import RgbdFrame

Image = NDArray[np.uint8]
_RADIUS_PX = 7.0
_ARROW_M = 0.10  # of a direction of pull
_WIDTH_PX = 960  # smaller pictures are enlarged by whole factors
_SUBPIXEL_BITS = 4
_WHITE, _BLACK = (255, 255, 255), (20, 20, 20)


def belief_picture(exploration: Exploration, number: int) -> Image:
    """(H, W, 3) the first look; each contact a dot, as yellow as a pull there is thought to open.

    Args:
        exploration: with a first look and the belief before attempt `number`.
        number: of the attempt, from 0; its direction of pull is an arrow.
    """
    frame = exploration.first_look
    assert frame is not None
    scale = max(-(-_WIDTH_PX // frame.camera.width), 1)
    large = cv2.resize(frame.rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    # Dimmed towards white, so that dots of every colour stand out from wood and shadow.
    picture: Image = np.asarray(0.55 * large + 0.45 * 255, dtype=np.uint8)
    p = exploration.beliefs[number].by_contact
    colours = belief_colours(p)
    for place in np.argsort(p):
        at = _fixed(exploration.contacts[place].uv, scale)
        radius = round(_RADIUS_PX * scale * 2**_SUBPIXEL_BITS / 2)
        cv2.circle(picture, at, radius, colours[place].tolist(), -1, cv2.LINE_AA, _SUBPIXEL_BITS)
        cv2.circle(picture, at, radius, _BLACK, scale, cv2.LINE_AA, _SUBPIXEL_BITS)
    if number < len(exploration.attempts):
        _arrow(picture, frame, exploration.attempts[number].hypothesis, exploration, scale)
    return picture


def belief_colours(probability: NDArray[np.float64]) -> NDArray[np.int_]:
    """(N, 3) RGB of probabilities, dark to yellow (viridis), told apart by the colour blind too."""
    levels = np.rint(255 * np.clip(probability, 0.0, 1.0)).astype(np.uint8)
    bgr = cv2.applyColorMap(levels.reshape(-1, 1), cv2.COLORMAP_VIRIDIS).reshape(-1, 3)
    return np.asarray(bgr[:, ::-1], dtype=int)


def _arrow(
    picture: Image,
    frame: RgbdFrame,
    hypothesis: Hypothesis,
    exploration: Exploration,
    scale: int,
) -> None:
    start = exploration.contacts[hypothesis.contact].p_world
    ends = np.array([start, start + _ARROW_M * hypothesis.direction_world])
    T = frame.T_world_cam
    p_cam = (ends - T.translation()) @ T.rotation().matrix()
    uv = frame.camera.project(p_cam)
    if not np.isfinite(uv).all():
        return
    (x0, y0), (x1, y1) = (np.rint((uv + 0.5) * scale - 0.5)).astype(int).tolist()
    for colour, width in ((_WHITE, 3 * scale), (_BLACK, scale)):
        cv2.arrowedLine(picture, (x0, y0), (x1, y1), colour, width, cv2.LINE_AA, tipLength=0.25)


def _fixed(uv: NDArray[np.float64], scale: int) -> tuple[int, int]:
    """OpenCV's fixed-point coordinates of a pixel in the enlarged picture."""
    u, v = np.rint(((uv + 0.5) * scale - 0.5) * 2**_SUBPIXEL_BITS).astype(int).tolist()
    return u, v
