"""Runs `ripl-articulation` (BSD-3-Clause) inside its own environment, .venv-peer.

    .venv-peer/bin/python experiments/peers/ripl_runner.py INPUT.npz OUTPUT.npz

Stands alone: it imports the peer and numpy, nothing of this project. INPUT has, for every opening
i, `T_world_part_i` (T, 4, 4) and `prior_i` (6,), the twist it starts from; OUTPUT has `twist_i`
(6,), rotation first, in the part's first frame, `theta_i` (T,) and `seconds_i`, or `error_i`, the
text of what the peer raised. `T_world_part_t = T_world_part_0 Exp(twist theta_t)`.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from numpy.typing import NDArray
from ripl_articulation import solve_articulation_from_poses

Array = NDArray[np.float64]


def solve(T_world_part: Array, prior: Array) -> tuple[Array, Array, float]:
    """Twist (6,), thetas (T,) and seconds of one opening; the resting frame is its first pose."""
    began = time.perf_counter()
    resting = np.repeat(T_world_part[:1], len(T_world_part), axis=0)
    twist, theta = solve_articulation_from_poses(resting, T_world_part, prior_xi=prior)
    return twist, theta, time.perf_counter() - began


def main() -> None:
    """Solve every opening of the input file."""
    source, target = sys.argv[1:]
    results: dict[str, NDArray] = {}
    with np.load(source, allow_pickle=False) as data:
        for i in range(int(data["count"])):
            try:
                twist, theta, seconds = solve(data[f"T_world_part_{i}"], data[f"prior_{i}"])
            except RuntimeError as problem:  # what GTSAM raises when a system cannot be solved
                results[f"error_{i}"] = np.array(str(problem))
            else:
                results[f"twist_{i}"], results[f"theta_{i}"] = twist, theta
                results[f"seconds_{i}"] = np.array(seconds)
    np.savez(target, **results)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
