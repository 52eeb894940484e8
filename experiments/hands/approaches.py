"""Does the arm reach grasps from anywhere without touching anything but with its fingers?

    python -m experiments.hands.approaches --trials 200

Each trial: a random object of the suites, closed, a random clear configuration of the arm, a
random view of the camera; the arm sees one noisy frame, plans, moves and approaches the given
grasp of the handle. Every control step is checked with PyBullet's own contact points. One row a
trial in `runs/approaches.jsonl`, written as it ends; trials that are there already are not run
again (another seed wants another file). Four seconds of one core a trial. Feeds the table of
docs/experiments.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from akm_fg.arm.body.collision import ArmCollisions
from akm_fg.arm.body.kinematics import Q_MAX, Q_MIN
from akm_fg.arm.body.limits import LimitUsage
from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.records import FloatArray
from experiments.rows.json_lines import append_line, whole_lines
from sim.bullet import p
from sim.camera.camera import CameraConfig, SimCamera
from sim.camera.views import camera_pose, sample_view
from sim.objects.suites.catalogue import SUITES
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.robot.contacts import contacts, finger_links, nearby
from sim.robot.franka import SimFranka
from sim.robot.true_obstacles import true_obstacles
from sim.world import SimWorld

START_MARGIN_M = 0.03  # of a start from everything
START_TRIES = 200
LIMIT_MARGIN_RAD = 0.1  # of a start from the joint limits
CLOSEST_M = 0.05  # distances are looked for up to here
CLOSEST_STEPS = 5  # control steps from one look to the next
NEAR_M = 0.11  # the straight approach is 0.10 m long; from there on fingers may touch


@dataclass(frozen=True, slots=True)
class ApproachRow:
    """What became of one trial."""

    trial: int
    object: str
    infeasible: str | None  # why the arm did not move
    touched: list[str]  # what but a finger touched what, at any time; a finger before its approach
    blocked: str | None  # why the approach ended early
    closest_mm: float | None  # anything but the fingers to the object; None beyond `CLOSEST_M`
    off_mm: float | None  # of the hand from the grasp, before the fingers close
    limits_used: dict[str, float] | None  # of what was executed, share of Franka's limits
    see_s: float  # CPU seconds from a frame to the obstacle map
    plan_s: float  # CPU seconds of everything from the map to the first step


def run_trial(
    trial: int, seed: int = 0, make_arm: Callable[[SimWorld], SimFranka] = SimFranka
) -> ApproachRow:
    """One approach of the arm that is made; the numbers give everything that is random."""
    rng = np.random.default_rng([seed, trial, 41])
    suite = SUITES[str(rng.choice(sorted(SUITES)))]
    name = f"{suite.name}/{rng.choice(suite.names())}"
    with SimWorld(name, seed=int(rng.integers(1000))) as world:
        start = _clear_start(world, rng)
        for joint, q in enumerate(start):
            p.resetJointState(world.robot_id, joint, float(q), physicsClientId=world.client)
        arm = make_arm(world)
        spec = world.spec
        assert isinstance(spec, FurnitureSpec)  # as all of the suites
        view = camera_pose(world, sample_view(rng, max(spec.front_m)))
        camera = SimCamera(world, view, trial, CameraConfig())
        try:
            frame = camera.capture()
            began = time.process_time()
            arm.see(frame)
            see_s = time.process_time() - began
            return dataclasses.replace(_approach(world, arm), trial=trial, object=name, see_s=see_s)
        finally:
            camera.close()


def _clear_start(world: SimWorld, rng: np.random.Generator) -> FloatArray:
    truth = ArmCollisions(true_obstacles(world), START_MARGIN_M)
    for _ in range(START_TRIES):
        q = rng.uniform(Q_MIN + LIMIT_MARGIN_RAD, Q_MAX - LIMIT_MARGIN_RAD)
        if truth.free(q):
            return q
    raise RuntimeError(f"{world.spec.name}: no clear start in {START_TRIES}")


def _approach(world: SimWorld, arm: SimFranka) -> ApproachRow:
    """Moves and watches until the fingers begin to close."""
    grasp, touched = world.placement.given_grasp(), set[str]()
    recorder, infeasible, blocked = arm.record(), None, None
    watch = _ContactWatch(world)
    began, plan_s, closest_m = time.process_time(), 0.0, np.inf
    try:
        for step, _ in enumerate(arm.grasp(grasp, world.config.step_s)):
            plan_s = plan_s if step else time.process_time() - began
            if arm.gripper.squeezing:
                break
            touched |= watch.forbidden(arm)
            if step % CLOSEST_STEPS == 0:
                closest_m = min(closest_m, watch.closest_m())
    except MotionInfeasible as error:
        infeasible, plan_s = str(error), time.process_time() - began
    except GraspFailed as error:
        blocked = str(error)
    off_m = np.linalg.norm(arm.T_world_gripper().translation() - grasp.translation())
    moved = infeasible is None
    usage = dataclasses.asdict(recorder.motion().usage()) if moved else None
    off_mm = 1e3 * float(off_m) if moved else None
    closest_mm = 1e3 * closest_m if np.isfinite(closest_m) else None
    return ApproachRow(
        0, "", infeasible, sorted(touched), blocked, closest_mm, off_mm, usage, 0.0, plan_s
    )


class _ContactWatch:
    """The contact points of the robot, as they are after a step."""

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._fingers = finger_links(world.client, world.robot_id)

    def forbidden(self, arm: SimFranka) -> set[str]:
        """Contacts with anything else but of a finger with the object, near the grasp.

        The base, which stands on floor or pedestal, is left out.
        """
        world, found = self._world, set()
        for contact in contacts(world.client, world.robot_id):
            body, link = contact.other_body, contact.link
            if body == world.robot_id or link < 0 or contact.distance_m > 0.0:
                continue
            finger = link in self._fingers
            if finger and body == world.object_id and self._near(arm):
                continue
            what = "the object" if body == world.object_id else f"body {body}"
            found.add(f"{'a finger' if finger else f'link {link + 1}'} and {what}")
        return found

    def closest_m(self) -> float:
        """From the object to anything of the robot but its fingers; infinite beyond `CLOSEST_M`."""
        world = self._world
        near = nearby(world.client, world.robot_id, world.object_id, CLOSEST_M)
        return min((x.distance_m for x in near if x.link not in self._fingers), default=np.inf)

    def _near(self, arm: SimFranka) -> bool:
        grasp = self._world.placement.given_grasp()
        off = arm.T_world_gripper().translation() - grasp.translation()
        return bool(np.linalg.norm(off) < NEAR_M)


def report(rows: list[ApproachRow]) -> str:
    """The counts that the decision's table has, a line each."""
    moved = [row for row in rows if row.infeasible is None]
    clear = [row for row in moved if not row.touched]
    within = [row for row in moved if row.limits_used and LimitUsage(**row.limits_used).within]
    near = [row.closest_mm for row in moved if row.closest_mm is not None]
    off = [row.off_mm for row in moved if row.off_mm is not None]
    plans = np.array([row.plan_s for row in rows])
    reasons = Counter(reason(row.infeasible) for row in rows if row.infeasible)
    lines = [
        f"{len(rows)} approaches, {len(moved)} executed",
        f"  nothing touched but by a finger at the handle: {len(clear)}",
        f"  arrived at the handle: {sum(row.blocked is None for row in moved)}",
        f"  inside the published limits: {len(within)}",
        f"  closest to the object, but for the fingers: {min(near, default=np.nan):.1f} mm, "
        f"median {np.median(near):.1f} mm",
        f"  hand from the grasp: {np.median(off):.2f} mm (median), "
        f"{max(off, default=np.nan):.2f} mm (largest)",
        f"  map {1e3 * np.median([row.see_s for row in rows]):.0f} ms CPU (median), plan "
        f"{np.median(plans):.2f} s (median), {np.quantile(plans, 0.95):.2f} s (95 %)",
    ]
    lines += [f"  infeasible: {why}: {count}" for why, count in reasons.most_common()]
    lines += [f"  {row.object} ({row.trial}): {row.touched}" for row in moved if row.touched]
    return "\n".join(lines)


