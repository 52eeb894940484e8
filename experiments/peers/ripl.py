"""Client of `ripl-articulation` as released on PyPI.

Buchanan et al., "Online estimation of articulated objects with factor graphs using vision and
proprioceptive sensing", ICRA 2024.

The peer takes poses and gives one twist of any pitch. The poses of the part are one free rigid
motion per frame (Procrustes, robust), in a frame at the points' centroid. As in the peer's own
test, it starts from the twist to the frame that moved farthest. It does not name a kind; here a
joint is prismatic when its axis passes farther from the part than any hinge would.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import MissingDependency
from akm_fg.geometry.rigid_motion import free_rigid_motion
from akm_fg.records import PointTracks
from experiments.baselines.estimate import JointEstimate, joint_estimate
from factors.joint import JointKind

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".venv-peer" / "bin" / "python"
RUNNER = Path(__file__).with_name("ripl_runner.py")


@dataclass(frozen=True, slots=True)
class RiplConfig:
    """What the peer leaves open."""

    hinge_range_m: float = 2.0  # an axis farther than this from the part is a translation
    python: Path = PYTHON  # interpreter of the peer's environment
    timeout_s: float = 600.0  # for all openings together


@dataclass(frozen=True, slots=True)
class PartMotion:
    """Poses of the moving part, the peer's input."""

    T_world_part: Array  # (K, 4, 4); the part frame is the world's, moved to the centroid
    frames: NDArray[np.int64]  # (K,) the frames they belong to, of T
    total_frames: int  # T


def part_motion(tracks: PointTracks, rng: np.random.Generator) -> PartMotion:
    """Procrustes poses of the frames in which enough points were seen.

    Args:
        tracks: of the moving part.
        rng: draws the minimal sets of the robust fit.

    Raises:
        ValueError: fewer than two such frames, or the first is not among them.
    """
    motion = free_rigid_motion(tracks, rng)
    frames = np.flatnonzero(motion.known)
    if frames.size < 2 or frames[0] != 0:
        raise ValueError("the part's pose is needed in the first frame and another")
    moved = np.tile(np.eye(4), (frames.size, 1, 1))
    moved[:, :3, :3], moved[:, :3, 3] = motion.R_world[frames], motion.t_world[frames]
    T_world_part0 = np.eye(4)
    T_world_part0[:3, 3] = np.nanmean(tracks.p_world[0], axis=0)
    return PartMotion(moved @ np.linalg.inv(moved[0]) @ T_world_part0, frames, len(tracks.p_world))


def estimate_openings(
    openings: Sequence[PointTracks], seed: int, config: RiplConfig | None = None
) -> list[JointEstimate | None]:
    """The peer's joint for each opening, in one process of its own environment.

    Args:
        openings: tracks of the moving part, each an opening.
        seed: of the robust poses.
        config: interpreter and rule of the kind.

    Returns:
        One estimate each; None where the peer failed. The losses are empty: it reports none.

    Raises:
        MissingDependency: the peer's environment is not there.
        RuntimeError: the peer's process failed as a whole.
        ValueError: see `part_motion`.
    """
    config = config or RiplConfig()
    if not config.python.exists():
        raise MissingDependency(f"{config.python} is not there: `make peer` installs the peer")
    motions = [part_motion(tracks, np.random.default_rng(seed)) for tracks in openings]
    results = _run(_inputs(motions), config)
    return [_estimate(i, motion, results, config) for i, motion in enumerate(motions)]


def farthest_twist(T_world_part: Array) -> Array:
    """(6,) the twist from the first pose (K, 4, 4) to the one whose origin moved most."""
    far = np.argmax(np.linalg.norm(T_world_part[:, :3, 3] - T_world_part[0, :3, 3], axis=1))
    relative = np.linalg.inv(T_world_part[0]) @ T_world_part[far]
    return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(relative)))


def _inputs(motions: Sequence[PartMotion]) -> dict[str, Array]:
    inputs: dict[str, Array] = {"count": np.array(len(motions))}
    for i, motion in enumerate(motions):
        inputs[f"T_world_part_{i}"] = motion.T_world_part
        inputs[f"prior_{i}"] = farthest_twist(motion.T_world_part)
    return inputs


def _run(inputs: Mapping[str, Array], config: RiplConfig) -> dict[str, Array]:
    """Hand the inputs to the runner and read its results."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "input.npz", Path(folder) / "output.npz"
        np.savez(source, allow_pickle=False, **dict(inputs))
        command = [str(config.python), str(RUNNER), str(source), str(target)]
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=config.timeout_s
        )
        if done.returncode != 0:
            raise RuntimeError(f"the peer ended with {done.returncode}: {done.stderr[-2000:]}")
        with np.load(target, allow_pickle=False) as data:
            return dict(data)


def _estimate(
    i: int, motion: PartMotion, results: Mapping[str, Array], config: RiplConfig
) -> JointEstimate | None:
    """The i-th result in the project's conventions; None where the peer failed."""
    if f"twist_{i}" not in results:
        return None
    return estimate_of_twist(
        results[f"twist_{i}"], results[f"theta_{i}"], motion, float(results[f"seconds_{i}"]), config
    )


def estimate_of_twist(
    twist: Array, theta: Array, motion: PartMotion, seconds: float, config: RiplConfig
) -> JointEstimate:
    """A joint from the peer's twist in the part's first frame (whose axes are the world's).

    Args:
        twist: (6,), rotation first.
        theta: (K,) multiples of it.
        motion: the poses that it explains.
        seconds: what it took.
        config: rule of the kind.
    """
    w, v = twist[:3], twist[3:]
    turning = float(w @ w)
    offset = np.cross(w, v) / turning if turning > 0 else np.full(3, np.inf)
    near = np.linalg.norm(offset) <= config.hinge_range_m
    kind = JointKind.REVOLUTE if near else JointKind.PRISMATIC
    axis = w if kind.turns else v
    states = np.full(motion.total_frames, np.nan)
    states[motion.frames] = theta * np.linalg.norm(axis)
    centroid = motion.T_world_part[0, :3, 3]
    return joint_estimate(
        kind=kind,
        axis=axis,
        point_on_axis=centroid + offset if kind.turns else centroid,
        states=states,
        part_centroid=centroid,
        losses={},
        time_s={"total": seconds},
    )
