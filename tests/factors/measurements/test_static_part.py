"""Static-part factor: the noise level of what stands still, and its true uncertainty."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.measurements.static_part import (
    latent_freedom,
    static_part_cost,
    static_part_factor,
    static_part_log_likelihood,
    static_scale,
)
from factors.measurements.track_cost import TrackObservations
from factors.student_t import log_normaliser, twice_negative_log_kernel

GAUSSIAN, ROBUST = 1e9, 4.0
SCALE = gtsam.symbol("s", 0)
SIGMA_M = 0.003
# Offsets from the best log_scale at which the factor is checked: no angle here to reach pi.
OFFSETS = {"zero": 0.0, "near zero": 1e-5, "generic": 0.3, "too small": -2.5, "too large": 4.0}


def _tracks(T=8, N=20, scale=1.0, lost=0.1, dof=np.inf, seed=0):
    """Noise of `scale` times the covariances given, Student-t of `dof`, and some frames lost."""
    rng = np.random.default_rng(seed)
    root = SIGMA_M * (np.eye(3) + 0.2 * rng.normal(size=(T, N, 3, 3)))
    noise = np.einsum("tnij,tnj->tni", root, rng.normal(size=(T, N, 3)))
    if np.isfinite(dof):
        noise /= np.sqrt(rng.chisquare(dof, (T, N, 1)) / dof)
    p = rng.uniform(-0.5, 0.5, (N, 3)) + scale * noise
    p[rng.random((T, N)) < lost] = np.nan
    return TrackObservations.from_points(p, root @ root.swapaxes(-1, -2))


def _values(log_scale):
    values = gtsam.Values()
    values.insert(SCALE, float(log_scale))
    return values


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
@pytest.mark.parametrize("offset", OFFSETS.values(), ids=OFFSETS.keys())
def test_gradient_is_that_of_the_cost(offset, dof):
    tracks = _tracks()
    at = _values(static_scale(tracks, dof).log_scale + offset)
    factor = static_part_factor(SCALE, tracks, dof)
    numeric = numeric_gradient(factor, at, [1], step=1e-4)
    assert_allclose(analytic_gradient(factor, at), numeric, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("dof", [GAUSSIAN, 30.0, ROBUST, 1.0])
@pytest.mark.parametrize("offset", np.linspace(-5, 5, 11))
def test_two_rows_carry_the_cost_at_any_scale(offset, dof):
    """`square_root_rows` needs a cost no smaller than what its own step would take off it."""
    tracks = _tracks()
    best = static_scale(tracks, dof)
    at = _values(best.log_scale + offset)
    factor = static_part_factor(SCALE, tracks, dof)
    here = static_part_cost(tracks, dof, best.log_scale + offset, best.x_world)
    spare = tracks.observed.sum() - latent_freedom(dof) * tracks.observed.shape[1]
    A, b = factor.linearize(at).jacobian()
    assert_allclose(b @ b, 2 * (here.cost - best.cost) + 3 * spare, rtol=1e-9)
    assert_allclose(A.T @ -b, here.gradient, rtol=1e-6, atol=1e-3)
    assert (A.T @ A)[0, 0] >= here.information * (1 - 1e-9)
    assert_allclose(factor.error(at), b @ b / 2)


def test_one_point_seen_twice_a_millimetre_apart():
    """By hand: squares add up to 2 * 0.5^2 in units of 1 mm, for one spare observation of 3."""
    p = np.array([[[0.001, 0.0, 0.0]], [[0.0, 0.0, 0.0]]])
    tracks = TrackObservations.from_points(p, np.full((2, 1, 1, 1), 1e-6) * np.eye(3))
    best = static_scale(tracks, GAUSSIAN)
    assert_allclose(best.log_scale, 0.5 * np.log(0.5 / 3), atol=1e-8)
    assert_allclose(best.log_scale_sd, 1 / np.sqrt(6), rtol=1e-6)
    assert_allclose(best.x_world[:, 0], [0.0005, 0.0, 0.0], atol=1e-9)
    values = _values(best.log_scale)
    assert_allclose(static_part_factor(SCALE, tracks, GAUSSIAN).error(values), 1.5)


def test_gaussian_scale_is_the_restricted_maximum_likelihood_estimate():
    """Against the residual mean square about weighted means, from full matrices."""
    rng = np.random.default_rng(3)
    p = rng.normal(size=(6, 4, 3)) * 0.002
    root = 0.001 * (np.eye(3) + 0.3 * rng.normal(size=(6, 4, 3, 3)))
    cov = root @ root.swapaxes(-1, -2)
    information = np.linalg.inv(cov)
    x = np.linalg.solve(information.sum(0), np.einsum("tnij,tnj->ni", information, p)[..., None])
    e = p - x[..., 0]
    chi2 = np.einsum("tni,tnij,tnj->", e, information, e)
    tracks = TrackObservations.from_points(p, cov)
    best = static_scale(tracks, GAUSSIAN)
    assert_allclose(np.exp(2 * best.log_scale), chi2 / (3 * 4 * 5), rtol=1e-6)
    assert_allclose(best.x_world.T, x[..., 0], atol=1e-8)
    # and its likelihood is the Gaussian one with flat latents
    expected = -0.5 * chi2 - 0.5 * np.linalg.slogdet(cov)[1].sum()
    expected += -0.5 * 3 * 24 * np.log(2 * np.pi) + 0.5 * 3 * 4 * np.log(2 * np.pi)
    expected -= 0.5 * np.linalg.slogdet(information.sum(0))[1].sum()
    assert_allclose(static_part_log_likelihood(tracks, GAUSSIAN, 0.0), expected, rtol=1e-6)


def test_likelihood_falls_with_the_factors_error():
    tracks = _tracks()
    best = static_scale(tracks, ROBUST).log_scale
    factor = static_part_factor(SCALE, tracks, ROBUST)
    for offset in (-0.7, 0.4):
        drop = static_part_log_likelihood(tracks, ROBUST, best) - static_part_log_likelihood(
            tracks, ROBUST, best + offset
        )
        rise = factor.error(_values(best + offset)) - factor.error(_values(best))
        assert_allclose(drop, rise, rtol=1e-6)


def _log_integral_over_place(p, cov, dof, scale):
    """Log of the integral of the Student-t likelihood over one point's place, on a grid."""
    line = np.linspace(-2.0, 2.0, 25) * np.sqrt(cov[0, 0])
    places = np.median(p, axis=0) + np.stack(np.meshgrid(line, line, line), -1).reshape(-1, 1, 3)
    e = p - places
    d2 = np.einsum("gti,ij,gtj->gt", e, np.linalg.inv(cov), e) / scale**2
    mode = log_normaliser(dof, 3) - 0.5 * np.linalg.slogdet(cov)[1] - 3 * np.log(scale)
    log_density = (mode - 0.5 * twice_negative_log_kernel(d2, dof, 3)).sum(axis=1)
    top = log_density.max()
    return top + np.log(np.exp(log_density - top).sum()) + 3 * np.log(line[1] - line[0])


