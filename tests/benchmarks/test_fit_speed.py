"""Timings of the estimator: `make bench`."""

import pytest

from akm_fg.estimation.fit import fit_tracks
from experiments.openings import make_opening


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_fit_of_200_tracks_over_30_frames_all_kinds(benchmark, kind):
    opening = make_opening(0, kind, points=200, frames=30)
    posterior = benchmark(fit_tracks, opening.tracks)
    assert posterior.kind == kind
