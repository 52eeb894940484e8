"""Whether the covariance tells the truth: NEES over many openings, and a case worked on paper."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks

# kind, travel, largest median axis error in degrees
CELLS = [
    ("revolute", np.deg2rad(15), 0.75),
    ("revolute", np.deg2rad(40), 0.28),
    ("prismatic", 0.15, 0.20),
]


def _run(opening, score, runs, kind, travel, wild_share=0.0):
    """Posteriors and scores of openings with seeds 0, 1, ..."""
    truths = [opening(seed, kind, travel, wild_share=wild_share) for seed in range(runs)]
    posteriors = [fit_tracks(truth.tracks) for truth in truths]
    return posteriors, [score(p, t) for p, t in zip(posteriors, truths, strict=True)]


@pytest.fixture(scope="module", params=CELLS[1:], ids=["door", "drawer"])
def forty_runs(request, opening, score):
    kind, travel, limit_deg = request.param
    return (kind, limit_deg, *_run(opening, score, 40, kind, travel))


def _assert_nees(scores, level=0.95):
    dof = sum(s.dimensions for s in scores)
    low, high = stats.chi2.interval(level, dof)
    assert low / dof <= sum(s.nees for s in scores) / dof <= high / dof


def _median_axis_error_deg(scores):
    return np.degrees(np.median([s.axis_error_rad for s in scores]))


def test_forty_openings_have_a_joint_nees_inside_its_band(forty_runs):
    _assert_nees(forty_runs[3])


def test_forty_openings_have_their_kinds_right(forty_runs):
    kind, _, posteriors, _ = forty_runs
    assert [p.kind for p in posteriors] == [kind] * 40


def test_forty_openings_have_a_state_nees_inside_its_band(forty_runs):
    """Of one frame a run: the states of a run share the noise of frame 0."""
    _, _, posteriors, scores = forty_runs
    fits = [p.best.states for p in posteriors]
    nees = sum((s.state_error[-1] / f.sd[-1]) ** 2 for s, f in zip(scores, fits, strict=True))
    low, high = stats.chi2.interval(0.95, 40)
    assert low <= nees <= high


def test_forty_openings_have_small_axis_errors(forty_runs):
    assert _median_axis_error_deg(forty_runs[3]) <= 1.3 * forty_runs[1]


def test_bounds_hold_the_truth_as_often_as_they_say(forty_runs):
    """19 of 20: of forty, 33 or fewer have probability 0.003."""
    _, _, posteriors, scores = forty_runs
    bounds = [p.best.joint.axis_bound_rad(0.95) for p in posteriors]
    assert sum(s.axis_error_rad <= b for s, b in zip(scores, bounds, strict=True)) > 33


def test_covariance_of_a_drawer_is_the_one_worked_on_paper(opening):
    """N points, T frames: var q_t = 2 sigma^2/N; var w = sigma^2 / (N sum (q_t - mean q)^2).

    A straight line fitted to the mean points of the frames, whose first is as noisy as the rest.
    """
    N, sigma = 200, 0.003
    truth = opening(0, "prismatic", points=N)
    config = replace(FitConfig(), dof=1e6, noise_prior_observations=1e9)  # Gaussian, noise given
    fit = fit_tracks(truth.tracks, config=config).best
    var_w = sigma**2 / (N * ((truth.q - truth.q.mean()) ** 2).sum())
    assert_allclose(fit.states.sd[0], 0.0)
    assert_allclose(fit.states.sd[1:] ** 2, 2 * sigma**2 / N, rtol=0.06)
    assert_allclose(fit.joint.cov[:2, :2], np.eye(2) * var_w, rtol=0.06, atol=0.06 * var_w)


def test_covariance_shrinks_with_the_number_of_points(kind, opening):
    few, many = (
        fit_tracks(opening(1, kind, points=n).tracks).best.joint.axis_sd_rad for n in (20, 180)
    )
    assert 2.0 < few / many < 4.5


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "travel", "limit_deg"), CELLS, ids=["15 deg", "40 deg", "15 cm"])
def test_two_hundred_openings_have_their_nees_in_its_band_and_small_axis_errors(
    kind, travel, limit_deg, opening, score
):
    posteriors, scores = _run(opening, score, 200, kind, travel)
    assert np.mean([p.kind == kind for p in posteriors]) >= 0.99
    assert _median_axis_error_deg(scores) <= limit_deg
    _assert_nees(scores)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "travel", "limit_deg"), CELLS, ids=["15 deg", "40 deg", "15 cm"])
def test_one_track_in_five_drifting_at_most_doubles_the_axis_error(
    kind, travel, limit_deg, opening, score
):
    posteriors, scores = _run(opening, score, 200, kind, travel, wild_share=0.2)
    assert np.mean([p.kind == kind for p in posteriors]) >= 0.97
    assert _median_axis_error_deg(scores) <= 2 * limit_deg
