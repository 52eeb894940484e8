"""Reliability of kinds on its smallest configuration."""

import numpy as np

from experiments.claims.reliability import (
    METHOD,
    ReliabilityConfig,
    figure,
    is_right,
    make_tracks,
    run,
    table,
    wrong_table,
)


def test_kinds_and_travels_are_drawn_from_the_priors():
    truths = [make_tracks(seed)[1] for seed in range(300)]
    turning = [truth for truth in truths if truth.kind == "revolute"]
    assert 100 < len(turning) < 180
    metres = np.array([truth.states.max() * 0.2 for truth in turning])
    assert metres.max() <= 0.5
    assert 0.01 < np.median(metres) < 0.04  # of log-uniform travels 2.2 cm, mostly gone through


def test_trials_are_run_once_tabled_and_drawn(tmp_path):
    config = ReliabilityConfig(runs=4, first_seed=0, folder=tmp_path)
    rows = run(config)
    assert run(config) == rows and len(rows) == 4
    assert "| most probable |" in table(rows)
    assert wrong_table(rows).startswith("| seed |")
    figure(rows, tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").stat().st_size > 5000
    assert (tmp_path / f"{METHOD}.jsonl").exists()


def test_rest_is_right_of_what_moved_by_less_than_a_centimetre(tmp_path):
    (row,) = run(ReliabilityConfig(runs=1, first_seed=0, folder=tmp_path))
    moved = row.travel * (0.4 if row.kind_true == "revolute" else 1.0)
    assert is_right(row, row.kind_true)
    assert is_right(row, "rigid") == (moved < 0.01)
