"""Files that somebody or something has changed, for fuzzing readers with hypothesis."""

from __future__ import annotations

import re

from hypothesis import strategies as st

NUMBER = re.compile(rb"-?\d+\.?\d*(?:e-?\d+)?")
INSTEAD = b'1e999 1e300 -1 0 nan 99999999999 "" null [] {} true a'.split()
CHANGES = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4)
"""Which bytes are overwritten, and by what."""
SWAPS = st.lists(st.tuples(st.integers(0, 10**4), st.sampled_from(INSTEAD)), max_size=2)
"""Which numbers are replaced, and by what."""
CUT = st.one_of(st.just(0), st.integers(0, 10**6))
"""How many bytes are missing at the end, of those that there are."""


def spoiled(
    data: bytes, changes: list[tuple[int, int]], swaps: list[tuple[int, bytes]], cut: int
) -> bytes:
    """The file after what was drawn from the strategies above."""
    found = bytearray(data)
    for where, value in changes:
        found[where % len(found)] = value
    for which, word in swaps:
        numbers = list(NUMBER.finditer(found))
        if numbers:
            number = numbers[which % len(numbers)]
            found[number.start() : number.end()] = word
    return bytes(found[: len(found) - cut % (len(found) + 1)])
