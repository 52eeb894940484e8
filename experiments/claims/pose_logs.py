"""Are the kinds and the 95 % regions of pose logs true, whatever their noise?

    python -m experiments.claims.pose_logs --runs 20 --first-seed 30000

A marker on a handle half a metre from the hinge, over a grid: a hinge or a drawer; short or long
travel; 30 or 120 rows; 0.2, 1 and 5 mm; 0.05, 0.5 and 3 deg, or positions alone. Noise is white:
that is what the regions are asked to hold for. One row a trial in OUT/graph.jsonl, as it ends; what
is there is not done again. Prints a table a noise and one of the whole. A trial takes 0.1 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import AkmError
from akm_fg.estimation.fit import fit_poses
from akm_fg.records import JointTruth, PoseTrack
from experiments.pages.covered import QUANTITIES, inside_columns
from experiments.pages.tables import grouped, markdown, percent
from experiments.rows.provenance import note_run
from experiments.rows.rows import Key, TrialRow, fill, keys, read_rows, trial_row
from experiments.scores.answers import answer_of_posterior, failed
from experiments.scores.statistics import share

METHOD = "graph"
TRAVELS = (("revolute", 30.0), ("revolute", 90.0), ("prismatic", 15.0), ("prismatic", 40.0))
ROWS = (30, 120)
NOISES_MM = (0.2, 1.0, 5.0)
NOISES_DEG = (0.05, 0.5, 3.0, None)  # None: positions alone
HANDLE_M = (0.5, 0.0, 0.1)  # of the marker in the joint's frame


@dataclass(frozen=True, slots=True)
class Cell:
    """One place of the grid."""

    kind: str
    travel: float  # degrees or centimetres
    rows: int
    noise_mm: float
    noise_deg: float | None

    @property
    def noise(self) -> str:
        """Both levels."""
        turned = "no orientation" if self.noise_deg is None else f"{self.noise_deg:g} deg"
        return f"{self.noise_mm:g} mm, {turned}"

    @property
    def name(self) -> str:
        """Of the cell."""
        unit = "deg" if self.kind == "revolute" else "cm"
        return f"{self.kind} {self.travel:g} {unit}, {self.rows} rows, {self.noise}"


CELLS = [
    Cell(kind, travel, rows, mm, deg)
    for mm in NOISES_MM
    for deg in NOISES_DEG
    for kind, travel in TRAVELS
    for rows in ROWS
]


@dataclass(frozen=True, slots=True)
class PoseLogsConfig:
    """How much is run."""

    runs: int = 20
    first_seed: int = 30_000
    folder: Path = Path("runs/pose-logs")

    @property
    def seeds(self) -> range:
        """Of the trials."""
        return range(self.first_seed, self.first_seed + self.runs)


def make_log(seed: int, cell: Cell) -> tuple[PoseTrack, JointTruth]:
    """A marker that goes along a joint anywhere, at even speed."""
    rng = np.random.default_rng([seed, CELLS.index(cell)])
    T_world_joint = gtsam.Pose3(gtsam.Rot3.Expmap(rng.uniform(-1, 1, 3)), rng.uniform(-1, 1, 3))
    hinged = cell.kind == "revolute"
    q = np.linspace(0, np.radians(cell.travel) if hinged else cell.travel / 100, cell.rows)
    twist = np.array([0, 0, 1, 0, 0, 0] if hinged else [0, 0, 0, 0, 0, 1], dtype=float)
    marker = gtsam.Pose3(gtsam.Rot3.Expmap(rng.uniform(-1, 1, 3)), np.array(HANDLE_M))
    p, R = [], []
    for state in q:
        pose = T_world_joint * gtsam.Pose3.Expmap(state * twist) * marker
        p.append(pose.translation() + 1e-3 * cell.noise_mm * rng.normal(size=3))
        wobble = np.radians(cell.noise_deg or 0.0) * rng.normal(size=3)
        R.append(pose.rotation().retract(wobble).matrix())
    axis = T_world_joint.rotation().matrix()[:, 2]
    pivot = T_world_joint.translation() if hinged else None
    truth = JointTruth("revolute" if hinged else "prismatic", axis, pivot, q)
    return PoseTrack(np.array(p), None if cell.noise_deg is None else np.array(R)), truth


def run_trial(key: Key) -> TrialRow:
    """One log."""
    cell = next(cell for cell in CELLS if cell.name == key.cell)
    poses, truth = make_log(key.seed, cell)
    began = time.process_time()
    try:
        answer = answer_of_posterior(fit_poses(poses, key.cell))
    except AkmError as problem:
        answer = failed(problem)
    return trial_row(key, truth, answer, time.process_time() - began)


def table(rows: list[TrialRow], name: str) -> str:
    """Kinds and coverage by noise, and of all."""
    by_cell = {cell.name: cell.noise for cell in CELLS}
    groups = [*grouped(rows, lambda row: by_cell[row.cell]).items(), ("all", rows)]
    header = [name, "trials", "kind right, %", "wrong", "axis inside", "pivot", "last state"]
    return markdown(header, list(_lines(groups)))


def _lines(groups: list[tuple[str, list[TrialRow]]]) -> Iterator[list[str]]:
    asked = [quantity for quantity in QUANTITIES if quantity.name != "joint"]
    for name, rows in groups:
        yield [
            name,
            str(len(rows)),
            percent(share([row.kind_right for row in rows])),
            str(sum(row.confidently_wrong for row in rows)),
            *inside_columns(rows, asked),
        ]


def run(config: PoseLogsConfig) -> list[TrialRow]:
    """All trials that are not there yet; returns those that were asked for."""
    note_run(config.folder, config)
    wanted = list(keys([cell.name for cell in CELLS], [METHOD], config.seeds))
    fill(config.folder / f"{METHOD}.jsonl", wanted, lambda batch: map(run_trial, batch))
    return [row for row in read_rows(config.folder) if row.key in set(wanted)]


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=30_000)
    parser.add_argument("--out", type=Path, default=Path("runs/pose-logs"))
    arguments = parser.parse_args()
    rows = run(PoseLogsConfig(arguments.runs, arguments.first_seed, arguments.out))
    print(table(rows, "pose logs"))
    by_kind = {cell.name: f"{cell.kind} {cell.travel:g}, {cell.rows} rows" for cell in CELLS}
    print(
        markdown(
            ["travel", "trials", "kind right, %", "wrong", "axis inside", "pivot", "last state"],
            list(_lines(list(grouped(rows, lambda row: by_kind[row.cell]).items()))),
        )
    )


if __name__ == "__main__":
    main()
