"""Where the processor's time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def taking(times_s: dict[str, float], stage: str) -> Iterator[None]:
    """Adds the processor time of what is done within to a stage's, also where it ends badly."""
    began = time.process_time()
    try:
        yield
    finally:
        times_s[stage] = times_s.get(stage, 0.0) + time.process_time() - began
