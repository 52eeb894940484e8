"""PNG files: the header is checked before anything is decoded, the rest before anything is used.

Pillow decodes, and checks the chunks' checksums, but it reads past a missing end, and it hands on
a channel of 16 bits in a colour image as 8. So the first chunk is read here (PNG specification,
third edition, section 11.2.2): a file that claims other pixels than it should, or too many, is
refused before memory is taken for them. OpenCV encodes: faster than Pillow, at the same size.
"""

from __future__ import annotations

import io
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from akm_fg.errors import InputError, OutputError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
END = b"\0\0\0\0IEND\xaeB`\x82"  # the last chunk, always these bytes
GRAY = 0  # colour type of the header: one channel, no alpha
COMPRESSION_LEVEL = 3  # zlib level: three times as fast as 9, files a tenth larger
# Thirty times a depth camera's image, and below what Pillow itself warns about.
MAX_PIXELS = 2**26
BYTES_A_PIXEL = 8  # four channels of 16 bits, stored as they are
FILE_OVERHEAD = 2**22  # of chunks that hold no pixels, such as a colour profile


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What the first chunk of a PNG says."""

    width: int
    height: int
    bit_depth: int
    colour_type: int


def read_header(data: bytes, place: Path) -> PngHeader:
    """The first chunk of a PNG.

    Raises:
        InputError: it is none.
    """
    if data[:8] != SIGNATURE:
        problem = "is empty" if not data else "is not a PNG"
        raise InputError(place, problem, "a PNG image")
    try:
        length, kind, *says = struct.unpack_from(">I4sIIBB", data, len(SIGNATURE))
    except struct.error as e:
        raise InputError(place, f"is truncated after {len(data)} bytes", "a whole PNG image") from e
    if (length, kind) != (13, b"IHDR"):
        raise InputError(place, "has no PNG header", "a PNG image")
    return PngHeader(*says)


def _load(path: Path, width: int, height: int) -> tuple[bytes, PngHeader]:
    """The file as it is, and a header that claims the pixels it should."""
    largest = FILE_OVERHEAD + BYTES_A_PIXEL * min(width * height, MAX_PIXELS)
    try:
        if path.exists() and not path.is_file():
            raise InputError(path, "is not a regular file", "a PNG image")
        if path.stat().st_size > largest:
            problem = f"holds {path.stat().st_size / 1e6:.0f} MB"
            raise InputError(path, problem, f"{largest / 1e6:.0f} MB at most of {width}x{height}")
        data = path.read_bytes()
    except FileNotFoundError as e:
        raise InputError(path, "is missing", "one image a frame, numbered from 000000") from e
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", "a readable PNG image") from e
    header = read_header(data, path)
    if (header.width, header.height) != (width, height):
        raise InputError(
            path, f"is {header.width}x{header.height}", f"the camera's {width}x{height} pixels"
        )
    if width * height > MAX_PIXELS:
        raise InputError(path, f"claims {width}x{height} pixels", f"{MAX_PIXELS} at most")
    return data, header


def _check_chunks(data: bytes, path: Path) -> None:
    """Refuse truncated files and wrong checksums; nothing is decoded."""
    stream, problem = io.BytesIO(data), None
    try:
        Image.open(stream, formats=("PNG",)).verify()
    except (OSError, SyntaxError, ValueError, IndexError) as e:
        problem = e
    if END not in data or (problem is not None and stream.tell() == len(data)):
        truncated = f"is truncated after {len(data)} bytes"
        raise InputError(path, truncated, "a whole PNG image") from problem
    if problem is not None:
        near = f"is damaged near byte {stream.tell()}"
        raise InputError(path, near, "a PNG with right checksums") from problem


def decode(data: bytes, path: Path) -> Image.Image:
    """Its pixels, after every chunk was checked; the header is to be judged before.

    Raises:
        InputError: truncated or damaged.
    """
    _check_chunks(data, path)
    image = Image.open(io.BytesIO(data), formats=("PNG",))
    try:
        image.load()
    except (OSError, SyntaxError, ValueError) as e:
        problem = f"holds damaged image data ({e})"
        if "truncated" in str(e):
            problem = "holds image data that stop early"
        raise InputError(path, problem, "a whole PNG image") from e
    return image


def read_rgb(path: Path, width: int, height: int) -> NDArray[np.uint8]:
    """Read an 8 bit image as RGB (height, width, 3).

    Raises:
        InputError: missing, damaged, of another size, or not 8 bit.
    """
    data, header = _load(path, width, height)
    if header.bit_depth != 8:
        raise InputError(path, f"has {header.bit_depth} bits a channel", "an 8 bit colour image")
    return np.array(decode(data, path).convert("RGB"), dtype=np.uint8)


def read_depth_raw(path: Path, width: int, height: int) -> NDArray[np.uint16]:
    """Read a 16 bit depth image in its own units (height, width); 0 is unknown.

    Raises:
        InputError: missing, damaged, of another size, or not one channel of 16 bits.
    """
    data, header = _load(path, width, height)
    if header.bit_depth != 16 or header.colour_type != GRAY:
        channels = "one channel" if header.colour_type == GRAY else "several channels"
        raise InputError(
            path, f"has {channels} of {header.bit_depth} bits", "depth as one channel of 16 bits"
        )
    return np.array(decode(data, path), dtype=np.uint16)


def read_mask(path: Path, width: int, height: int) -> NDArray[np.bool_]:
    """Read a mask of 0 and 255 as booleans (height, width).

    Raises:
        InputError: missing, damaged, of another size, or with other values.
    """
    data, header = _load(path, width, height)
    if header.bit_depth not in (1, 8) or header.colour_type != GRAY:
        raise InputError(path, "is not an 8 bit gray image", "a mask of 0 and 255 in one channel")
    mask = np.asarray(decode(data, path).convert("L"))
    other = mask[(mask != 0) & (mask != 255)]
    if other.size:
        raise InputError(path, f"holds the value {other[0]}", "a mask of 0 and 255")
    return mask == 255


def write_png(path: Path, image: NDArray[Any]) -> None:
    """Write an RGB or one-channel image whole or not at all (rename of a finished file).

    Raises:
        OutputError: the place cannot be written.
    """
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    done, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION_LEVEL])
    if not done:
        raise OutputError(f"{path}: the image could not be encoded as PNG")
    replace_file(path, data.tobytes())


def replace_file(path: Path, data: bytes) -> None:
    """Replace a file's content in one step: a reader sees the old or the new, never a part.

    What stands where the part is made is removed, and a link there is not followed.

    Raises:
        OutputError: the place cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.unlink(missing_ok=True)
        try:
            with part.open("xb") as file:
                file.write(data)
            os.replace(part, path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as e:
        raise OutputError(f"{path}: cannot be written ({e.strerror})") from e
