"""Single pictures of other formats, from bytes: judged by header before memory is taken."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from akm_fg.errors import InputError
from akm_fg.io.png import (
    BYTES_A_PIXEL,
    FILE_OVERHEAD,
    GRAY,
    MAX_PIXELS,
    decode,
    read_header,
    read_rgb,
)

JPEG = b"\xff\xd8\xff"
PNG = b"\x89PNG"
LARGEST_FILE = FILE_OVERHEAD + BYTES_A_PIXEL * MAX_PIXELS


def file_bytes(path: Path, what: str, largest: int = LARGEST_FILE) -> bytes:
    """The content of a regular file that is not larger than it can be.

    Raises:
        InputError: missing, no regular file, too large, or unreadable.
    """
    try:
        if not path.exists():
            raise InputError(path, "is missing", what)
        if not path.is_file():
            raise InputError(path, "is not a regular file", what)
        if path.stat().st_size > largest:
            problem = f"holds {path.stat().st_size / 1e6:.0f} MB"
            raise InputError(path, problem, f"{largest / 1e6:.0f} MB at most, {what}")
        return path.read_bytes()
    except (OSError, ValueError) as e:
        why = getattr(e, "strerror", None) or str(e)
        raise InputError(path, f"cannot be read ({why})", what) from e


def file_text(path: Path, what: str, largest: int = 2**26) -> str:
    """The content of a text file.

    Raises:
        InputError: as `file_bytes`, or not text.
    """
    try:
        return file_bytes(path, what, largest).decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(path, f"is not text (byte {e.start})", what) from e


def colour_of(data: bytes, place: Path) -> NDArray[np.uint8]:
    """RGB (H, W, 3) of a JPEG or an 8 bit PNG.

    Raises:
        InputError: neither, damaged, or too large.
    """
    what = "a JPEG or an 8 bit PNG image"
    if data[:4] == PNG:
        header = read_header(data, place)
        _check_size(place, header.width, header.height)
        if header.bit_depth > 8:
            raise InputError(place, f"has {header.bit_depth} bits a channel", what)
        return np.array(decode(data, place).convert("RGB"), dtype=np.uint8)
    if data[:3] != JPEG:
        raise InputError(place, "is empty" if not data else "is neither JPEG nor PNG", what)
    try:
        image = Image.open(io.BytesIO(data), formats=("JPEG",))
        _check_size(place, *image.size)
        return np.array(image.convert("RGB"), dtype=np.uint8)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as e:
        raise InputError(place, f"is a damaged JPEG ({str(e)[:60]})", what) from e


def read_colour(path: Path, width: int, height: int) -> NDArray[np.uint8]:
    """RGB (height, width, 3) of a file of a recording, a PNG or by its name a JPEG.

    Raises:
        InputError: missing, damaged, of another size, or not 8 bit.
    """
    if path.suffix.lower() == ".png":
        return read_rgb(path, width, height)
    data = file_bytes(path, "one image a frame, numbered from 000000")
    size = size_of(data, path)
    if size != (width, height):
        problem = f"is {size[0]}x{size[1]}"
        raise InputError(path, problem, f"the camera's {width}x{height} pixels")
    return colour_of(data, path)


def depth_of(data: bytes, place: Path) -> NDArray[np.uint16]:
    """Depth (H, W) in whole units of a PNG with one channel of 16 bits.

    Raises:
        InputError: another picture, damaged, or too large.
    """
    what = "depth as a PNG of one channel of 16 bits"
    header = read_header(data, place)
    _check_size(place, header.width, header.height)
    if header.bit_depth != 16 or header.colour_type != GRAY:
        channels = "one channel" if header.colour_type == GRAY else "several channels"
        problem = f"has {channels} of {header.bit_depth} bits, likely depth painted for the eye"
        raise InputError(place, problem, what)
    return np.array(decode(data, place), dtype=np.uint16)


def size_of(data: bytes, place: Path) -> tuple[int, int]:
    """(width, height) of a JPEG or PNG, by its header.

    Raises:
        InputError: it is neither.
    """
    if data[:3] == JPEG:
        try:
            return Image.open(io.BytesIO(data), formats=("JPEG",)).size
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as e:
            raise InputError(place, "is a damaged JPEG", "a whole JPEG image") from e
    if data[:4] != PNG:
        problem = "is empty" if not data else "is neither JPEG nor PNG"
        raise InputError(place, problem, "a JPEG or PNG image")
    header = read_header(data, place)
    return header.width, header.height


def _check_size(place: Path, width: int, height: int) -> None:
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(place, f"claims {width}x{height} pixels", f"1 to {MAX_PIXELS}")
