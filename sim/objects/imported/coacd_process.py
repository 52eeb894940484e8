"""CoACD in a process of its own: `sim.objects.imported.decomposition` starts it.

Reads pickled (points, faces, settings) from standard input until it ends, and answers each on
standard output with (problem or None, vertices of each piece). It imports nothing of ours, so that
it is there at once.
"""

from __future__ import annotations

import os
import pickle
import sys
from typing import BinaryIO


def _serve(jobs: BinaryIO, answers: BinaryIO) -> None:
    import coacd

    coacd.set_log_level("error")
    while True:
        try:
            points, faces, settings = pickle.load(jobs)
        except EOFError:
            return
        answer: tuple[str | None, list[object]]
        try:
            pieces = coacd.run_coacd(coacd.Mesh(points, faces), **settings)
            answer = None, [vertices for vertices, _ in pieces]
        except Exception as error:  # whatever it is, the parent says so
            answer = f"{type(error).__name__}: {error}", []
        pickle.dump(answer, answers)
        answers.flush()


def _main() -> None:
    """Keeps the answers to itself: what CoACD prints on standard output goes nowhere."""
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    _serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    _main()
