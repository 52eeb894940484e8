"""Convex decomposition with CoACD, kept between runs and run in several processes.

What was found is kept in the user's cache folder under the content of the mesh, at whatever scale
and place. What is not there yet is found by child processes, which end with this one: CoACD holds
global state and cannot be stopped, so threads would not do. Only this process writes into the
cache, and an interruption leaves nothing half done there.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from queue import SimpleQueue

import numpy as np

from akm_fg.errors import AkmError, MissingDependency
from akm_fg.records import FloatArray
from sim.cache import cache_folder, digest, is_kept, kept
from sim.objects.imported import coacd_process
from sim.objects.obj_files import IntArray

Shape = tuple[FloatArray, IntArray]  # points (N, 3) and faces (F, 3)

PIECE_VERTICES = 64  # at most, of one convex piece
SEED = 0  # of its tree search
PIECES = "pieces.npz"  # in the entry of a mesh


@dataclass(frozen=True, slots=True)
class Decomposition:
    """How finely CoACD works; the names are its own."""

    threshold: float  # concavity, of the piece's size
    mcts_iterations: int = 20  # its default of 150 takes five times as long for as good pieces
    mcts_nodes: int = 20
    mcts_max_depth: int = 3
    resolution: int = 500  # samples of a surface
    preprocess_resolution: int = 30  # of the closed surface that is made of an open one


FINE = Decomposition(0.05)  # what is gripped
COARSE = Decomposition(0.4, mcts_nodes=10, mcts_max_depth=2, preprocess_resolution=20)


class DecompositionFailed(AkmError):
    """CoACD ended its process."""


def decomposed(
    shapes: Sequence[Shape], how: Decomposition, done: Callable[[int], None] | None = None
) -> list[list[FloatArray]]:
    """Of each shape the vertices (M, 3) of its convex pieces, in its frame.

    Args:
        shapes: that are not convex.
        how: finely or coarsely.
        done: is told of each shape (its number from 0) when it is ready, in any order.

    Raises:
        MissingDependency: coacd is not installed.
        DecompositionFailed: it gave up.
    """
    units = [_unit(points) for points, _ in shapes]
    names = [_name(u[0], faces, how) for u, (_, faces) in zip(units, shapes, strict=True)]
    same: dict[str, list[int]] = {}
    for i, name in enumerate(names):  # one mesh is often there many times
        same.setdefault(name, []).append(i)
    jobs = {
        name: (units[which[0]][0], shapes[which[0]][1])
        for name, which in same.items()
        if not is_kept(name)
    }
    tell = done or (lambda _: None)
    for i in (i for name in same.keys() - jobs.keys() for i in same[name]):
        tell(i)
    for name, pieces in _run_all(jobs, how):
        _keep(name, pieces)
        for i in same[name]:
            tell(i)
    loaded = {name: _load(name) for name in same}
    return [
        [piece * size + shift for piece in loaded[name]]
        for name, (_, size, shift) in zip(names, units, strict=True)
    ]


class _Child:
    """One process that decomposes; what is asked of it is answered in order."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(coacd_process.__file__)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},  # there is a process for each core
            start_new_session=True,  # Ctrl-C reaches this process alone, which ends the child
        )

    def run(self, shape: Shape, how: Decomposition) -> list[FloatArray]:
        """Vertices (M, 3) of the pieces.

        Raises:
            DecompositionFailed: CoACD gave up, or its process ended.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        points, faces = shape
        more = {"max_ch_vertex": PIECE_VERTICES, "decimate": True, "seed": SEED}
        job = points, faces.astype(np.int32), {**asdict(how), **more}
        with contextlib.suppress(OSError):  # a dead child: the answer says so
            pickle.dump(job, self._process.stdin)
            self._process.stdin.flush()
        try:
            problem, pieces = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError, ValueError):
            problem, pieces = f"its process ended with code {self._process.wait()}", []
        if problem is not None:
            raise DecompositionFailed(f"convex decomposition: CoACD failed ({problem})")
        return [np.asarray(vertices, dtype=float) for vertices in pieces]

    def end(self) -> None:
        """Also in the middle of a piece of work."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()


def _run_all(
    jobs: Mapping[str, Shape], how: Decomposition
) -> Iterator[tuple[str, list[FloatArray]]]:
    """Each job's pieces as they are ready, from as many processes as there are cores."""
    if not jobs:
        return
    _version()  # says what is missing before a process ends for want of it
    count = min(len(jobs), len(os.sched_getaffinity(0)))
    children = [_Child() for _ in range(count)]
    free: SimpleQueue[_Child] = SimpleQueue()
    for child in children:
        free.put(child)

    def run(shape: Shape) -> list[FloatArray]:
        child = free.get()
        try:
            return child.run(shape, how)
        finally:
            free.put(child)

    pool = ThreadPoolExecutor(count)
    try:
        futures = {pool.submit(run, shape): key for key, shape in jobs.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in children:
            child.end()


def _unit(points: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """The points, their size and place taken off: the same at every scale; size and place."""
    size, shift = float(np.ptp(points, axis=0).max()), points.min(axis=0)
    return np.round((points - shift) / size, 6), size, shift


def _name(unit: FloatArray, faces: IntArray, how: Decomposition) -> str:
    """Of the entry in the cache."""
    said = f"{how} {PIECE_VERTICES} {SEED}"
    return f"convex-{digest(_version(), said, unit.tobytes(), faces.tobytes())}"


def _version() -> str:
    try:
        return importlib.metadata.version("coacd")
    except ModuleNotFoundError as error:
        raise MissingDependency(
            "this object's meshes are not convex and need coacd; install akm-fg[sim]"
        ) from error


def _keep(name: str, pieces: Sequence[FloatArray]) -> None:
    kept(name, lambda folder: np.savez(folder / PIECES, *pieces))


def _load(name: str) -> list[FloatArray]:
    with np.load(cache_folder() / name / PIECES, allow_pickle=False) as stored:
        return [stored[f"arr_{i}"] for i in range(len(stored.files))]
