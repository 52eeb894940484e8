"""Recordings are tiny here and the fits are stood in for; the slow test renders and fits one."""

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import NoMotionObserved
from akm_fg.estimation.fit import fit_tracks
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.perception.moving_part.part_mask import PartMask
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from experiments.pages.tables import NoRows
from experiments.rows.rows import read_rows
from experiments.scores.scoring import Errors
from experiments.surface_gain import (
    METHODS,
    SurfaceGainConfig,
    failures_table,
    gain_figure,
    gain_table,
    kinds_table,
    run,
)
from experiments.trials.cells import Cell
from experiments.trials.part_clouds import masked_points
from experiments.trials.recording_methods import GRAPH

OPENING = Cell("door", 40.0).opening(0)


@dataclass(frozen=True)
class Fitted:
    """As much of a fit of a recording as is looked at."""

    posterior: object


@pytest.fixture
def frame():
    """Depth 2 m, 4 x 3 pixels; the camera stands at (1, 0, 0) and looks along world x."""
    camera = PinholeCamera(4, 3, 10.0, 10.0, 1.0, 1.0)
    depth = np.full((3, 4), 2.0, dtype=np.float32)
    depth[0, 0] = np.nan
    R = gtsam.Rot3(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]))
    T_world_cam = gtsam.Pose3(R, np.array([1.0, 0, 0]))
    return RgbdFrame(0.0, np.zeros((3, 4, 3), np.uint8), depth, camera, T_world_cam)


@pytest.fixture
def recordings(tmp_path, frame):
    """A folder with two recordings, whose truth is that of an opening, and one without an end."""
    folder = tmp_path / "recordings"
    for name in ("door-1", "door-2", "door-3.part"):
        with RecordingWriter(folder / name) as writer:
            for k in range(OPENING.q.size):
                writer.add(
                    RgbdFrame(float(k), frame.rgb, frame.depth_m, frame.camera, frame.T_world_cam)
                )
            writer.set_truth(OPENING.truth)
    return folder


def test_sources_are_passed_on_failures_are_rows_and_nothing_is_run_twice(recordings, tmp_path):
    """Fits give the opening's own posterior; what they were asked to use is noted."""
    sources_seen = []

    def fit(recording, seed, sources):
        sources_seen.append((recording.name, sources))
        if sources == "surface":
            raise NoMotionObserved("nothing moved")
        return Fitted(fit_tracks(OPENING.tracks))

    config = SurfaceGainConfig(recordings, methods=GRAPH, out=tmp_path / "rows")
    assert run(config, fit) == 6
    assert [sources for _, sources in sources_seen] == ["tracks", "surface", "both"] * 2
    assert run(config, fit) == 0
    rows = {(row.cell, row.method): row for row in read_rows(config.out)}
    assert rows["door-1", "graph-surface"].failure == "NoMotionObserved: nothing moved"
    assert rows["door-2", "graph-both"].within(1.0)
    assert rows["door-2", "graph-both"].consistency.nees_joint > 0


def test_a_recording_that_is_still_made_is_left_alone_and_the_number_is_limited(recordings):
    assert [f.name for f in SurfaceGainConfig(recordings).folders()] == ["door-1", "door-2"]
    assert len(SurfaceGainConfig(recordings, limit=1).folders()) == 1


def test_a_folder_without_recordings_is_said_so(tmp_path):
    with pytest.raises(NoRows, match="no recordings"):
        SurfaceGainConfig(tmp_path).folders()


def test_asr_counts_kind_axis_and_distance_at_each_limit(a_row):
    errors = [(0.5, 0.004), (0.5, 0.03), (4.0, 0.001), (15.0, 0.001)]
    rows = [
        a_row(cell=str(i), method="graph-both", errors=Errors(e, None, d))
        for i, (e, d) in enumerate(errors)
    ]
    line = gain_table(rows).splitlines()[2].split("|")
    assert [cell.split()[0] for cell in line[5:9]] == ["25.0", "75.0", "75.0", "100.0"]
    assert "25.0" in kinds_table(rows)
    assert failures_table(rows).count("revolute | revolute") == 3


def test_figure_is_made_of_rows(a_row, tmp_path):
    rows = [a_row(cell="r", method=method) for method in METHODS]
    gain_figure(rows, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_points_of_a_mask_are_its_pixels_with_depth_in_the_world(frame):
    """Pixel (u, v) = (3, 2): 2 m deep, (3 - 1) / 10 * 2 = 0.4 right, 0.2 down."""
    moving = np.zeros((3, 4), bool)
    moving[0, 0] = moving[2, 3] = True
    mask = PartMask(0, moving, ~moving)
    points = masked_points(Recording("r", (frame,)), mask, np.random.default_rng(0))
    assert_allclose(points, [[3.0, -0.4, -0.2]], atol=1e-6)


@pytest.mark.slow
def test_all_methods_on_a_rendered_recording(tmp_path):
    pytest.importorskip("torch")
    from experiments.rendered_recordings import RecordingConfig, record

    record("furniture-dev/drawer-004", RecordingConfig(frames=8), tmp_path / "drawer-004")  # wood
    config = SurfaceGainConfig(tmp_path, starts=4, out=tmp_path / "rows")
    assert run(config) == 5
    rows = read_rows(config.out)
    assert {row.method for row in rows} == set(METHODS)
    assert all(row.failure is None and row.kind_true == "prismatic" for row in rows)
    assert all(row.errors.axis_error_deg < 10 for row in rows)
