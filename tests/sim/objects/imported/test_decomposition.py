"""Decomposition in child processes: what is worked on and kept, what an interruption leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gtsam
import numpy as np
import pytest
import trimesh

from sim.objects.imported import coacd_process, decomposition
from sim.objects.imported.collision_pieces import link_pieces
from sim.objects.imported.decomposition import (
    COARSE,
    FINE,
    DecompositionFailed,
    Shape,
    decomposed,
)
from sim.objects.imported.surfaces import Surface
from sim.objects.suites.handles import R_LYING


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    base = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    return base / "akm-fg"


def frame(width: float) -> trimesh.Trimesh:
    """A board with a hole."""
    hole = trimesh.creation.box([0.7 * width, 1.0, 0.7])
    return trimesh.boolean.difference([trimesh.creation.box([width, 0.02, 1.0]), hole])


def shape(mesh: trimesh.Trimesh) -> Shape:
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)


def surface(mesh: trimesh.Trimesh, x: float, y: float, z: float) -> Surface:
    return Surface("frame", mesh.vertices + np.array([x, y, z]), mesh.faces, (0.5, 0.5, 0.5))


def test_several_shapes_at_once_have_the_pieces_of_each_alone(own_cache: Path):
    shapes = [shape(frame(width)) for width in (1.0, 0.6, 1.0)]
    told: list[int] = []
    together = decomposed(shapes, COARSE, told.append)
    assert sorted(told) == [0, 1, 2]
    assert len(list(own_cache.glob("convex-*"))) == 2  # the first and the last are the same
    for entry in own_cache.glob("convex-*"):
        for file in entry.iterdir():
            file.unlink()
        entry.rmdir()
    for found, one in zip(together, shapes, strict=True):
        (alone,) = decomposed([one], COARSE)
        assert len(found) == len(alone) > 0
        for a, b in zip(found, alone, strict=True):
            np.testing.assert_array_equal(a, b)


def test_of_a_cabinet_of_many_meshes_only_what_the_arm_comes_near_is_decomposed(own_cache: Path):
    grip = gtsam.Pose3(gtsam.Rot3(R_LYING), np.array([0.0, -0.3, 0.5]))
    opened = gtsam.Pose3(gtsam.Rot3(R_LYING), np.array([0.0, -0.7, 0.5]))
    within = [surface(frame(0.3 + 0.01 * i), 0.0, 0.2 + 0.05 * i, 0.5) for i in range(40)]
    pieces = link_pieces("corpus", within, [grip, opened])
    assert len(pieces) == len(within)  # each is its hull
    assert not list(own_cache.glob("convex-*"))
    before = surface(frame(0.5), 0.0, -0.4, 0.5)  # the hand goes through its hole
    assert len(link_pieces("corpus", [*within, before], [grip, opened])) >= len(within) + 4
    beside = surface(frame(0.6), 0.4, -1.1, 0.5)  # there the forearm is when it is open
    begun = set(own_cache.glob("convex-*"))
    link_pieces("corpus", [beside], [grip])
    assert set(own_cache.glob("convex-*")) == begun
    link_pieces("corpus", [beside], [grip, opened])
    assert len(set(own_cache.glob("convex-*")) - begun) == 1


def test_a_decomposition_that_dies_is_one_line_and_leaves_nothing(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    broken = tmp_path / "dies.py"
    broken.write_text("import os; os.abort()")
    monkeypatch.setattr(coacd_process, "__file__", str(broken))
    with pytest.raises(DecompositionFailed, match=r"ended with code -6") as caught:
        decomposed([shape(frame(1.0)), shape(frame(0.5))], FINE)
    assert "\n" not in str(caught.value)
    assert not list(own_cache.iterdir())


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_decomposition_ends_its_processes_and_leaves_nothing(
    own_cache: Path, tmp_path: Path, how: signal.Signals
):
    code = (
        "import numpy as np, signal, trimesh\n"
        "from sim.objects.imported.decomposition import FINE, decomposed\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "mesh = trimesh.creation.torus(0.3, 0.05, 100, 100)\n"  # takes ten seconds and more
        "shape = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)\n"
        "print('go', flush=True)\n"
        "decomposed([shape, (shape[0] * [1, 1, 2], shape[1])], FINE)\n"
    )
    root = Path(decomposition.__file__).parents[3]
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=root
    )
    assert run.stdout is not None and run.stdout.readline() == b"go\n"
    children = wait_for(lambda: children_of(run.pid))
    run.send_signal(how)
    run.communicate(timeout=20.0)
    assert run.returncode != 0
    wait_for(lambda: not any(alive(pid) for pid in children))
    assert not list(own_cache.glob(".making-*")) and not list(own_cache.glob("convex-*"))


def children_of(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(found, seconds: float = 20.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if got := found():
            return got
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s, process {os.getpid()}")
