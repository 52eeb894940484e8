"""Timings of the estimator: `make bench`."""

import pytest

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.surface_registration import SurfaceToRegister
from experiments.baselines.config import CoarseConfig
from experiments.trials.openings import make_opening
from experiments.trials.panel_camera import PanelCamera


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_fit_of_200_tracks_over_30_frames_all_kinds(benchmark, kind):
    opening = make_opening(0, kind, points=200, frames=30)
    posterior = benchmark(fit_tracks, opening.tracks)
    assert posterior.kind == kind


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_fit_of_tracks_and_five_surfaces_of_ten_thousand_readings(benchmark, kind):
    opening = make_opening(0, kind, points=200, frames=30)
    camera = PanelCamera(opening, 0)
    posterior = benchmark(fit_tracks, opening.tracks, sources=[SurfaceToRegister(camera)])
    assert posterior.kind == kind and len(posterior.fit.keyframes_registered) == 5


@pytest.mark.parametrize("method", ["graph", "paper"])
def test_the_papers_coarse_stage_on_the_same_tracks(benchmark, method):
    """Ratios to it stand in docs/speed.md (`python -m experiments.speed`)."""
    coarse = pytest.importorskip("experiments.baselines.coarse", reason="torch is not installed")
    opening = make_opening(0, points=200, frames=30)
    if method == "graph":
        benchmark(fit_tracks, opening.tracks)
    else:
        config = CoarseConfig(starts=100)
        benchmark.pedantic(coarse.coarse_estimate, (opening.tracks.p_world, 0, config), rounds=3)
