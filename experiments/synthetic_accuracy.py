"""How accurate is a fit of noisy tracks, and are its covariances true?

    python -m experiments.synthetic_accuracy --runs 200

40 points on a 0.4 x 0.4 m panel, 20 frames, 3 mm noise, states at random along the travel; clean,
and with 20 % of the tracks drifting by 2 cm a frame. Writes a table to standard output; feeds
"Measured" in the README. About four minutes on one core.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from scipy import stats

from akm_fg.estimation.fit import fit_tracks
from experiments.openings import make_opening, score_opening

CELLS: tuple[tuple[str, str, float], ...] = (
    ("door 15 deg", "revolute", float(np.deg2rad(15))),
    ("door 40 deg", "revolute", float(np.deg2rad(40))),
    ("drawer 15 cm", "prismatic", 0.15),
)


@dataclass(frozen=True, slots=True)
class Trial:
    """One run."""

    kind_right: bool
    axis_error_deg: float
    pivot_error_m: float
    nees: float
    dimensions: int
    axis_in_bound: bool
    seconds: float


def run_trial(seed: int, kind: str, travel: float, wild_share: float) -> Trial:
    """One opening, fitted and scored; pure in its seed."""
    opening = make_opening(seed, kind, travel, wild_share=wild_share)
    posterior = fit_tracks(opening.tracks)
    error, joint = score_opening(posterior, opening), posterior.alternatives[kind].joint
    assert joint is not None
    return Trial(
        kind_right=posterior.kind == kind,
        axis_error_deg=float(np.degrees(error.axis_error_rad)),
        pivot_error_m=error.pivot_error_m,
        nees=error.nees,
        dimensions=error.dimensions,
        axis_in_bound=error.axis_error_rad <= joint.axis_bound_rad(),
        seconds=posterior.time_s["total"],
    )


def row(name: str, trials: list[Trial]) -> str:
    """A line of the table: medians, mean NEES per degree of freedom with its 95 % band."""
    dof = sum(t.dimensions for t in trials)
    low, high = stats.chi2.interval(0.95, dof)
    nees = sum(t.nees for t in trials) / dof
    share = np.mean([t.axis_in_bound for t in trials])
    return (
        f"| {name} | {np.median([t.axis_error_deg for t in trials]):.3f} "
        f"| {1e3 * np.median([t.pivot_error_m for t in trials]):.1f} "
        f"| {np.mean([t.kind_right for t in trials]):.3f} "
        f"| {nees:.2f} ({low / dof:.2f} to {high / dof:.2f}) | {share:.3f} "
        f"| {1e3 * np.median([t.seconds for t in trials]):.0f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    arguments = parser.parse_args()
    print(
        "| cell | axis error, deg | pivot error, mm | kind right | NEES per dof (95 % band) ",
        end="",
    )
    print("| axis inside its 95 % bound | ms |\n|---|---|---|---|---|---|---|")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    for name, kind, travel in CELLS:
        for wild_share in (0.0, 0.2):
            trials = [run_trial(seed, kind, travel, wild_share) for seed in seeds]
            print(row(name + (", 20 % drifting" if wild_share else ""), trials), flush=True)


if __name__ == "__main__":
    main()
