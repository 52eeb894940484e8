"""With a perfect contact, which objects does the arm open by friction alone?

    python -m experiments.hands.oracle_pulls --suite furniture-dev
    python -m experiments.hands.oracle_pulls --suite furniture-116

A test of the simulated arm and hand, never used by the program: the arm knows the scene's true
shapes, so that what a camera sees does not matter; the hand takes the handle at the
grasp that the scene's builder knows (`placement.given_grasp()`) and either follows the true motion
of the handle (`arc`) or pulls compliantly along the front's normal as the program does (`pull`). An
object counts as opened when its part has moved by 10 cm or 20 deg. Writes one JSON row an object
and way, runs none twice, and prints a table for docs/experiments.md. About 8 s of CPU an object
and way.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

import gtsam
import numpy as np

from akm_fg.arm.body.limits import LimitUsage, MotionRecorder
from akm_fg.cli.demo_config import SimulatorConfig
from akm_fg.errors import AkmError
from akm_fg.records import HandPath, WayLimits
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, whole_lines
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from sim.episode import SimEpisode, open_world
from sim.objects.placement import opened
from sim.objects.suites.catalogue import SUITES
from sim.robot.contacts import contacts, link_name
from sim.robot.franka_config import FrankaConfig
from sim.robot.slip import SlipGauge
from sim.robot.true_obstacles import true_obstacles

Way = Literal["arc", "pull"]
TICK_S = 0.05
ENOUGH = {"prismatic": 0.10, "revolute": float(np.deg2rad(20.0))}
ASKED = 1.1  # times that: friction and compliance hold the part back a little
SPEED_M_S = 0.05  # of the hand, on average
POSES = 40  # of the true motion


@dataclass(frozen=True, slots=True)
class PullRow:
    """What became of one object."""

    name: str
    way: Way
    kind: str
    hinge: str | None
    handle: str
    state: float  # at the end, m or rad
    opened: bool
    reason: str | None  # why it was not opened
    slip_m: float | None  # of the grasp, from taking hold to the end; None: never took hold
    slip_rad: float | None
    touched: tuple[str, ...]  # links of the arm, fingers aside, that were seen to touch the object
    usage: LimitUsage | None  # of Franka's limits; None: did not move
    usage_filtered: LimitUsage | None  # behind libfranka's low-pass
    cpu_s: float


def run_trial(name: str, way: Way, seed: int = 0, franka: FrankaConfig | None = None) -> PullRow:
    """Grasp one object's handle and open it, with an arm and a hand tuned so."""
    began = time.process_time()
    with open_world(name, seed, "clean", franka_config=franka) as episode:
        episode.arm.know(true_obstacles(episode.world))
        trial = _Trial(episode)
        goal = ASKED * ENOUGH[episode.world.spec.kind]
        failure = trial.run(way, episode.T_world_grasp, goal)
        spec, state = episode.world.spec, episode.world.part_state()
        slip = trial.gauge.slip(episode.arm.T_world_gripper()) if trial.gauge else None
        motion = trial.recorder.motion() if len(trial.recorder) > 2 else None
        handle = getattr(spec, "handle", None)
        done = state >= ENOUGH[spec.kind]
        return PullRow(
            name=name,
            way=way,
            kind=spec.kind,
            hinge=getattr(spec, "hinge", None),
            handle=handle.style if handle else "bar",
            state=state,
            opened=done,
            reason=None if done else failure or "it did not give any further",
            slip_m=slip.translation_m if slip else None,
            slip_rad=slip.rotation_rad if slip else None,
            touched=tuple(sorted(trial.touched)),
            usage=motion.usage() if motion else None,
            usage_filtered=motion.filtered().usage() if motion else None,
            cpu_s=time.process_time() - began,
        )


def run_published(
    name: str, seed: int, grasps: Sequence[gtsam.Pose3], asked: float, opened_from: float
) -> tuple[bool, str | None]:
    """Whether an object opens where the paper puts it, by the first clear grasp, and why not.

    Args:
        name: of the object.
        seed: of the meeting.
        grasps: T_world_grasp, best first.
        asked: how far the true motion is followed, m or rad.
        opened_from: the state from which it counts as opened, m or rad.
    """
    with open_world(name, seed, "clean", placement="published") as episode:
        episode.arm.know(true_obstacles(episode.world))
        failure: str | None = None
        for grasp in grasps:
            failure = _Trial(episode).run("arc", grasp, asked)
            if episode.world.part_state() >= opened_from:
                return True, None
            if failure is None or not failure.startswith("grasp"):
                break
        return False, failure or "it did not give any further"


