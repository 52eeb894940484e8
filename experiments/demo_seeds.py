"""How often does the demo reach its target, and are its bounds true?

    python -m experiments.demo_seeds --seeds 10 --out runs/demo-seeds

Runs `akm-fg demo` for doors and drawers of ten seeds, one process a run, and keeps one JSON row a
run; runs that are there already are not done again. Prints a table; feeds "Measured" in the
README. About ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from akm_fg.report.score import axis_angle_rad, point_line_distance_m


def run_trial(kind: str, seed: int, out: Path) -> dict[str, Any]:
    """One demo in its own process; its row, read back if it was run before."""
    row_file = out / f"{kind}-{seed}.json"
    if not row_file.exists() or not row_file.read_text():
        command = [sys.executable, "-m", "akm_fg.cli.main", "demo", "--object", kind]
        command += ["--seed", str(seed), "--out", str(out / "runs"), "--json", str(row_file)]
        subprocess.run(command, check=False, capture_output=True)
    text = row_file.read_text() if row_file.exists() else ""
    if not text:
        return {"object": kind, "seed": seed, "failure": "the demo wrote no result"}
    row: dict[str, Any] = json.loads(text)
    return row


def errors(row: dict[str, Any]) -> dict[str, float]:
    """Errors of a row and their ratios to the claimed standard deviations."""
    joint, truth = row["posterior"]["joint"], row["truth"]
    axis, true_axis = np.array(joint["axis"]), np.array(truth["axis"])
    axis_deg = float(np.degrees(axis_angle_rad(axis, true_axis)))
    found = {
        "axis_deg": axis_deg,
        "axis_ratio": axis_deg / joint["axis_sd_deg"],
        "final": abs(truth["final_state"] - row["target"]) / abs(row["target"]),
        "state_ratio": (row["state"]["mean"] - truth["final_state"]) / row["state"]["sd"],
    }
    if truth["pivot"] is not None and joint["pivot"] is not None:
        pivot, on_axis = np.array(joint["pivot"]), np.array(truth["pivot"])
        pivot_m = point_line_distance_m(pivot, on_axis, true_axis)
        found |= {"pivot_m": pivot_m, "pivot_ratio": pivot_m / joint["pivot_sd_m"]}
    return found


def summary(name: str, rows: list[dict[str, Any]]) -> str:
    """Shares with 95 % Clopper-Pearson intervals, medians of errors."""
    done = [row for row in rows if row.get("posterior")]
    right = sum(row["posterior"]["kind"] == row["truth"]["kind"] for row in done)
    found = [errors(row) for row in done if row["posterior"]["kind"] == row["truth"]["kind"]]
    reached = sum(e["final"] <= 0.1 for e in found)
    low, high = stats.binomtest(reached, len(rows)).proportion_ci(0.95)
    lines = [
        f"{name}: kind right {right} of {len(rows)}; final state within 10 % of the commanded "
        f"distance {reached} of {len(rows)} (95 % interval {low:.2f} to {high:.2f})"
    ]
    for key in ("axis_deg", "pivot_m", "final", "axis_ratio", "pivot_ratio", "state_ratio"):
        values = np.abs([e[key] for e in found if key in e])
        if values.size:
            lines.append(f"  {key}: median {np.median(values):.4g}, largest {values.max():.4g}")
    seconds = [row["time_s"]["total"] for row in done]
    lines.append(f"  seconds: median {np.median(seconds):.0f}, largest {max(seconds):.0f}")
    lines += [f"  seed {row['seed']}: {row['failure']}" for row in rows if row.get("failure")]
    return "\n".join(lines)


def main() -> None:
    """Run what is missing and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/demo-seeds"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for kind in ("door", "drawer"):
        rows = []
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
            rows.append(run_trial(kind, seed, arguments.out))
            print(f"{kind} {seed}: {rows[-1]['failure'] or 'reached'}", file=sys.stderr)
        print(summary(kind, rows))


if __name__ == "__main__":
    main()
