"""Whether the covariance tells the truth: NEES over many openings, and a case worked on paper."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.geometry.rigid_motion import RigidMotionConfig
from factors.finite_differences import central_difference

SIGMA_M = 0.003  # of every coordinate in the openings
# The noise as given, and no track rejected.
GAUSSIAN = replace(
    FitConfig(),
    dof=1e6,
    noise_prior_observations=1e9,
    rigid_motion=RigidMotionConfig(inlier_sigmas=100.0),
)
# Frames below eight and points below eight are too few to look for correlations in.

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
    N, sigma = 200, SIGMA_M
    truth = opening(0, "prismatic", points=N)
    fit = fit_tracks(truth.tracks, config=GAUSSIAN).best
    var_w = sigma**2 / (N * ((truth.q - truth.q.mean()) ** 2).sum())
    assert_allclose(fit.states.sd[0], 0.0)
    assert_allclose(fit.states.sd[1:] ** 2, 2 * sigma**2 / N, rtol=0.06)
    assert_allclose(fit.joint.cov[:2, :2], np.eye(2) * var_w, rtol=0.06, atol=0.06 * var_w)


def test_evidence_of_rigid_is_the_integral_worked_on_paper(opening):
    """A coordinate seen T times: (2 pi s^2)^(-(T-1)/2) T^(-1/2) exp(-sum (p - mean)^2 / 2s^2)."""
    still = opening(0, "prismatic", travel=0.0, points=7, frames=6)
    p, T = still.tracks.p_world, 6
    misfit = ((p - p.mean(axis=0)) ** 2).sum() / SIGMA_M**2
    want = -0.5 * misfit - 21 * ((T - 1) / 2 * np.log(2 * np.pi * SIGMA_M**2) + np.log(T) / 2)
    posterior = fit_tracks(still.tracks, config=GAUSSIAN)
    assert posterior.fit.tracks_rejected == 0
    assert_allclose(posterior.alternatives["rigid"].log_evidence, want, atol=0.05)


def test_evidence_of_a_drawer_is_laplaces_over_axis_states_and_points(opening):
    """Dense: all residuals stacked, the whole Hessian by differences, one determinant.

    Priors: axis uniform on the half sphere, points flat, states uniform over a travel that is
    log-uniform from a millimetre to a metre, with state zero anywhere in it.
    """
    truth = opening(0, "prismatic", points=7, frames=6)
    p, (T, N, _) = truth.tracks.p_world, truth.tracks.p_world.shape
    posterior = fit_tracks(truth.tracks, config=GAUSSIAN)
    assert posterior.fit.tracks_rejected == 0
    fit = posterior.alternatives["prismatic"]
    R, q = fit.joint.T_world_joint[:3, :3], fit.states.mean
    x = (p - q[:, None, None] * R[:, 2]).mean(axis=0)

    def residual(delta):
        axis = R @ gtsam.Rot3.Expmap(np.array([delta[0], delta[1], 0.0])).matrix()[:, 2]
        states = q + np.concatenate([[0.0], delta[2 : T + 1]])
        moved = x + delta[T + 1 :].reshape(N, 3)
        return ((p - moved - states[:, None, None] * axis) / SIGMA_M).ravel()

    zero = np.zeros(T + 1 + 3 * N)
    J, r = central_difference(residual, zero), residual(zero)
    want = (
        -0.5 * r @ r
        - r.size * np.log(SIGMA_M * np.sqrt(2 * np.pi))
        - np.log(2 * np.pi)
        + zero.size / 2 * np.log(2 * np.pi)
        - 0.5 * np.linalg.slogdet(J.T @ J)[1]
        - (T - 1) * np.log(np.ptp(q))
        - np.log((T - 1) * T * np.log(1000.0))
    )
    assert_allclose(fit.log_evidence, want, atol=0.05)


def test_noise_that_lasts_some_frames_is_counted_once_not_once_a_frame(opening, score):
    """AR(1) noise, correlation 0.7 from frame to frame: 5.7 frames count as one."""
    nees, dof, times = 0.0, 0, []
    for seed in range(6):
        clean = opening(seed, "revolute", points=20, frames=40, noise_m=0.0, steady=True)
        rng, p = np.random.default_rng(seed), clean.tracks.p_world
        noise = SIGMA_M * rng.normal(size=p.shape)
        for t in range(1, 40):
            noise[t] = 0.7 * noise[t - 1] + np.sqrt(1 - 0.7**2) * noise[t]
        p += noise
        posterior = fit_tracks(clean.tracks)
        error = score(posterior, clean)
        nees, dof = nees + error.nees, dof + error.dimensions
        times.append(posterior.fit.correlation_frames)
    assert 3.5 < np.median(times) < 9
    assert 0.4 < nees / dof < 1.8


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


def test_errors_of_the_sensor_widen_the_bounds_and_leave_the_kind(kind, opening):
    """Fitted states of 200 points: sigma^2/N to sigma^2/N + b^2/m and more; evidence untouched."""
    truth = opening(2, kind, points=200)
    without, with_errors = (fit_tracks(truth.tracks, systematic_m=b) for b in (0.0, 0.002))
    assert with_errors.kind == kind
    for name, alternative in without.alternatives.items():
        assert_allclose(with_errors.alternatives[name].log_evidence, alternative.log_evidence)
    n, modes = 200 * 20, FitConfig().systematic_modes
    # Noisier than sound tracks of recordings: their errors grow alike.
    sound = SIGMA_M * FitConfig().sound_noise_scale
    want = 1 + n * 0.002**2 / (modes * sound**2)
    ratio = with_errors.best.joint.axis_sd_rad / without.best.joint.axis_sd_rad
    assert_allclose(ratio**2, want, rtol=0.25)
