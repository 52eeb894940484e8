"""How much a stream of LZFSE inflates to, by the headers of its blocks alone.

Layout from Apple's reference implementation (lzfse_internal.h): each block begins with four bytes
of its kind and, but for the last, four bytes that say how much it inflates to.
"""

from __future__ import annotations

import struct
from pathlib import Path

from akm_fg.errors import InputError

END, RAW, LZVN, LZFSE = b"bvx$", b"bvx-", b"bvxn", b"bvx2"
EXPECTED = "depth compressed by LZFSE"


def inflated_size(data: bytes, place: Path) -> int:
    """Bytes that the stream claims to hold.

    Raises:
        InputError: it is no such stream, or ends early.
    """
    at, total = 0, 0
    try:
        while (kind := data[at : at + 4]) != END:
            (raw,) = struct.unpack_from("<I", data, at + 4)
            total += raw
            at += _block_bytes(kind, data, at, raw)
    except (struct.error, KeyError) as e:
        problem = "is empty" if not data else f"is damaged near byte {at}"
        raise InputError(place, problem, EXPECTED) from e
    return total


def _block_bytes(kind: bytes, data: bytes, at: int, raw: int) -> int:
    """Length of a block with its header.

    Raises:
        KeyError: of another kind.
    """
    if kind == RAW:
        return 8 + raw
    if kind == LZVN:
        (payload,) = struct.unpack_from("<I", data, at + 8)
        return 12 + int(payload)
    if kind == LZFSE:  # bits 20 of the first and 40 of the second field, 20 each, and the third
        first, second, third = struct.unpack_from("<QQQ", data, at + 8)
        literals, matches = first >> 20 & 0xFFFFF, second >> 40 & 0xFFFFF
        return int((third & 0xFFFFFFFF) + literals + matches)
    raise KeyError(kind)
