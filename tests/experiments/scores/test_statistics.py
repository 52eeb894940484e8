import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from experiments.scores.statistics import mean_nees, median, rms_ratio, share, wilson


def test_wilson_interval_of_eight_in_ten_by_hand():
    """(p + z^2/2n +- z sqrt(p q / n + z^2 / 4n^2)) / (1 + z^2/n), z = 1.96: 0.490 to 0.943."""
    found = wilson(8, 10)
    assert found.value == 0.8
    assert_allclose([found.low, found.high], [0.4902, 0.9433], atol=1e-4)


def test_wilson_interval_of_none_in_ten_ends_at_z2_over_n_plus_z2():
    found = wilson(0, 10)
    assert found.low == 0.0
    assert_allclose(found.high, 3.8415 / 13.8415, atol=1e-4)


@pytest.mark.parametrize(("successes", "trials"), [(1, 0), (3, 2), (-1, 2)])
def test_impossible_counts_are_refused(successes, trials):
    with pytest.raises(ValueError, match="successes"):
        wilson(successes, trials)


def test_a_share_counts_the_true_flags():
    assert share([True, False, True, True]) == wilson(3, 4)


def test_median_of_twenty_lies_between_the_sixth_and_the_fifteenth():
    """P(Binomial(20, 1/2) < 6) = 0.0207, < 7: 0.0577 (tables of the sign test)."""
    found = median(np.arange(20, 0, -1.0))
    assert (found.value, found.low, found.high) == (10.5, 6.0, 15.0)


def test_median_interval_holds_the_median_as_often_as_it_says():
    rng = np.random.default_rng(0)
    samples = [median(rng.exponential(size=31)) for _ in range(1000)]
    inside = sum(e.low <= np.log(2) <= e.high for e in samples)
    assert 950 <= inside <= 990  # the order statistics of 31 give 0.9706


def test_fewer_than_six_values_have_no_interval_but_their_range():
    found = median([5.0, 1.0, 4.0, 2.0, 3.0])
    assert (found.value, found.low, found.high) == (3.0, 1.0, 5.0)
    assert median(np.arange(6.0)).low == 0.0  # P(Binomial(6, 1/2) < 1) = 0.0156


def test_trials_without_a_value_are_infinitely_far_off_and_nan_is_refused():
    assert median([1.0, 2.0, np.inf, np.inf, np.inf]).value == np.inf
    assert median([np.inf, np.inf]).value == np.inf
    with pytest.raises(ValueError, match="NaN"):
        median([1.0, np.nan])


def test_rms_ratio_is_one_for_errors_as_large_as_expected():
    rng = np.random.default_rng(0)
    v = rng.uniform(0.5, 4.0, 400)
    found = rms_ratio(v * rng.normal(size=400) ** 2, v, rng)
    assert found.low < 1 < found.high
    assert_allclose(found.value, 1, atol=0.12)
    assert_allclose(rms_ratio([4.0, 4.0], [1.0, 1.0], rng).value, 2.0)


def test_one_trial_has_a_ratio_and_no_spread():
    found = rms_ratio([9.0], [1.0], np.random.default_rng(0))
    assert (found.value, found.low, found.high) == (3.0, 3.0, 3.0)


def test_band_of_the_mean_nees_is_chi_squares_over_the_degrees_of_freedom():
    found = mean_nees(210.0, 200)
    assert found.value == 1.05
    assert_allclose([found.low, found.high], stats.chi2.ppf([0.025, 0.975], 200) / 200)
