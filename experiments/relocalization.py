"""Is a part of a known object found from anywhere, how exactly, how sure, and how fast?

    python -m experiments.relocalization --models runs/closed-loop/furniture-dev/models
    python -m experiments.relocalization --models runs/closed-loop/furniture-116/models --states 6

For every model that `experiments.closed_loop` has kept: the part is put into states drawn uniformly
from 0 to 40 cm or degrees while nobody looks, one frame is taken, and the filter searches its whole
range with no memory; a second frame is an update. Beside it, on the same frame with the same joint,
the paper's Algorithm 3 (15 candidates, then gradient descent against five keyframes of the
exploration's recording), and processor times of both in the same process. Truth comes from the
simulator and is used for scoring alone. About 15 s of processor time a state, nearly all of it the
baseline's (`--without-baseline`).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from akm_fg.cli.demo_config import DemoConfig, demo_config
from akm_fg.cli.exploring.explore import ExploreArguments, simulated_default
from akm_fg.cli.object_argument import parse_object
from akm_fg.cli.simulated_run import opened_world
from akm_fg.errors import AkmError
from akm_fg.io.recording_reader import read_recording
from akm_fg.model.read import read_model
from akm_fg.model.records import ModelPart, ObjectModel
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.records import FloatArray, RgbdFrame
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.stream.frame_stream import FrameStream
from akm_fg.stream.seen_so_far import hands_of
from experiments.baselines.clouds import PartCloud, choose_keyframes, part_cloud
from experiments.baselines.estimate import JointEstimate
from experiments.baselines.relocalize import relocalize
from experiments.closed_loop import kept_models
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from experiments.trials.part_clouds import MAX_POINTS, keyframe_clouds
from sim.episode import SimEpisode

MOST = {False: 0.40, True: float(np.deg2rad(40.0))}  # m, rad: the paper's tasks
RIGHT = {
    False: 0.02,
    True: float(np.deg2rad(2.0)),
}  # a hypothesis nearer than this is the right one
KEYFRAMES = 5  # the paper's
TICK_S = 1.0


@dataclass(frozen=True, slots=True)
class RelocalizationRow:
    """One state. None: not known, or not asked."""

    name: str
    seed: int
    number: int
    turns: bool
    state: float  # true, m or rad
    mode: str
    found: float | None
    sd: float | None
    search_s: float  # processor time of the search
    update_s: float | None  # of the update by the next frame
    updated: float | None
    updated_sd: float | None
    baseline: float | None  # of Algorithm 3
    baseline_s: float | None

    @property
    def off(self) -> float | None:
        """Error of the search."""
        return None if self.found is None else self.found - self.state


def run_object(
    name: str, seed: int, folder: Path, states: int, baseline: bool
) -> list[RelocalizationRow]:
    """All states of one object."""
    model = read_model(folder)
    part = model.parts[0]
    clouds, seen = _keyframes(folder, part, seed) if baseline else ([], np.zeros(0))
    config = demo_config(ExploreArguments(rig_errors=True), simulated_default())
    rows = []
    with opened_world(parse_object(name), seed, config.sim, "published") as world:
        frame = world.camera.capture()
        world.arm.see(frame)
        for _ in world.arm.step_aside(frame, TICK_S):
            pass
        rng = np.random.default_rng([seed, 5, *name.encode()])
        for number, state in enumerate(rng.uniform(0.0, MOST[part.joint.turns], states)):
            rows.append(_one(world, model, float(state), name, seed, number, clouds, seen, config))
    return rows


def _one(
    world: SimEpisode,
    model: ObjectModel,
    state: float,
    name: str,
    seed: int,
    number: int,
    clouds: Sequence[PartCloud],
    seen: FloatArray,
    config: DemoConfig,
) -> RelocalizationRow:
    part = model.parts[0]
    world.world.put_part(state)
    first = world.camera.capture()
    follower = Relocalizer(model, 0, config.perception.observe.noise, config.relocalization)
    began = time.process_time()
    belief = follower.update(first)
    search_s = time.process_time() - began
    for _ in range(round(0.03 / world.world.config.step_s)):
        world.world.step()
    world.world.put_part(state)
    second = world.camera.capture()
    began = time.process_time()
    after = follower.update(second)
    update_s = time.process_time() - began
    told, told_s = None, None
    if clouds:
        current = _cloud(first, config)
        began = time.process_time()
        told = relocalize(_as_estimate(part, seen), clouds, seen, current, seed).state
        told_s = time.process_time() - began
    return RelocalizationRow(
        name, seed, number, part.joint.turns, state, belief.mode, belief.mean, belief.sd, search_s,
        update_s if belief.mode == "tracking" else None, after.mean, after.sd, told, told_s,
    )  # fmt: skip


def _keyframes(folder: Path, part: ModelPart, seed: int) -> tuple[list[PartCloud], FloatArray]:
    """Clouds of the part in the exploration's recording, and their states, as the camera sees."""
    recording = read_recording(sorted(folder.glob("attempt-*"))[-1])
    config = simulated_default()
    stream = FrameStream("keyframes", config.model_settings, calibration=recording.calibration)
    for frame, hand in zip(recording.frames, hands_of(recording), strict=True):
        stream.add(frame, hand)
    fit = stream.posterior()
    best = fit.posterior.best
    if best.states is None:
        return [], np.zeros(0)
    numbers = choose_keyframes(best.states.mean, KEYFRAMES)
    noise, rng = config.perception.observe.noise, np.random.default_rng(seed)
    try:
        found = keyframe_clouds(recording, fit.observed, list(map(int, numbers)), noise, rng)
    except ValueError:  # too few points were followed for the baseline's masks
        return [], np.zeros(0)
    kept = sorted(found)
    # The baseline's first keyframe is its zero.
    states = np.array([part.seen_state(float(best.states.mean[k])) for k in kept])
    return [found[k] for k in kept], states - states[:1] if kept else states


