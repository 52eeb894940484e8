"""State-motion prior: exact for uneven stamps, both forms, and the same in one piece or many."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, numeric_gradient, numeric_jacobian
from factors.priors.state_motion import (
    StateMotionPrior,
    random_walk_prior,
    state_motion_factor,
    state_motion_residual,
    white_noise_acceleration_prior,
)

STAMPS_S = np.array([2.0, 2.1, 2.15, 2.6, 2.7, 3.5])
STATES = {
    "zero": np.zeros(6),
    "near zero": 1e-8 * np.arange(6.0),
    "generic": np.array([0.0, 0.1, -0.2, 0.4, 0.35, 1.1]),
    "pi": np.pi * np.array([0.0, 1.0, -1.0, 0.5, 1.0, 2.0]),
}
PRIORS = {
    "random walk": lambda stamps: random_walk_prior(stamps, 0.2, 0.5),
    "white-noise acceleration": lambda stamps: white_noise_acceleration_prior(stamps, 0.2),
}


@pytest.fixture(params=list(PRIORS))
def make_prior(request):
    return PRIORS[request.param]


def _keys(T):
    return [gtsam.symbol("q", t) for t in range(T)]


def _values(q):
    values = gtsam.Values()
    for key, state in zip(_keys(q.size), q, strict=True):
        values.insert(key, float(state))
    return values


@pytest.mark.parametrize("q", STATES.values(), ids=STATES.keys())
def test_jacobian_and_gradient_match_differences(q, make_prior):
    factor, values = state_motion_factor(_keys(6), make_prior(STAMPS_S)), _values(q)
    A, _ = factor.linearize(values).jacobian()
    assert_allclose(A, numeric_jacobian(factor, values, [1] * 6), atol=1e-6)
    gradient = analytic_gradient(factor, values)
    numeric = numeric_gradient(factor, values, [1] * 6)
    assert_allclose(gradient, numeric, atol=1e-6 * max(1.0, np.abs(gradient).max() ** 2))


def test_a_fixed_state_counts_as_zero_and_has_no_block(make_prior):
    prior, q = make_prior(STAMPS_S), STATES["generic"]
    factor = state_motion_factor([None, *_keys(6)[1:]], prior)
    A, b = factor.linearize(_values(q)).jacobian()
    assert_allclose(A, prior.A[:, 1:])
    assert_allclose(-b, state_motion_residual(prior, q)[0])  # q_0 is zero


def test_walk_of_three_hundredths_in_a_quarter_second_at_ten_percent_errs_by_three_fifths():
    e, _ = state_motion_residual(random_walk_prior([0.0, 0.25], 0.1), np.array([0.5, 0.53]))
    assert_allclose(e, [0.03 / (0.1 * 0.5)])


def test_turning_from_rest_to_unit_velocity_at_the_second_stamp():
    """By hand: d = 1 - 0, variance (1 + 1) / 3 sigma^2, so e = sqrt(1.5) / sigma."""
    prior = white_noise_acceleration_prior([0.0, 1.0, 2.0], 0.5)
    e, _ = state_motion_residual(prior, np.array([0.3, 0.3, 1.3]))
    assert_allclose(e, [np.sqrt(1.5) / 0.5])


def test_walk_at_the_expected_rate_costs_nothing():
    prior = random_walk_prior(STAMPS_S, 0.2, 0.5)
    values = _values(0.7 + 0.5 * (STAMPS_S - STAMPS_S[0]))
    assert_allclose(state_motion_factor(_keys(6), prior).error(values), 0.0, atol=1e-25)


def test_any_constant_velocity_costs_nothing_under_white_noise_acceleration():
    prior = white_noise_acceleration_prior(STAMPS_S, 0.2)
    values = _values(0.7 - 1.3 * STAMPS_S)
    assert_allclose(state_motion_factor(_keys(6), prior).error(values), 0.0, atol=1e-22)


def test_white_noise_acceleration_is_the_state_space_model_with_velocities_integrated_out():
    """Barfoot's positions and velocities with Q = sigma^2 [h^3/3, h^2/2; h^2/2, h]."""
    T, sigma = STAMPS_S.size, 0.2
    information = np.zeros((2 * T, 2 * T))  # q_0, v_0, q_1, v_1, ...
    for t, h in enumerate(np.diff(STAMPS_S)):
        Q = sigma**2 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
        F = np.hstack([-np.array([[1.0, h], [0.0, 1.0]]), np.eye(2)])
        information[2 * t : 2 * t + 4, 2 * t : 2 * t + 4] += F.T @ np.linalg.inv(Q) @ F
    q, v = np.arange(0, 2 * T, 2), np.arange(1, 2 * T, 2)
    vv, vq = information[np.ix_(v, v)], information[np.ix_(v, q)]
    expected = information[np.ix_(q, q)] - vq.T @ np.linalg.solve(vv, vq)
    prior = white_noise_acceleration_prior(STAMPS_S, sigma)
    assert_allclose(prior.A.T @ prior.A, expected, atol=1e-9 * expected.max())


