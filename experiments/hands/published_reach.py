"""Where the paper puts objects, how many can an arm open that knows everything?

    python -m experiments.hands.published_reach --suite furniture-dev
    python -m experiments.hands.published_reach --suite furniture-116

Nobody looks whether the arm can open an object before it is put there, so that some cannot be
opened whatever one knows. Counted by kinematics alone: a grasp of the true handle, and joint angles
that take it along the true motion. `--simulate` grasps and follows in the simulator, past true
obstacles, by friction alone. Opened is 5 cm or 5 deg, the paper's ESR_5; the whole standard range
is counted too. Writes one JSON row an object and runs none twice. About 2 s of CPU an object, and
10 s with `--simulate`.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.cli.demo_config import SimulatorConfig
from experiments.hands.oracle_pulls import run_published
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, whole_lines
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from experiments.trials.oracle_grasps import enough, followable_grasps
from sim.objects.part_spec import standard_range
from sim.objects.published_place import place_as_published
from sim.objects.suites.catalogue import SUITES, load_spec
from sim.objects.suites.furniture_build import measure_furniture
from sim.objects.suites.furniture_spec import FurnitureSpec

OPENED = 5.0  # cm or deg, the paper's
ASKED = 6.0  # followed so far: friction and compliance hold the part back a little


@dataclass(frozen=True, slots=True)
class ReachRow:
    """What an arm that knows everything could do with one object."""

    name: str
    seed: int
    kind: str
    family: str
    handle: str
    handles: int  # from which an explorer has to choose
    grasps: int  # of the free handle, that can be followed for `ASKED`
    whole: bool  # the whole standard range can be followed by one of them
    opened: bool | None  # in the simulator; None: not tried
    reason: str | None  # why not


def run_trial(name: str, seed: int = 0, simulate: bool = False) -> ReachRow:
    """Count one object's ways; try the first that is clear, if asked."""
    spec = load_spec(name, seed)
    assert isinstance(spec, FurnitureSpec)
    kinematics = FrankaKinematics()
    built = measure_furniture(spec)
    placement = place_as_published(built)
    asked = enough(spec.kind, ASKED)
    ways = followable_grasps(built, spec, placement, kinematics, asked)
    whole = followable_grasps(built, spec, placement, kinematics, standard_range(spec))
    opened, reason = None, None if ways else "out of the arm's reach"
    if simulate and ways:
        opened, reason = run_published(name, seed, ways, asked, enough(spec.kind, OPENED))
    return ReachRow(
        name=name,
        seed=seed,
        kind=spec.kind,
        family=spec.family,
        handle=spec.handle.style,
        handles=spec.handles,
        grasps=len(ways),
        whole=bool(whole),
        opened=opened,
        reason=reason,
    )


def read_rows(file: Path) -> list[ReachRow]:
    """The rows so far; a line that an interruption left unfinished is left out."""
    return [ReachRow(**data) for _, data in whole_lines(file)]


def table(rows: list[ReachRow]) -> str:
    """By kind and together: within reach, whole range, opened in the simulator, tries."""
    lines = []
    for kind in ("prismatic", "revolute", "both"):
        of = [row for row in rows if kind in (row.kind, "both")]
        if not of:
            continue
        tried = [bool(row.opened) for row in of if row.opened is not None or not row.grasps]
        simulated = any(row.opened is not None for row in of)
        lines.append(
            [
                kind,
                str(len(of)),
                percent(share([row.grasps > 0 for row in of])),
                percent(share([row.whole for row in of])),
                percent(share(tried)) if simulated else "",
                f"{sum((row.handles + 1) / 2 for row in of) / len(of):.2f}",
            ]
        )
    header = ["kind", "objects", "5 cm or 5 deg within reach, %", "whole range, %"]
    return markdown([*header, "opened in the simulator, %", "tries"], lines)


def failures(rows: list[ReachRow]) -> str:
    """Every object that cannot be opened, with the reason."""
    lines = [
        [row.name, row.family, row.handle, str(row.reason)]
        for row in rows
        if not row.grasps or row.opened is False
    ]
    return markdown(["object", "family", "handle", "reason"], lines)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", choices=sorted(SUITES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--limit", type=int, help="stop after so many new trials")
    parser.add_argument("--out", type=Path, default=Path("runs/published-reach"))
    arguments = parser.parse_args()
    note_run(arguments.out, SimulatorConfig())
    way = "simulated" if arguments.simulate else "kinematics"
    file = arguments.out / f"{arguments.suite}-{arguments.seed}-{way}.jsonl"
    done = {row.name for row in read_rows(file)}
    names = [f"{arguments.suite}/{name}" for name in SUITES[arguments.suite].names()]
    missing = [name for name in names if name not in done]
    for k, name in enumerate(missing[: arguments.limit], 1):
        row = run_trial(name, arguments.seed, arguments.simulate)
        append_line(file, json.dumps(asdict(row)))
        said = row.reason or "within reach"
        print(f"{k} of {len(missing)}: {name}: {said}", file=sys.stderr, flush=True)
    rows = read_rows(file)
    print(table(rows), failures(rows), sep="\n\n")


if __name__ == "__main__":
    main()
