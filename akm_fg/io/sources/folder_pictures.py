"""Colour and depth as picture files of a folder, and the cameras that took them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.io.json_fields import load_json_object
from akm_fg.io.sources.pictures import colour_of, depth_of, file_bytes, size_of
from akm_fg.io.sources.source import Images, Lens, Pair, RawDepth, SourceOptions
from akm_fg.records import PinholeCamera

INTRINSICS = "`akm-fg convert --intrinsics fx,fy,cx,cy` in pixels"
JSON_FILES = 20  # of a folder that are looked into


def images_of(colour: Sequence[Path], depth: Sequence[Path]) -> Images:
    """Decodes the pairs asked for, from these files."""

    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        for i, j in pairs:
            rgb = colour_of(file_bytes(colour[i], "one colour picture a frame"), colour[i])
            yield rgb, depth_of(file_bytes(depth[j], "one depth picture a frame"), depth[j])

    return images


def first_size(files: Sequence[Path]) -> tuple[int, int]:
    """(width, height) of the first picture.

    Raises:
        InputError: it is none.
    """
    return size_of(file_bytes(files[0], "a picture"), files[0])


def lens_of(numbers: Sequence[float], size: tuple[int, int], place: object) -> Lens:
    """A lens of fx, fy, cx, cy and perhaps distortion.

    Raises:
        InputError: numbers that are no camera's.
    """
    expected = "fx, fy, cx, cy in pixels, perhaps k1, k2, p1, p2 and k3 after them"
    if len(numbers) not in (4, 8, 9, 12):
        raise InputError(place, f"gives {len(numbers)} numbers", expected)
    fx, fy, cx, cy = (float(number) for number in numbers[:4])
    distortion = tuple(float(number) for number in numbers[4:])
    try:
        camera = PinholeCamera(*size, fx, fy, cx, cy)
    except ValueError as e:
        raise InputError(place, str(e), expected) from e
    if not np.isfinite(distortion).all():
        raise InputError(place, f"distortion {distortion} must be finite", expected)
    off = not (-size[0] < cx < 2 * size[0] and -size[1] < cy < 2 * size[1])
    if off or not 0.05 < fx / max(size) < 50:
        problem = f"fx {fx:g}, cx {cx:g}, cy {cy:g} are of no picture of {size[0]}x{size[1]}"
        raise InputError(place, problem, "intrinsics of the pictures as they are stored")
    return Lens(camera, distortion)


def said_lens(options: SourceOptions, size: tuple[int, int]) -> Lens | None:
    """What a person says of the colour camera."""
    if options.intrinsics is None:
        return None
    return lens_of(options.intrinsics, size, "--intrinsics")


def described_camera(folder: Path) -> tuple[Path, dict[str, Any]] | None:
    """The JSON file of a folder that holds `intrinsic_matrix`, as Open3D writes it."""
    for path in sorted(folder.glob("*.json"))[:JSON_FILES]:
        values = load_json_object(path, "a camera as Open3D writes it")
        if "intrinsic_matrix" in values:
            return path, values
    return None


def described_lens(path: Path, values: dict[str, Any], size: tuple[int, int]) -> Lens:
    """Of Open3D's `intrinsic_matrix`, nine numbers column by column.

    Raises:
        InputError: other numbers, or of pictures of another size.
    """
    expected = "`intrinsic_matrix` of 9 numbers, column by column, as Open3D writes it"
    try:
        K = np.array(values["intrinsic_matrix"], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as e:
        raise InputError(
            path, "`intrinsic_matrix` holds other things than numbers", expected
        ) from e
    if K.shape == (3, 3):
        K = K.T.reshape(-1)  # row by row, as people write it by hand
    if K.shape != (9,) or not np.isfinite(K).all():
        raise InputError(path, f"`intrinsic_matrix` has shape {K.shape}", expected)
    says = values.get("width", size[0]), values.get("height", size[1])
    if says != size:
        problem = f"is of a camera of {says[0]}x{says[1]}"[:80]
        raise InputError(path, problem, f"{size[0]}x{size[1]}, as its pictures are")
    return lens_of((K[0], K[4], K[6], K[7]), size, path)
