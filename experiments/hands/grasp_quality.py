"""Does the quality of a proposed grasp say how often it holds?

    python -m experiments.hands.grasp_quality --objects 20 --grasps 4

Each trial: an object of `furniture-dev` within the arm's reach whose part is jammed, one noisy
frame of the fixed camera, the contact that is proposed nearest to the true handle, and some of the
grasps that are sampled there: the best and others at random. The arm takes hold and pulls outwards
with 60 N. A grasp holds if something is still between the fingers and the hand has gone less than
`SLIPPED_M`. One row a grasp in `runs/grasp_quality.jsonl`, written as it ends; objects that are
there already are not run again. Prints a table of claimed against observed shares and the weights
that fit the rows. About 15 s of one core a grasp. Feeds docs/decisions/0018.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.arm.motion.aside import AsideConfig, aside
from akm_fg.arm.motion.pulling import PullConfig
from akm_fg.arm.motion.reaching import choose_grasp_configuration
from akm_fg.errors import AkmError, GraspFailed, MotionInfeasible
from akm_fg.grasping.antipodal import AntipodalSampler, ScoredGrasp
from akm_fg.grasping.quality import features
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.perception.fronts.contacts import contact_candidates
from akm_fg.records import FloatArray, RgbdFrame
from experiments.rows.json_lines import append_line, whole_lines
from sim.bullet import p
from sim.camera.views import FixedViewConfig
from sim.episode import SimEpisode, open_world
from sim.objects.suites.catalogue import find_suite
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.robot.contacts import finger_links
from sim.robot.franka_config import FrankaConfig

SUITE = "furniture-dev"
PULL_N = 60.0
PULL_M = 0.06
SLIPPED_M = 0.015  # the hand's own compliance is a third of it
NEAR_HANDLE_M = 0.05
BINS = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 1.0])


@dataclass(frozen=True, slots=True)
class GraspRow:
    """What became of one grasp."""

    object: str
    seed: int
    style: str
    what: str  # of the contact
    rank: int  # among the proposals, from 0
    quality: float
    features: list[float]
    holds: bool | None  # None: the arm does not get there
    why: str  # in words, where it does not hold
    went_mm: float | None  # of the hand while it pulled


def run_object(name: str, seed: int, grasps: int) -> list[GraspRow]:
    """All rows of one object."""
    franka = FrankaConfig(pull=PullConfig(force_max_n=PULL_N))
    view = FixedViewConfig()
    with open_world(
        f"{SUITE}/{name}", seed, "d455", view=view, franka_config=franka, locked=True
    ) as episode:
        frame = look_with_the_arm_aside(episode)
        found = proposals_at_the_handle(episode, frame)
        spec = episode.world.spec
        assert isinstance(spec, FurnitureSpec)  # as all of the suite
        style = spec.handle.style
        if found is None:
            return [
                GraspRow(name, seed, style, "none", -1, 0.0, [], None, "no contact there", None)
            ]
        what, proposals = found
        if not proposals:
            return [GraspRow(name, seed, style, what, -1, 0.0, [], None, "no grasps", None)]
        rng = np.random.default_rng([seed, *name.encode()])
        others = 1 + rng.permutation(max(len(proposals) - 1, 0))
        rows, tried = [], 0
        for rank in (0, *others.tolist()):
            holds, why, went_mm = _try(episode, proposals[rank])
            one = proposals[rank]
            rows.append(
                GraspRow(
                    name,
                    seed,
                    style,
                    what,
                    int(rank),
                    one.quality,
                    features(one.evidence).tolist(),
                    holds,
                    why,
                    went_mm,
                )
            )
            tried += holds is not None
            if tried >= grasps or len(rows) >= 3 * grasps:
                break
        return rows


def look_with_the_arm_aside(episode: SimEpisode) -> RgbdFrame:
    """A frame with the arm aside, as an explorer takes it."""
    frame, arm = episode.camera.capture(), episode.arm
    q = arm.measured_joints()[0]
    place = aside(ArmSilhouette(), frame, q, AsideConfig())[0]
    _put(episode, place)
    return episode.camera.capture()


def _put(episode: SimEpisode, q: FloatArray) -> None:
    """The arm at joint angles (7,), its fingers open."""
    world = episode.world
    for joint, angle in enumerate(q):
        p.resetJointState(world.robot_id, joint, float(angle), physicsClientId=world.client)
    for finger in finger_links(world.client, world.robot_id):
        p.resetJointState(world.robot_id, finger, 0.04, physicsClientId=world.client)
    episode.arm.gripper.open()


def proposals_at_the_handle(
    episode: SimEpisode, frame: RgbdFrame
) -> tuple[str, list[ScoredGrasp]] | None:
    """Of the contact nearest to the true handle: what it is, and the grasps."""
    world = episode.world
    handle = (world.placement.T_world_object * world.built.T_object_handle).translation()
    mask = DepthObjectSegmenter().segment(frame)
    contacts = contact_candidates(frame, mask)
    off = [float(np.linalg.norm(contact.p_world - handle)) for contact in contacts]
    if not off or min(off) > NEAR_HANDLE_M:
        return None
    contact = contacts[int(np.argmin(off))]
    found = AntipodalSampler().scored(frame, mask, contact.p_world, contact.normal_world)
    return contact.what, found


def _try(episode: SimEpisode, grasp: ScoredGrasp) -> tuple[bool | None, str, float | None]:
    """Whether it holds, why not, and how far the hand went, mm."""
    arm, T = episode.arm, gtsam.Pose3(grasp.T)
    choice = choose_grasp_configuration(episode.world.kinematics, T)
    if choice is None:
        return None, "out of reach", None
    _put(episode, choice.q_pregrasp)
    tick_s = 0.5
    try:
        for _ in arm.grasp(T, tick_s):
            pass
        start = arm.T_world_gripper().translation()
        for _ in arm.pull(episode.pull_direction_world, PULL_M, tick_s):
            pass
    except MotionInfeasible as error:
        return None, str(error), None
    except GraspFailed as error:
        return False, str(error), None
    went = float(np.linalg.norm(arm.T_world_gripper().translation() - start))
    if not arm.holding():
        return False, "let go", 1e3 * went
    return went < SLIPPED_M, "" if went < SLIPPED_M else "slipped", 1e3 * went


def report(rows: list[GraspRow]) -> str:
    """Claimed against observed shares, and the weights that fit the rows."""
    tried = [row for row in rows if row.holds is not None]
    if not tried:
        return "no grasp was tried"
    claimed = np.array([row.quality for row in tried])
    held = np.array([bool(row.holds) for row in tried])
    lines = [f"{len(rows)} rows, {len(tried)} grasps tried, {held.mean():.2f} held"]
    for low, high in itertools.pairwise(BINS):
        inside = (claimed >= low) & (claimed < high)
        if inside.any():
            share = f"claimed {claimed[inside].mean():.2f}  held {held[inside].mean():.2f}"
            lines.append(f"  {low:.2f}..{high:.2f}: {inside.sum():4d} grasps  {share}")
    lines.append(f"  Brier {np.mean((claimed - held) ** 2):.3f}, of the mean {held.var():.3f}")
    if 0 < held.sum() < len(held):
        lines.append("  fitted: " + _fitted(tried, held))
    return "\n".join(lines)


def _fitted(tried: list[GraspRow], held: FloatArray) -> str:
    """Intercept and weights of a logistic regression with a weak prior."""
    from sklearn.linear_model import LogisticRegression

    X = np.array([row.features for row in tried])
    model = LogisticRegression(C=3.0).fit(X, held)
    numbers = ", ".join(f"{w:.2f}" for w in model.coef_[0])
    return f"{model.intercept_[0]:.2f}; {numbers}"


def main() -> None:
    """Runs what is missing and prints the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--grasps", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--names", nargs="*", default=None)
    parser.add_argument("--out", type=Path, default=Path("runs/grasp_quality.jsonl"))
    arguments = parser.parse_args()
    done = [GraspRow(**row) for _, row in whole_lines(arguments.out)]
    names = arguments.names or list(find_suite(SUITE).names())
    chosen = names[:: max(len(names) // arguments.objects, 1)][: arguments.objects]
    for name in chosen:
        if any(row.object == name and row.seed == arguments.seed for row in done):
            continue
        try:
            rows = run_object(name, arguments.seed, arguments.grasps)
        except AkmError as error:
            rows = [GraspRow(name, arguments.seed, "", "", -1, 0.0, [], None, str(error), None)]
        for row in rows:
            append_line(arguments.out, json.dumps(dataclasses.asdict(row)))
        done.extend(rows)
        sys.stderr.write(f"{name}: {[row.holds for row in rows]}\n")
    sys.stdout.write(report(done) + "\n")


if __name__ == "__main__":
    main()