def test_student_t_likelihood_is_the_integral_over_the_latent_places():
    """Laplace's approximation, here of twelve observations a point, against quadrature."""
    rng, dof, T, N = np.random.default_rng(5), 6.0, 12, 3
    cov = SIGMA_M**2 * (np.eye(3) + 0.2)
    noise = rng.normal(size=(T, N, 3)) @ np.linalg.cholesky(cov).T
    p = 0.3 + noise / np.sqrt(rng.chisquare(dof, (T, N, 1)) / dof)
    tracks = TrackObservations.from_points(p, np.tile(cov, (T, N, 1, 1)))
    best = static_scale(tracks, dof).log_scale
    scales = best + np.array([-0.1, 0.0, 0.1])
    exact = np.array(
        [
            sum(_log_integral_over_place(p[:, n], cov, dof, np.exp(s)) for n in range(N))
            for s in scales
        ]
    )
    got = np.array([static_part_log_likelihood(tracks, dof, s) for s in scales])
    assert_allclose(got, exact, atol=0.03 * N)  # of a nat a point
    assert_allclose(np.diff(got), np.diff(exact), atol=0.03 * N)


@pytest.mark.parametrize("dof", [GAUSSIAN, 30.0, ROBUST, 1.0])
@pytest.mark.parametrize("offset", [-8.0, -2.0, 2.0, 8.0])
def test_undamped_gauss_newton_steps_reach_the_optimum_from_afar(offset, dof):
    tracks = _tracks()
    best = static_scale(tracks, dof).log_scale
    factor, at = static_part_factor(SCALE, tracks, dof), best + offset
    for _ in range(60):
        A, b = factor.linearize(_values(at)).jacobian()
        at += (A.T @ b)[0] / (A.T @ A)[0, 0]
    assert_allclose(at, best, atol=1e-6)


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
@pytest.mark.parametrize("offset", [-5.0, 5.0])
def test_levenberg_marquardt_reaches_the_optimum_and_its_variance(offset, dof):
    tracks = _tracks(scale=2.5)
    best = static_scale(tracks, dof)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(static_part_factor(SCALE, tracks, dof))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    start = _values(best.log_scale + offset)
    result = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    assert_allclose(result.atDouble(SCALE), best.log_scale, atol=1e-4)
    variance = gtsam.Marginals(graph, result).marginalCovariance(SCALE)
    assert_allclose(variance[0, 0], best.log_scale_sd**2, rtol=1e-3)


