"""What if something goes wrong while a part is moved: is it noticed, cured, or ended with a reason?

    python -m experiments.faults --models runs/closed-loop/furniture-dev/models --faults 20

With every model that `experiments.closed_loop` has kept, tasks of the paper's kind are run while
one thing goes wrong at a random moment: the part is moved unseen, the camera sees nothing for ten
frames, the fingers open, the part jams, or the model handed in is another object's. A fault is
unnoticed where the run claims to be within tolerance and is not. Rows are written as they end.
Truth comes from the simulator and is used for scoring alone. About 20 s of processor time each.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from akm_fg.cli.object_argument import parse_object
from akm_fg.cli.running.run import run_request
from akm_fg.cli.running.simulated import Ran, run_in_simulator
from akm_fg.interfaces import Camera
from akm_fg.records import RgbdFrame
from experiments.closed_loop import BIN, ERRORS, TOLERANCE, arguments_of, kept_models, tasks_of
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from sim.episode import SimEpisode

FAULTS = ("part moved unseen", "camera blocked", "fingers opened", "part jammed", "other's model")
BLOCKED_FRAMES = 10


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault in one run."""

    name: str
    fault: str
    number: int
    happened: bool  # the run lasted until then
    claimed: bool
    within: bool  # truly within the tolerance asked for
    failure: str | None
    probability: float
    rounds: int
    looks: int
    regrasps: int
    limit_share: float  # largest, of the arm's limits

    @property
    def unnoticed(self) -> bool:
        """It claimed what is not so."""
        return self.claimed and not self.within


class Disturbed:
    """A world's camera, behind which one thing goes wrong at a given frame."""

    def __init__(self, world: SimEpisode, fault: str, at: int, rng: np.random.Generator) -> None:
        self._world, self._fault, self._at, self._rng = world, fault, at, rng
        self._frames = 0
        self.happened = fault == "other's model"

    def capture(self) -> RgbdFrame:
        """The scene now, after what went wrong."""
        self._frames += 1
        if self._frames == self._at:
            self._go_wrong()
        frame = self._world.camera.capture()
        blocked = self._at <= self._frames < self._at + BLOCKED_FRAMES
        if self._fault == "camera blocked" and blocked:
            dark = np.full_like(frame.depth_m, np.nan)
            return replace(frame, rgb=np.zeros_like(frame.rgb), depth_m=dark)
        return frame

    def _go_wrong(self) -> None:
        self.happened = True
        world = self._world.world
        if self._fault == "part moved unseen":
            if not self._world.arm.holding():
                most = 4 * BIN[str(world.spec.kind)]
                world.put_part(float(self._rng.uniform(0.0, most)))
            else:
                self.happened = False  # what a hand holds nobody moves away
        elif self._fault == "fingers opened":
            self._world.arm.gripper.open()
        elif self._fault == "part jammed":
            world.jam()


def run_fault(name: str, fault: str, number: int, seed: int, model: Path) -> FaultRow:
    """One run with one fault."""
    kind = str(parse_object(name).spec(seed).kind)
    rng = np.random.default_rng([seed, number, *fault.encode(), *name.encode()])
    task = tasks_of(name, kind, seed + number, 1)[0]
    disturbed: list[Disturbed] = []

    def through(world: SimEpisode) -> Camera:
        disturbed.append(Disturbed(world, fault, int(rng.integers(2, 16)), rng))
        return disturbed[0]

    with tempfile.TemporaryDirectory(prefix="akm-fg-faults-") as scratch:
        arguments = arguments_of(name, kind, task, seed, model, Path(scratch))
        ran: Ran | None = None
        failure: str | None
        try:
            ran = run_in_simulator(run_request(arguments), through)
            failure = ran.failure
        except ERRORS as error:
            failure = f"{type(error).__name__}: {error}"
    run = None if ran is None else ran.manipulation
    final = None if ran is None else ran.final_state
    return FaultRow(
        name=name,
        fault=fault,
        number=number,
        happened=bool(disturbed and disturbed[0].happened),
        claimed=bool(ran and ran.reached),
        within=final is not None and abs(final - task.target) <= TOLERANCE[kind],
        failure=failure,
        probability=0.0 if run is None else run.probability,
        rounds=0 if run is None else run.rounds,
        looks=0 if run is None else run.clear_looks,
        regrasps=0 if run is None else run.regrasps,
        limit_share=0.0 if ran is None else max(ran.limit_shares.values(), default=0.0),
    )


def table(rows: Sequence[FaultRow]) -> str:
    """One line a fault."""
    lines = []
    for fault in (*FAULTS, "all"):
        of = [row for row in rows if fault in (row.fault, "all") and row.happened]
        if of:
            lines.append(
                [
                    fault,
                    str(len(of)),
                    percent(share([row.claimed and row.within for row in of])),
                    percent(share([not row.claimed for row in of])),
                    str(sum(row.unnoticed for row in of)),
                    f"{max(row.limit_share for row in of):.2f}",
                ]
            )
    header = ["what went wrong", "runs", "reached all the same %", "ended with a reason %"]
    return markdown([*header, "unnoticed", "limits used"], lines)


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of closed_loop's models")
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--table", action="store_true", help="print the table alone")
    arguments = parser.parse_args()
    file = arguments.models.parent / "faults.jsonl"
    if not arguments.table:
        note_run(arguments.models.parent)
        _run_missing(arguments, file)
    rows = rows_of(FaultRow, file)
    if rows:
        print(table(rows))
        for row in rows:
            if row.unnoticed:
                print(f"unnoticed: {row.name}, {row.fault} {row.number}: P {row.probability:.3f}")


def _run_missing(arguments: argparse.Namespace, file: Path) -> None:
    done = {(row.name, row.fault, row.number) for row in rows_of(FaultRow, file)}
    models = kept_models(arguments.models)
    for number in range(arguments.faults):
        fault = FAULTS[number % len(FAULTS)]
        name, seed, model = models[(number // len(FAULTS)) % len(models)]
        if (name, fault, number) in done:
            continue
        if fault == "other's model":
            others = [each for each in models if each[0] != name]
            if not others:
                continue
            model = others[number % len(others)][2]
        row = run_fault(name, fault, number, seed, model)
        append_line(file, json.dumps(asdict(row)))
        said = "UNNOTICED" if row.unnoticed else row.failure or "reached"
        print(f"{number}: {name}, {fault}: {said}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
