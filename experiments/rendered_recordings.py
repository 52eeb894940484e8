"""Recordings of a suite's objects being opened, as the noisy camera sees them.

    python -m experiments.rendered_recordings --suite furniture-dev --out runs/dev-recordings

One folder an object (docs/conventions.md, "Recording"), with the truth in `recording.json` for
scoring alone. `--pull scripted`, the default, sets the joint to its states and moves the Franka
along without physics: it only generates data and is never used by the program. `--pull hand` is
that with a person's hand, which is seen and not masked, in place of the Franka: what household
suites always get, whose lids and covers no fixed arm could follow so far. `--pull robot` is the
real thing: friction grasp, compliant pull, physics; it takes about half a minute and may fail.
Folders that are there already are not made again. About ten seconds an object; no table: it feeds
the experiments that fit rendered recordings.
"""

from __future__ import annotations

import argparse
import dataclasses
import fnmatch
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from akm_fg.errors import GraspFailed, InputError, MotionInfeasible
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.records import FloatArray
from sim.bullet import p
from sim.camera.camera import CameraConfig
from sim.camera.noise import NOISE_LEVELS
from sim.camera.views import sample_view
from sim.episode import SimEpisode, open_world
from sim.objects.household.household_spec import SMALL_PX, HouseholdSpec
from sim.objects.placement import opened
from sim.objects.suites.catalogue import ALL_SUITES, AnySuite, find_suite
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.robot.riding_hand import RidingHand
from sim.robot.scripted_pull import ScriptedPull

PULL_SPEED_M_S = 0.05  # of the compliant pull
FRAME_S = (0.15, 0.35)  # between frames of a scripted pull
SMALL_DISTANCE_M = (1.4, 3.2)  # from where what is to be small is seen; depth ends soon after


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """What is recorded."""

    pull: Literal["robot", "scripted", "hand"] = "scripted"
    frames: int = 20
    travel_deg: tuple[float, float] = (10.0, 40.0)
    travel_cm: tuple[float, float] = (6.0, 25.0)
    seed: int = 0
    noise: str = "d455"


def travel_and_states(
    spec: FurnitureSpec | HouseholdSpec, config: RecordingConfig, rng: np.random.Generator
) -> FloatArray:
    """States (frames,) from closed, in uneven steps, to a travel drawn for this object."""
    if isinstance(spec, HouseholdSpec):
        travel = rng.uniform(*spec.travels)
    elif spec.kind == "prismatic":
        travel = rng.uniform(*config.travel_cm) / 100.0
    else:
        travel = np.deg2rad(rng.uniform(*config.travel_deg))
    steps = rng.gamma(2.0, 1.0, config.frames - 1)
    return np.concatenate([[0.0], travel * np.cumsum(steps) / steps.sum()])


def record(name: str, config: RecordingConfig, folder: Path) -> int:
    """Writes one object's recording; returns how many frames it has.

    Raises:
        MotionInfeasible: the arm cannot reach or follow.
        GraspFailed: the gripper does not hold, or the part did not come along.
    """
    suite, _, short = name.partition("/")
    spec = find_suite(suite).load(short, config.seed)
    rng = np.random.default_rng([*spec.key, config.seed, 31])
    states, view = travel_and_states(spec, config, rng), sample_view(rng, max(spec.front_m))
    if isinstance(spec, HouseholdSpec) and spec.small:
        view = dataclasses.replace(view, distance_m=_distance_of_small(spec))
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    with open_world(name, config.seed, config.noise, view=view) as world:
        by_hand = config.pull == "hand" or isinstance(spec, HouseholdSpec)
        frames = _by_hand if by_hand else _scripted if config.pull == "scripted" else _pulled
        with RecordingWriter(part) as writer:
            truths = list(frames(world, states, writer, rng))
            if not by_hand:
                writer.set_grasp_frames(0, len(writer) - 1)
            truth = dataclasses.replace(world.truth(), states=np.array(truths))
            writer.set_truth(truth)
    part.rename(folder)
    return len(truths)


def _distance_of_small(spec: HouseholdSpec) -> float:
    """From where the part has about SMALL_PX pixels, seen at 45 deg."""
    width, other = spec.front_m
    area_px = CameraConfig().focal_px ** 2 * width * other * np.cos(np.pi / 4)  # at a metre
    return float(np.clip(np.sqrt(area_px / SMALL_PX), *SMALL_DISTANCE_M))


def _by_hand(
    world: SimEpisode, states: FloatArray, writer: RecordingWriter, rng: np.random.Generator
) -> Iterator[float]:
    """Writes a frame for each state, with a hand on the grip; yields the true states."""
    hand, (sim, T) = RidingHand(world.world), (world.world, world.world.placement.T_world_object)
    stamps = np.cumsum(rng.uniform(*FRAME_S, len(states)))
    for state, stamp_s in zip(states.tolist(), stamps, strict=True):
        p.resetJointState(sim.object_id, sim.part_joint, state, physicsClientId=sim.client)
        hand.show(T * opened(sim.built, state) * T.inverse() * world.T_world_grasp)
        frame = dataclasses.replace(world.camera.capture(), stamp_s=float(stamp_s - stamps[0]))
        writer.add(frame)
        yield sim.part_state()