def reason(infeasible: str | None) -> str:
    """The kind of a failure, without its numbers and names."""
    known = (
        "out of the arm's reach",
        "is not clear",
        "no free way",
        "where the arm stands",
        "goal",
    )
    return next((words for words in known if words in (infeasible or "")), infeasible or "none")


def read_rows(path: Path) -> list[ApproachRow]:
    """What an earlier run wrote; nothing where there is none."""
    return [ApproachRow(**data) for _, data in whole_lines(path)]


def main(argv: list[str] | None = None, run: Callable[[int, int], ApproachRow] = run_trial) -> int:
    """Run what is missing and report; the exit code is 1 where the arm touched something.

    Args:
        argv: of the command line.
        run: makes the row of a trial, of its number and the seed.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/approaches.jsonl"))
    arguments = parser.parse_args(argv)
    rows = read_rows(arguments.out)
    done = {row.trial for row in rows}
    trials = range(arguments.first, arguments.first + arguments.trials)
    for trial in (trial for trial in trials if trial not in done):
        rows.append(run(trial, arguments.seed))
        append_line(arguments.out, json.dumps(dataclasses.asdict(rows[-1])))
        said = rows[-1].infeasible or rows[-1].touched or "clear"
        print(f"[{trial}] {rows[-1].object}: {said}", file=sys.stderr, flush=True)
    print(report(rows))
    return 1 if any(row.touched for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