class _Trial:
    """One attempt: what it saw on the way."""

    def __init__(self, episode: SimEpisode) -> None:
        self.episode = episode
        self.recorder: MotionRecorder = episode.arm.record()
        self.gauge: SlipGauge | None = None
        self.touched: set[str] = set()

    def run(self, way: Way, T_world_grasp: gtsam.Pose3, goal: float) -> str | None:
        """Grasp and open to a state; why it failed, where it did."""
        arm = self.episode.arm
        try:
            self._watch(arm.grasp(T_world_grasp, TICK_S))
            self.gauge = SlipGauge(self.episode.world, arm.T_world_gripper())
            self._watch(self._opening(way, goal))
        except AkmError as error:
            return f"{'motion' if self.gauge else 'grasp'}: {error}"
        return None if arm.holding() else "the handle slipped out of the fingers"

    def _opening(self, way: Way, goal: float) -> Iterator[None]:
        episode = self.episode
        world = episode.world
        T, T_world_gripper = world.placement.T_world_object, episode.arm.T_world_gripper()
        x = np.linspace(0.0, 1.0, POSES)
        states = world.part_state() + (goal - world.part_state()) * x
        closed = T * opened(world.built, world.part_state())
        poses = [
            T * opened(world.built, float(q)) * closed.inverse() * T_world_gripper for q in states
        ]
        points = np.array([pose.translation() for pose in poses])
        length_m = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if way == "pull":
            return episode.arm.pull(episode.pull_direction_world, length_m, TICK_S)
        limits = WayLimits(SPEED_M_S, 3.0 * SPEED_M_S, 20.0 * SPEED_M_S)
        return episode.arm.follow(HandPath(length_m * x, tuple(poses), limits), TICK_S)

    def _watch(self, motion: Iterator[None]) -> None:
        """Iterates a motion and notes which links of the arm touch the object."""
        world = self.episode.world
        fingers = set(self.episode.arm.gripper.joints)
        for _ in motion:
            touching = contacts(world.client, world.robot_id, world.object_id)
            for link in {contact.link for contact in touching} - fingers:
                self.touched.add(link_name(world.client, world.robot_id, link))


def read_rows(file: Path) -> list[PullRow]:
    """The rows so far; a line that an interruption left unfinished is left out."""
    rows = []
    for _, data in whole_lines(file):
        for key in ("usage", "usage_filtered"):
            data[key] = LimitUsage(**data[key]) if data[key] else None
        rows.append(PullRow(**data | {"touched": tuple(data["touched"])}))
    return rows


def append_row(file: Path, row: PullRow) -> None:
    """Add a row, after a line that an interruption may have left unfinished."""
    append_line(file, json.dumps(asdict(row)))


def table(rows: list[PullRow]) -> str:
    """How many opened, by way and kind, and the largest use of the limits."""
    lines = []
    for way, kind in sorted({(row.way, row.kind) for row in rows}, reverse=True):
        of = [row for row in rows if (row.way, row.kind) == (way, kind)]
        slip_m = [row.slip_m for row in of if row.opened and row.slip_m is not None]
        slip_rad = [row.slip_rad for row in of if row.opened and row.slip_rad is not None]
        slip_deg = np.rad2deg(slip_rad)
        used = [row.usage for row in of if row.usage]
        filtered = [row.usage_filtered for row in of if row.usage_filtered]
        lines.append(
            [
                f"{way}, {kind}",
                f"{sum(row.opened for row in of)} of {len(of)}",
                percent(share([row.opened for row in of])),
                f"{1e3 * np.median(slip_m):.1f} / {1e3 * max(slip_m):.1f}" if slip_m else "",
                f"{np.median(slip_deg):.1f} / {max(slip_deg):.1f}" if slip_rad else "",
                f"{sum(bool(row.touched) for row in of)}",
                f"{max(u.velocity for u in used):.2f}",
                f"{max(u.acceleration for u in used):.2f}",
                f"{max(u.jerk for u in used):.2f} / {max(u.jerk for u in filtered):.2f}",
                f"{min(u.position_margin_rad for u in used):.3f}",
                f"{np.median([row.cpu_s for row in of]):.0f}",
            ]
        )
    header = ["way, kind", "opened", "%", "slip mm, median / largest", "slip deg", "arm touched"]
    header += ["speed", "acceleration", "jerk / filtered", "margin rad", "CPU s"]
    return markdown(header, lines)


def failures(rows: list[PullRow]) -> str:
    """Every object that was not opened, with the reason."""
    lines = []
    for row in rows:
        if not row.opened:
            unit = f"{100 * row.state:.1f} cm" if row.kind == "prismatic" else ""
            unit = unit or f"{np.rad2deg(row.state):.1f} deg"
            touched = ", ".join(row.touched)
            lines.append([row.name, row.way, row.handle, unit, str(row.reason), touched])
    return markdown(["object", "way", "handle", "opened by", "reason", "arm touched it"], lines)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", choices=sorted(SUITES))
    parser.add_argument("--way", choices=get_args(Way), action="append")
    parser.add_argument("--limit", type=int, help="stop after so many new trials")
    parser.add_argument("--out", type=Path, default=Path("runs/oracle-pulls"))
    arguments = parser.parse_args()
    note_run(arguments.out, SimulatorConfig())
    file = arguments.out / f"{arguments.suite}.jsonl"
    done = {(row.name, row.way) for row in read_rows(file)}
    numbered = sorted(SUITES[arguments.suite].names(), key=lambda name: name[-3:])
    names = [f"{arguments.suite}/{name}" for name in numbered]  # drawers and doors by turns
    ways = arguments.way or get_args(Way)
    missing = [(name, way) for way in ways for name in names if (name, way) not in done]
    for k, (name, way) in enumerate(missing[: arguments.limit], 1):
        row = run_trial(name, way)
        append_row(file, row)
        said = "opened" if row.opened else row.reason
        print(f"{k} of {len(missing)}: {name} {way}: {said}", file=sys.stderr, flush=True)
    rows = read_rows(file)
    print(table(rows), failures(rows), sep="\n\n")


if __name__ == "__main__":
    main()
