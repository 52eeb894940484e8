"""PNG files, checked before they are decoded.

OpenCV decodes a truncated PNG in part and only warns on stderr, so a file is walked chunk by
chunk first (lengths, checksums, end marker, compressed stream: PNG specification, third
edition, sections 5 and 10).
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError, OutputError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY = 0  # colour type of the header: one channel, no alpha
COMPRESSION_LEVEL = 3  # zlib level: three times as fast as 9, files a tenth larger


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What the first chunk of a PNG says."""

    width: int
    height: int
    bit_depth: int
    colour_type: int


def _chunks(data: bytes, place: Path) -> list[tuple[bytes, bytes]]:
    """All (type, content) up to the end marker; refuses truncated and damaged files."""
    if data[:8] != SIGNATURE:
        problem = "is empty" if not data else "is not a PNG"
        raise InputError(place, problem, "a PNG image")
    chunks: list[tuple[bytes, bytes]] = []
    at = len(SIGNATURE)
    while not chunks or chunks[-1][0] != b"IEND":
        if at + 12 > len(data):
            raise InputError(place, f"is truncated after {len(data)} bytes", "a whole PNG image")
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            raise InputError(place, f"is truncated after {len(data)} bytes", "a whole PNG image")
        (checksum,) = struct.unpack_from(">I", data, end)
        if zlib.crc32(data[at + 4 : end]) != checksum:
            raise InputError(place, f"is damaged near byte {at}", "a PNG with right checksums")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : end]))
        at = end + 4
    return chunks


def _check(data: bytes, place: Path) -> PngHeader:
    chunks = _chunks(data, place)
    if chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13:
        raise InputError(place, "has no PNG header", "a PNG image")
    width, height, bit_depth, colour_type = struct.unpack_from(">IIBB", chunks[0][1])
    stream = zlib.decompressobj()
    try:
        stream.decompress(b"".join(content for kind, content in chunks if kind == b"IDAT"))
    except zlib.error as e:
        raise InputError(place, f"holds damaged image data ({e})", "a whole PNG image") from e
    if not stream.eof:
        raise InputError(place, "holds image data that stop early", "a whole PNG image")
    return PngHeader(width, height, bit_depth, colour_type)


def _load(path: Path, width: int, height: int) -> tuple[bytes, PngHeader]:
    try:
        data = path.read_bytes()
    except FileNotFoundError as e:
        raise InputError(path, "is missing", "one image a frame, numbered from 000000") from e
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", "a readable PNG image") from e
    header = _check(data, path)
    if (header.width, header.height) != (width, height):
        raise InputError(
            path, f"is {header.width}x{header.height}", f"the camera's {width}x{height} pixels"
        )
    return data, header


def _decode(data: bytes, flags: int, path: Path) -> NDArray[Any]:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # e.g. more pixels than OpenCV's limit
        image = None
    if image is None:
        raise InputError(path, "cannot be decoded", "a PNG image")
    return np.asarray(image)


def read_rgb(path: Path, width: int, height: int) -> NDArray[np.uint8]:
    """Read an 8 bit image as RGB (height, width, 3).

    Raises:
        InputError: missing, damaged, of another size, or not 8 bit.
    """
    data, header = _load(path, width, height)
    if header.bit_depth != 8:
        raise InputError(path, f"has {header.bit_depth} bits a channel", "an 8 bit colour image")
    bgr = _decode(data, cv2.IMREAD_COLOR, path)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


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
    return np.asarray(_decode(data, cv2.IMREAD_UNCHANGED, path), dtype=np.uint16)


def read_mask(path: Path, width: int, height: int) -> NDArray[np.bool_]:
    """Read a mask of 0 and 255 as booleans (height, width).

    Raises:
        InputError: missing, damaged, of another size, or with other values.
    """
    data, header = _load(path, width, height)
    if header.bit_depth not in (1, 8) or header.colour_type != GRAY:
        raise InputError(path, "is not an 8 bit gray image", "a mask of 0 and 255 in one channel")
    mask = _decode(data, cv2.IMREAD_GRAYSCALE, path)
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

    Raises:
        OutputError: the place cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written ({e.strerror})") from e
