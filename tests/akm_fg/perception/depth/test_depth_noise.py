"""The stereo noise model."""

import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel


def test_noise_of_a_d455_at_one_metre_worked_by_hand() -> None:
    model = DepthNoiseModel(disparity_sigma_px=0.08, baseline_m=0.095, floor_m=1e-9)
    # 0.08 px * 1 m^2 / (400 px * 0.095 m) = 2.105 mm
    np.testing.assert_allclose(model.sigma_m(np.array([1.0]), 400.0), [0.08 / 38], rtol=1e-9)


def test_noise_grows_with_depth_squared_and_keeps_nan() -> None:
    sigma = DepthNoiseModel(floor_m=1e-9).sigma_m(np.array([1.0, 2.0, np.nan]), 400.0)
    np.testing.assert_allclose(sigma[1], 4 * sigma[0])
    assert np.isnan(sigma[2])


def test_noise_never_falls_below_the_floor() -> None:
    assert DepthNoiseModel(floor_m=0.001).sigma_m(np.array(0.01), 400.0) >= 0.001


def test_a_window_inside_the_correlation_width_is_one_sample() -> None:
    model = DepthNoiseModel(correlation_px=5)
    assert model.independent_samples(3) == 1
    assert model.independent_samples(10) == 4


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_senseless_parameters_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        DepthNoiseModel(baseline_m=value)
