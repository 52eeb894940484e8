"""Are the probabilities of kinds true: of answers at 95 %, are 95 in 100 right?

    python -m experiments.claims.reliability --runs 10000 --first-seed 40000

Openings drawn from the estimator's priors: kind (hinge and drawer 0.468 each, rest 0.06, screw
0.004), travel log-uniform from a millimetre to half a metre; 4 to 80 tracks, 3 to 30 frames,
noise of 0.3 to 10 mm, known or not, a fifth of the tracks drifting in every other one. To say
rest of a part that moved by less than a centimetre is right: that is what it means
(docs/conventions.md). One row a trial in OUT/graph.jsonl, as it ends; what is there is not done
again. Prints how often the most probable kind was right by what it claimed, and the kinds that
were named and wrong; writes a diagram. About a twentieth of a second a trial.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from akm_fg.errors import AkmError
from akm_fg.estimation.fit import fit_tracks
from akm_fg.records import JointTruth, KindName, PointTracks
from experiments.pages.figures import COLOURS, new_figure, save
from experiments.pages.tables import markdown, percent
from experiments.rows.provenance import note_run
from experiments.rows.rows import Key, TrialRow, fill, keys, read_rows, trial_row
from experiments.scores.answers import answer_of_posterior, failed
from experiments.scores.statistics import share
from experiments.trials.openings import PANEL_M, make_opening

METHOD, CELL = "graph", "random"
KINDS: tuple[KindName, ...] = ("revolute", "prismatic", "helical", "rigid")
SHARES = (0.468, 0.468, 0.004, 0.06)  # of the trials, as in `PriorConfig`
TRAVEL_M = (0.001, 0.5)  # of the panel's middle, as in `PriorConfig` but for what no panel does
REST_M = 0.01  # `PriorConfig.motion_that_matters_m`
PITCH_M = 0.05  # standard deviation, `PriorConfig.pitch_sigma_m_per_rad`
LEVELS = (0.0, 0.5, 0.8, 0.95, 0.99, 0.999, 1.0)  # of the claimed probability


@dataclass(frozen=True, slots=True)
class ReliabilityConfig:
    """How much is run."""

    runs: int = 10_000
    first_seed: int = 40_000
    folder: Path = Path("runs/reliability")


def make_tracks(seed: int) -> tuple[PointTracks, JointTruth, bool]:
    """Tracks, their joint, and whether their noise is told."""
    rng = np.random.default_rng(seed)
    kind = KINDS[rng.choice(len(KINDS), p=SHARES)]
    travel = float(np.exp(rng.uniform(*np.log(TRAVEL_M))))
    travel /= 1.0 if kind == "prismatic" else PANEL_M / 2
    noise_m = float(np.exp(rng.uniform(np.log(3e-4), np.log(0.01))))
    opening = make_opening(
        [seed, 1],
        "prismatic" if kind == "prismatic" else "revolute",
        0.0 if kind == "rigid" else travel,
        points=int(rng.integers(4, 80)),
        frames=int(rng.integers(3, 30)),
        noise_m=noise_m,
        wild_share=float(rng.choice([0.0, 0.2])),
        claimed_m=noise_m,
    )
    tracks, q = opening.tracks, opening.q
    if kind == "helical":  # what a hinge does not: along its axis
        pitch = PITCH_M * float(rng.normal())
        along = (pitch * q)[:, None, None] * opening.axis
        tracks = PointTracks(tracks.p_world + along, tracks.cov_world)
    pivot = None if kind in ("prismatic", "rigid") else opening.T_world_joint[:3, 3]
    return tracks, JointTruth(kind, opening.axis, pivot, q), bool(rng.random() < 0.5)


def run_trial(key: Key) -> TrialRow:
    """One opening."""
    tracks, truth, told = make_tracks(key.seed)
    began = time.process_time()
    try:
        answer = answer_of_posterior(fit_tracks(tracks, key.cell, noise_known=told))
    except AkmError as problem:
        answer = failed(problem)
    return trial_row(key, truth, answer, time.process_time() - began)


def claimed(row: TrialRow) -> float | None:
    """Probability of the most probable kind; None where there is no answer."""
    return None if row.kind_probability is None else max(row.kind_probability.values())


def table(rows: Sequence[TrialRow]) -> str:
    """How often the most probable kind was right, by what it claimed; and named kinds alone."""
    lines = []
    for name, some in (("most probable", rows), ("named", [r for r in rows if _named(r)])):
        for low, high in pairwise(LEVELS):
            few = [(p, row) for row in some if (p := claimed(row)) is not None and low < p <= high]
            if few:
                right = [is_right(row, _most_probable(row)) for _, row in few]
                mean = 100 * float(np.mean([p for p, _ in few]))
                lines.append(
                    [name, f"{low:g} to {high:g}", str(len(few)), f"{mean:.2f}",
                     percent(share(right)), str(len(right) - sum(right))]
                )  # fmt: skip
    return markdown(["kind", "claimed", "trials", "mean claim, %", "right, %", "wrong"], lines)


def is_right(row: TrialRow, kind: str) -> bool:
    """Whether a kind is the true one, or rest of what moved by less than matters."""
    turns = row.kind_true in ("revolute", "helical")
    moved_m = row.travel * (PANEL_M if turns else 1.0)  # of the edge that moves most
    return kind == row.kind_true or (kind == "rigid" and moved_m < REST_M)


def _named(row: TrialRow) -> bool:
    return row.kind not in (None, "undecided")


def _most_probable(row: TrialRow) -> str:
    assert row.kind_probability is not None
    return max(row.kind_probability, key=row.kind_probability.__getitem__)


def wrong_table(rows: Sequence[TrialRow]) -> str:
    """Kinds that were named and wrong, the surest first."""
    wrong = [row for row in rows if _named(row) and not is_right(row, str(row.kind))]
    wrong = sorted(wrong, key=lambda row: -(claimed(row) or 0.0))
    lines = [
        [str(r.seed), r.kind_true, f"{r.travel:.4f}", str(r.kind), f"{claimed(r):.5f}"]
        for r in wrong
    ]
    return markdown(["seed", "true kind", "travel, rad or m", "named", "probability"], lines)


def figure(rows: Sequence[TrialRow], file: Path) -> None:
    """The diagram: share of right answers against what they claimed."""
    canvas, (ax,) = new_figure(1, 4.0)
    ax.plot([0, 100], [0, 100], color=COLOURS["bound"], lw=1, label="true probabilities")
    edges = np.array([0.25, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0])
    for low, high in pairwise(edges):
        few = [(p, r) for r in rows if (p := claimed(r)) is not None and low < p <= high]
        if len(few) >= 5:
            right = share([is_right(row, _most_probable(row)) for _, row in few])
            x = 100 * float(np.mean([p for p, _ in few]))
            bar = [[100 * (right.value - right.low)], [100 * (right.high - right.value)]]
            ax.errorbar([x], [100 * right.value], yerr=bar, fmt="o", color=COLOURS["graph"])
    ax.set(xlabel="claimed probability of the most probable kind, %", ylabel="right, %")
    ax.set(xlim=(40, 101), ylim=(40, 101))
    ax.legend(loc="lower right")
    save(canvas, file)


def run(config: ReliabilityConfig) -> list[TrialRow]:
    """All trials that are not there yet; returns those that were asked for."""
    note_run(config.folder, config)
    seeds = range(config.first_seed, config.first_seed + config.runs)
    wanted = list(keys([CELL], [METHOD], seeds))
    fill(config.folder / f"{METHOD}.jsonl", wanted, lambda batch: map(run_trial, batch))
    asked = set(wanted)
    return [row for row in read_rows(config.folder) if row.key in asked]


def main() -> None:
    """Run what is missing, print the tables, draw the diagram."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--first-seed", type=int, default=40_000)
    parser.add_argument("--out", type=Path, default=Path("runs/reliability"))
    arguments = parser.parse_args()
    rows = run(ReliabilityConfig(arguments.runs, arguments.first_seed, arguments.out))
    print(table(rows), wrong_table(rows), sep="\n\n")
    figure(rows, arguments.out / "reliability.png")


if __name__ == "__main__":
    main()