def test_three_times_the_noise_is_a_scale_three_times_as_large():
    one, three = (static_scale(_tracks(scale=s), ROBUST).log_scale for s in (1.0, 3.0))
    assert_allclose(three - one, np.log(3.0), atol=1e-6)


def test_a_jumping_point_hardly_moves_the_scale():
    tracks = _tracks(N=40, lost=0.0)
    before = static_scale(tracks, ROBUST).log_scale
    tracks.p_world[3:, :, 5] += 0.2
    after = static_scale(tracks, ROBUST).log_scale
    assert abs(after - before) < 0.1


def test_points_seen_once_or_never_change_nothing():
    tracks = _tracks(lost=0.0)
    p = np.concatenate([tracks.p_world.swapaxes(1, 2), np.full((8, 2, 3), np.nan)], axis=1)
    p[4, -1] = [0.1, 0.2, 0.3]
    with_them = TrackObservations.from_points(p, np.tile(1e-5 * np.eye(3), (8, 22, 1, 1)))
    without = TrackObservations.from_points(p[:, :20], np.tile(1e-5 * np.eye(3), (8, 20, 1, 1)))
    got, expected = static_scale(with_them, ROBUST), static_scale(without, ROBUST)
    assert_allclose(got.log_scale, expected.log_scale, atol=1e-12)
    assert_allclose(got.log_scale_sd, expected.log_scale_sd)
    assert_allclose(
        static_part_log_likelihood(with_them, ROBUST, 0.1),
        static_part_log_likelihood(without, ROBUST, 0.1),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("T", "dof"), [(3, GAUSSIAN), (8, 6.0), (10, 6.0), (30, 4.0)])
def test_the_scale_errs_as_much_as_it_says(T, dof):
    noise_dof = np.inf if dof == GAUSSIAN else dof
    """From eight frames on; with fewer the latents' share is not exact (see the module)."""
    normalised = []
    for seed in range(300):
        best = static_scale(_tracks(T=T, N=40, dof=noise_dof, seed=seed), dof)
        normalised.append(best.log_scale / best.log_scale_sd)
    # 99.9 % band of the mean square of 300 standard normals: 0.75 to 1.30
    assert 0.75 < np.mean(np.square(normalised)) < 1.30


@pytest.mark.parametrize("dof", [0.0, -1.0, np.nan])
def test_a_dof_that_is_not_positive_is_refused(dof):
    with pytest.raises(ValueError, match=r"dof is .* expected > 0"):
        static_part_factor(SCALE, _tracks(), dof)


def test_points_seen_only_once_are_refused():
    with pytest.raises(ValueError, match="no point is observed twice"):
        static_part_factor(SCALE, _tracks(T=1, lost=0.0), ROBUST)


def test_exactly_repeated_observations_are_refused():
    p = np.tile(np.array([0.1, 0.2, 0.3]), (5, 3, 1))
    tracks = TrackObservations.from_points(p, np.tile(1e-6 * np.eye(3), (5, 3, 1, 1)))
    with pytest.raises(ValueError, match="0 of 15 observations differ"):
        static_part_factor(SCALE, tracks, ROBUST)


def test_cost_and_slope_match_differences_without_gtsam():
    tracks, best = _tracks(), static_scale(_tracks(), ROBUST)
    slope = central_difference(
        lambda s: [static_part_cost(tracks, ROBUST, float(s[0]), best.x_world).cost],
        np.array([best.log_scale + 0.5]),
        step=1e-4,
    )
    here = static_part_cost(tracks, ROBUST, best.log_scale + 0.5, best.x_world)
    assert_allclose(slope[0, 0], here.gradient, rtol=1e-5)
