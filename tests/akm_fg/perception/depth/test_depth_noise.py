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


def test_no_reading_is_claimed_to_be_better_than_its_millimetre_steps() -> None:
    """A 16-bit depth image counts millimetres: rounding alone has a sd of 1 mm / sqrt(12)."""
    near = DepthNoiseModel().sigma_m(np.array([0.25, 0.3, 0.4]), 640.0)
    assert (near > 0.001 / np.sqrt(12)).all()


def test_the_model_stays_below_the_data_sheet_of_a_d455() -> None:
    """Its bound is 2 % at 4 m, systematic errors included; 848 px over 87 deg are 447 px."""
    sigma = DepthNoiseModel().sigma_m(np.array(4.0), 848 / 2 / np.tan(np.deg2rad(87 / 2)))
    assert 0.1 * 0.08 < sigma < 0.08
