"""The grid of pose logs on its smallest configuration."""

from experiments.claims import pose_logs
from experiments.claims.pose_logs import CELLS, PoseLogsConfig, make_log, run, table


def test_a_log_is_that_of_its_cell():
    cell = next(c for c in CELLS if c.kind == "prismatic" and c.noise_deg is None)
    poses, truth = make_log(1, cell)
    assert poses.p_world.shape == (cell.rows, 3)
    assert poses.R_world_part is None and truth.pivot is None
    assert truth.states[-1] == cell.travel / 100


def test_trials_are_run_once_and_tabled(tmp_path, monkeypatch):
    monkeypatch.setattr(pose_logs, "CELLS", CELLS[:2])
    rows = run(PoseLogsConfig(runs=1, first_seed=0, folder=tmp_path))
    assert [row.kind for row in rows] == ["revolute", "revolute"]
    assert all(row.consistency.axis_inside95 is not None for row in rows)
    assert "| all | 2 |" in table(rows, "pose logs")
    assert run(PoseLogsConfig(runs=1, first_seed=0, folder=tmp_path)) == rows