def test_second_differences_have_the_stated_covariance():
    """White noise on a fine grid, integrated twice, over many draws."""
    rng, fine, sigma = np.random.default_rng(0), 50, 0.3
    stamps = np.array([0.0, 0.1, 0.15, 0.4, 0.5])
    dt = 0.05 / fine
    w = rng.normal(size=(4000, round(0.5 / dt))) * sigma / np.sqrt(dt)
    velocity = np.cumsum(w, axis=1) * dt
    position = np.cumsum(velocity, axis=1) * dt
    path = np.hstack([np.zeros((4000, 1)), position])
    q = path[:, np.round(stamps / dt).astype(int)]
    e = q @ white_noise_acceleration_prior(stamps, sigma).A.T
    assert_allclose(np.cov(e.T), np.eye(3), atol=0.1)


def test_one_factor_over_all_frames_is_one_walk_a_step():
    whole = state_motion_factor(_keys(6), random_walk_prior(STAMPS_S, 0.2, 0.5))
    graph = gtsam.NonlinearFactorGraph()
    for t in range(5):
        graph.add(
            state_motion_factor(
                _keys(6)[t : t + 2], random_walk_prior(STAMPS_S[t : t + 2], 0.2, 0.5)
            )
        )
    values = _values(STATES["generic"])
    assert_allclose(graph.error(values), whole.error(values))
    ordering = gtsam.Ordering(_keys(6))
    A, _ = whole.linearize(values).jacobian()
    H, _ = graph.linearize(values).hessian(ordering)
    assert_allclose(H, A.T @ A, atol=1e-9)


@pytest.mark.parametrize(
    "stamps",
    [[0.0, 0.1, 0.1], [0.0, 0.2, 0.1], [0.0, np.nan, 0.2], [0.0, 1.0, np.inf], [[0.0, 0.1, 0.2]]],
)
def test_stamps_that_do_not_increase_are_refused(stamps, make_prior):
    with pytest.raises(ValueError, match="stamps"):
        make_prior(np.array(stamps))


@pytest.mark.parametrize(
    ("stamps", "prior"),
    [([0.0], PRIORS["random walk"]), ([0.0, 0.1], PRIORS["white-noise acceleration"])],
)
def test_too_few_stamps_are_refused(stamps, prior):
    with pytest.raises(ValueError, match=r"expected \(T,\) with T >="):
        prior(stamps)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("make", [random_walk_prior, white_noise_acceleration_prior])
def test_a_sigma_that_is_not_positive_is_refused(sigma, make):
    with pytest.raises(ValueError, match=r"sigma_per_.* is .* expected > 0"):
        make(STAMPS_S, sigma)


@pytest.mark.parametrize("rate", [np.nan, np.inf])
def test_a_rate_that_is_not_finite_is_refused(rate):
    with pytest.raises(ValueError, match="rate_per_s"):
        random_walk_prior(STAMPS_S, 0.1, rate)


def test_keys_that_do_not_match_the_frames_are_refused():
    with pytest.raises(ValueError, match="5 state keys, 6 frames"):
        state_motion_factor(_keys(5), random_walk_prior(STAMPS_S, 0.1))


def test_a_prior_on_no_state_is_refused():
    prior: StateMotionPrior = random_walk_prior(STAMPS_S, 0.1)
    with pytest.raises(ValueError, match="every state is fixed"):
        state_motion_factor([None] * 6, prior)
