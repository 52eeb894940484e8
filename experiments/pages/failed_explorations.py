r"""Pictures of explorations that opened nothing, or did not know what they had opened.

    python -m experiments.pages.failed_explorations --models runs/closed-loop/furniture-116/models \
        --objects furniture-116/drawer-022 furniture-116/slide-001 --out failed.jpg

Of each object, as `experiments.closed_loop` kept it: the frame before its first touch with the
belief before the first attempt and that attempt's arrow, cut to where the contacts are; and the
outcomes in order, on standard output, as a table. Nothing is run again.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from akm_fg.errors import InputError
from akm_fg.exploration.explore_json import exploration_from_dict
from akm_fg.exploration.pages.belief_picture import Image, belief_picture
from akm_fg.exploration.records import Exploration
from akm_fg.io.recording import read_recording
from experiments.pages.tables import markdown

TILE_PX = (400, 300)
COLUMNS = 3
MARGIN_PX = 90.0  # around the contacts, of the drawn picture
QUALITY = 85  # of the JPEG
TEXT_PX = 20


def kept_exploration(models: Path, name: str) -> Exploration:
    """What was kept of an object's exploration, with the frame before its first touch.

    Raises:
        InputError: nothing was kept of it, or nothing was touched.
    """
    found = sorted(models.glob(f"{name.replace('/', '-')}/*/*/explore.json"))
    if not found:
        raise InputError(
            str(models), f"nothing was kept of {name}", "a folder of closed_loop's models"
        )
    told = json.loads(found[-1].read_text(encoding="utf-8"))
    exploration = exploration_from_dict(told, str(found[-1]))
    recordings = [a.recording for a in exploration.attempts if a.recording]
    if not recordings or not exploration.beliefs:
        raise InputError(
            str(found[-1]), "no attempt left a recording", "an object that was touched"
        )
    exploration.first_look = read_recording(found[-1].parent / Path(recordings[0]).name).frames[0]
    return exploration


def tile(exploration: Exploration, name: str) -> Image:
    """The belief before the first attempt, cut to the contacts, with the object's name."""
    picture = belief_picture(exploration, 0)
    assert exploration.first_look is not None
    scale = picture.shape[1] / exploration.first_look.camera.width
    uv = scale * np.array([contact.uv for contact in exploration.contacts])
    centre = (uv.min(axis=0) + uv.max(axis=0)) / 2
    half = float(np.max(np.ptp(uv, axis=0) / np.array(TILE_PX))) / 2
    reach = half * np.array(TILE_PX) + MARGIN_PX
    most = np.array(picture.shape[1::-1])
    (u0, v0), (u1, v1) = (
        np.clip(centre + side * reach, 0, most).astype(int).tolist() for side in (-1, 1)
    )
    cut = picture[v0:v1, u0:u1]
    shrunk = min(TILE_PX[0] / cut.shape[1], (TILE_PX[1] - TEXT_PX) / cut.shape[0])
    small = cv2.resize(cut, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA)
    canvas: Image = np.full((TILE_PX[1], TILE_PX[0], 3), 255, dtype=np.uint8)
    canvas[TEXT_PX : TEXT_PX + small.shape[0], : small.shape[1]] = small
    corner = (2, TEXT_PX - 5)
    cv2.putText(canvas, name, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
    return canvas


def sheet(tiles: Sequence[Image]) -> Image:
    """All tiles, row by row."""
    blank = np.full_like(tiles[0], 255)
    rows = [
        np.hstack([*some, *[blank] * (COLUMNS - len(some))])
        for some in (tiles[k : k + COLUMNS] for k in range(0, len(tiles), COLUMNS))
    ]
    return np.vstack(rows)


def outcomes(exploration: Exploration) -> str:
    """How often each thing happened, in words."""
    counted = Counter(f"{a.outcome.replace('_', ' ')}: {a.reason}" for a in exploration.attempts)
    return "; ".join(f"{n} x {words}" if n > 1 else words for words, n in counted.most_common())


def main() -> None:
    """Write the picture and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of closed_loop's models")
    parser.add_argument("--objects", nargs="+", required=True, help="SUITE/NAME")
    parser.add_argument("--out", type=Path, required=True, help="JPEG to write")
    arguments = parser.parse_args()
    tiles, lines = [], []
    for name in arguments.objects:
        exploration = kept_exploration(arguments.models, name)
        tiles.append(tile(exploration, name))
        lines.append([name, str(exploration.pulls), outcomes(exploration)])
    flags = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(sheet(tiles)[..., ::-1]), flags)
    arguments.out.write_bytes(jpeg.tobytes())
    print(markdown(["object", "pulls", "attempts"], lines))


if __name__ == "__main__":
    main()