def _as_estimate(part: ModelPart, states: FloatArray) -> JointEstimate:
    joint = part.seen_joint
    return JointEstimate(joint.kind, joint.axis, joint.pivot, states, {}, {})


def _cloud(frame: RgbdFrame, config: DemoConfig) -> PartCloud:
    """What the frame shows of the object."""
    mask = DepthObjectSegmenter(config.perception.observe.mask).segment(frame)
    v, u = np.nonzero(mask & np.isfinite(frame.depth_m))
    pick = np.linspace(0, u.size - 1, min(u.size, MAX_POINTS)).astype(int)
    uv = np.stack([u[pick], v[pick]], axis=-1).astype(float)
    p_cam = frame.camera.back_project(uv, frame.depth_m[v[pick], u[pick]].astype(float))
    T = frame.T_world_cam.matrix()
    return part_cloud(p_cam @ T[:3, :3].T + T[:3, 3])


def table(rows: Sequence[RelocalizationRow]) -> str:
    """One line a sort of joint."""
    lines = []
    for turns, sort in ((False, "slides, mm"), (True, "turns, deg")):
        of = [row for row in rows if row.turns == turns]
        if not of:
            continue
        unit = float(np.rad2deg(1.0)) if turns else 1e3
        off = np.array([row.off for row in of if row.off is not None])
        z2 = [(row.off / row.sd) ** 2 for row in of if row.off is not None and row.sd]
        theirs = [row.baseline - row.state for row in of if row.baseline is not None]
        their_s = [row.baseline_s for row in of if row.baseline_s is not None]
        own_s = [row.search_s for row in of]
        update_s = [row.update_s for row in of if row.update_s is not None]
        updated = [row.updated - row.state for row in of if row.updated is not None]
        right = [row.off is not None and abs(row.off) < RIGHT[turns] for row in of]
        lines.append(
            [
                sort,
                str(len(of)),
                percent(share(right)),
                f"{unit * np.median(np.abs(off)):.2f}" if off.size else "",
                f"{np.median(z2):.2f}" if z2 else "",
                percent(share([z < 3.84 for z in z2])) if z2 else "",
                f"{np.median(own_s):.2f}",
                f"{1e3 * np.median(update_s):.0f}" if update_s else "",
                f"{unit * np.median(np.abs(updated)):.2f}" if updated else "",
                f"{unit * np.median(np.abs(theirs)):.2f}" if theirs else "",
                percent(share([abs(e) < RIGHT[turns] for e in theirs])) if theirs else "",
                f"{np.median(their_s) / np.median(own_s):.0f}" if their_s else "",
                f"{np.median(their_s) / np.median(update_s):.0f}" if their_s and update_s else "",
            ]
        )
    header = ["joint", "states", "right %", "median error", "median z2 (0.45)", "inside 95 %"]
    header += ["search s", "update ms", "its median error", "Algorithm 3: median error", "right %"]
    header += ["its time / search", "its time / update"]
    return markdown(header, lines)


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of closed_loop's models")
    parser.add_argument("--states", type=int, default=4, help="of an object")
    parser.add_argument("--without-baseline", action="store_true")
    parser.add_argument("--limit", type=int, help="stop after so many objects")
    parser.add_argument("--table", action="store_true", help="print the table alone")
    arguments = parser.parse_args()
    file = arguments.models.parent / "relocalization.jsonl"
    if not arguments.table:
        note_run(arguments.models.parent)
        _run_missing(arguments, file)
    rows = rows_of(RelocalizationRow, file)
    if rows:
        print(table(rows))


def _run_missing(arguments: argparse.Namespace, file: Path) -> None:
    done = {(row.name, row.seed) for row in rows_of(RelocalizationRow, file)}
    objects = 0
    for name, seed, folder in kept_models(arguments.models):
        if (name, seed) in done:
            continue
        if arguments.limit is not None and objects >= arguments.limit:
            break
        objects += 1
        try:
            rows = run_object(
                name, seed, folder, arguments.states, not arguments.without_baseline
            )  # fmt: skip
        except AkmError as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
            continue
        for row in rows:
            append_line(file, json.dumps(asdict(row)))
        print(f"{name}: {len(rows)} states", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
