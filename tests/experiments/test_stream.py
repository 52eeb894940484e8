"""Stream against whole recording: how far apart they are, and how the tables say so."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.records import Recording
from experiments.stream import (
    Apart,
    StreamConfig,
    StreamRow,
    agreement_table,
    apart,
    played_on,
    read_rows,
    run,
    speed_table,
)
from factors.joint import Joint


def _whole(kind="revolute"):
    joint = JointPosterior(Joint(kind, np.eye(4), 0.0), np.diag([1e-4, 1e-4, 0, 1e-6, 1e-6, 0]))
    states = StatePosterior("rad", np.array([0.0, 0.5]), np.array([0.0, 0.01]))
    best = KindPosterior(joint, states, Evidence(0, 0, 0, 0))
    report = FitReport(0.0, 4, 0, 0.001, 1.0, 1.0, 1.0, True)
    return ArticulationPosterior("x", kind, {kind: 1.0}, {kind: best}, report)


def test_an_answer_is_apart_by_its_differences_over_the_wholes_deviations():
    """Axis tilted by 0.02 rad, known to 0.01; line 2 mm off, known to 1 mm; 0.03 rad of 0.01."""
    T = np.eye(4)
    c, s = np.cos(0.02), np.sin(0.02)
    T[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    T[0, 3] = 0.002
    joint = JointPosterior(Joint("revolute", T, 0.0), np.zeros((6, 6)))
    off = apart("revolute", joint, 0.53, _whole())
    assert_allclose([off.axis_sd, off.pivot_sd, off.state_sd], [2.0, 2.0, 3.0], rtol=1e-3)
    assert off.most == pytest.approx(3.0)


def test_other_kinds_are_not_measured_against_each_other():
    drawer = JointPosterior(Joint("prismatic", np.eye(4), 0.0), np.zeros((6, 6)))
    assert apart("prismatic", drawer, 0.1, _whole()) == Apart("prismatic")
    assert apart("undecided", None, None, _whole()).most is None


def _row(name, posterior, update, frames=20):
    return StreamRow(name, frames, 40, "revolute", update, posterior, [0.05] * frames, 1.5)


def test_the_tables_count_kinds_and_half_deviations():
    near, far = Apart("revolute", 0.1, 0.2, 0.4), Apart("revolute", 0.1, 2.5, 0.3)
    rows = [_row("a", near, far), _row("b", near, Apart("undecided"))]
    rows.append(_row("a, played on", near, near, frames=330))
    lines = agreement_table(rows).splitlines()
    assert "| posterior | 2 | 100.0" in lines[2] and lines[2].endswith("| 0.40 | 0 |")
    assert "| update | 2 | 50.0" in lines[3] and lines[3].endswith("| 2.50 | 1 |")
    early, late = speed_table(rows).splitlines()[2:]
    assert early == "| first 30 | 70 | 50 | 50 | 50 | 1500 |"
    assert late == "| beyond 300 | 30 | 50 | 50 | 50 | 1500 |"


def test_a_recording_is_played_to_and_fro(tmp_path):
    record = pytest.importorskip("experiments.rendered_recordings")
    from akm_fg.io.recording import read_recording

    config = record.RecordingConfig(frames=8, travel_cm=(10.0, 10.0))
    record.record("furniture-dev/drawer-004", config, tmp_path / "drawer")
    short = read_recording(tmp_path / "drawer")
    long = played_on(short, 20)
    assert isinstance(long, Recording) and len(long.frames) == 20
    assert (np.diff([frame.stamp_s for frame in long.frames]) > 0).all()
    shown = [next(k for k, f in enumerate(short.frames) if f.rgb is g.rgb) for g in long.frames]
    assert shown == [0, 1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5]
    settings = StreamConfig(tmp_path, long_every=0, out=tmp_path / "rows")
    assert run(settings) == 1 and run(settings) == 0
    (row,) = read_rows(tmp_path / "rows")
    assert row.kind == row.posterior.kind == "prismatic" and len(row.frame_s) == 8
    assert row.posterior.most == pytest.approx(0.0, abs=1e-6)  # one code for both