def _scripted(
    world: SimEpisode, states: FloatArray, writer: RecordingWriter, rng: np.random.Generator
) -> Iterator[float]:
    """Writes a frame for each state; yields the true states."""
    pull = ScriptedPull(world.world, world.T_world_grasp, states.tolist())
    stamps = np.cumsum(rng.uniform(*FRAME_S, len(states)))
    for i, stamp_s in enumerate(stamps):
        pull.show(i)
        frame = dataclasses.replace(world.camera.capture(), stamp_s=float(stamp_s - stamps[0]))
        writer.add(frame, T_world_gripper=pull.T_world_gripper(i))
        yield world.world.part_state()


def _pulled(
    world: SimEpisode, states: FloatArray, writer: RecordingWriter, rng: np.random.Generator
) -> Iterator[float]:
    """The arm grasps and pulls; a frame whenever it has gone a random step on."""
    arm = world.arm
    arm.see(world.camera.capture())
    for _ in arm.grasp(world.T_world_grasp, 0.5):
        pass
    reach = _hand_travel(world) * float(states[-1])
    step_s = reach / PULL_SPEED_M_S / len(states)
    due = 0.0
    for i, _ in enumerate(arm.pull(world.pull_direction_world, reach, step_s / 4.0)):
        if i / 4.0 >= due and len(writer) < len(states):
            due += rng.gamma(2.0, 0.5)
            writer.add(world.camera.capture(), T_world_gripper=arm.T_world_gripper())
            yield world.world.part_state()
    if not arm.holding():
        raise GraspFailed("the handle slipped out of the fingers")
    if world.world.part_state() < 0.5 * float(states[-1]):
        raise GraspFailed(f"the part moved only to {world.world.part_state():.3f}")


def _hand_travel(world: SimEpisode) -> float:
    """Way of the handle for a unit of state: metres a metre, or metres a radian."""
    built = world.world.built
    if built.spec.kind == "prismatic":
        return 1.0
    arm = built.T_object_handle.translation() - built.pivot_object
    return float(np.linalg.norm(np.cross(built.axis_object, arm)))


def chosen(suite: AnySuite, objects: str | None) -> list[str]:
    """Names that a glob matches; or as many as a count says, evenly over the suite."""
    names = list(suite.names())
    if objects is None:
        return names
    if objects.isdigit():
        take = np.linspace(0, len(names) - 1, min(int(objects), len(names)))
        return [names[i] for i in np.unique(take.round().astype(int))]
    found = fnmatch.filter(names, objects)
    if not found:
        raise InputError(
            f"--objects {objects}", f"matches nothing in {suite.name}", "a glob or a count"
        )
    return found


def main(argv: list[str] | None = None) -> int:
    """Make what is missing, say what failed; the exit code is 1 where something did."""
    arguments = _parser().parse_args(argv)
    config = RecordingConfig(
        pull=arguments.pull,
        frames=arguments.frames,
        travel_deg=tuple(arguments.travel_deg),
        travel_cm=tuple(arguments.travel_cm),
        seed=arguments.seed,
        noise=arguments.noise,
    )
    try:
        suite = find_suite(arguments.suite)
        names = chosen(suite, arguments.objects)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    arguments.out.mkdir(parents=True, exist_ok=True)
    failures = []
    for i, name in enumerate(names):
        began, folder = time.perf_counter(), arguments.out / name
        if folder.exists():
            said = "is there already"
        else:
            try:
                n = record(f"{suite.name}/{name}", config, folder)
                said = f"{n} frames, {time.perf_counter() - began:.1f} s"
            except (MotionInfeasible, GraspFailed) as error:
                said = f"failed: {error}"
                failures.append(f"{name}: {error}")
        print(f"[{i + 1}/{len(names)}] {name}: {said}", file=sys.stderr, flush=True)
    print(f"{len(names) - len(failures)} of {len(names)} recordings in {arguments.out}")
    for line in failures:
        print(f"  {line}")
    return 1 if failures else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", help=", ".join(ALL_SUITES))
    parser.add_argument("--objects", help="a glob (door-*) or a count; all if absent")
    parser.add_argument("--pull", choices=("scripted", "robot", "hand"), default="scripted")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--travel-deg", type=float, nargs=2, default=(10.0, 40.0))
    parser.add_argument("--travel-cm", type=float, nargs=2, default=(6.0, 25.0))
    parser.add_argument("--seed", type=int, default=0, help="of scale, pose, view, states, noise")
    parser.add_argument("--noise", choices=tuple(NOISE_LEVELS), default="d455")
    parser.add_argument("--out", type=Path, required=True)
    return parser


if __name__ == "__main__":
    sys.exit(main())
