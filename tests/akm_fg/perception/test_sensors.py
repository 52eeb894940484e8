"""Noise of depth cameras by name: the figures of their sources, and what `measured` does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.measured_noise import measured_noise
from akm_fg.perception.sensors import PROFILES, SensorName, with_sensor
from tests.akm_fg.perception.depth.test_measured_noise import noisy


@pytest.mark.parametrize(
    ("sensor", "at_m", "sigma_m"),
    [
        ("l515", 1.0, 0.0025),
        ("l515", 9.0, 0.0155),
        ("kinect", 3.0, 0.0128),  # 1.425e-3 * 9
        ("azure", 0.5, 0.001),
        ("azure", 3.86, 0.017),
    ],
)
@pytest.mark.parametrize("fx", [500.0, 1400.0])  # of colours to which the depth was aligned
def test_profiles_give_what_their_sources_say(
    sensor: SensorName, at_m: float, sigma_m: float, fx: float
) -> None:
    assert PROFILES[sensor].sigma_m(np.array(at_m), fx) == pytest.approx(sigma_m, rel=0.05)


def test_a_named_camera_replaces_the_noise_and_measuring_goes_both_ways(door) -> None:
    usual = PerceptionConfig()
    assert with_sensor(usual, "d455") == usual
    assert with_sensor(usual, "kinect").observe.noise == PROFILES["kinect"]
    frame, measuring = noisy(door, 0.7).frames[0], with_sensor(usual, "measured").observe
    found = measured_noise(frame, measuring.noise, measuring.measured_noise)
    ratio = found.disparity_sigma_px / usual.observe.noise.disparity_sigma_px
    assert 0.55 < ratio < 0.85
    exact = noisy(door, 0.0).frames[0]
    least = measured_noise(exact, measuring.noise, measuring.measured_noise)
    assert least.disparity_sigma_px == 0.5 * usual.observe.noise.disparity_sigma_px
    assert measured_noise(frame, usual.observe.noise, usual.observe.measured_noise) == (
        usual.observe.noise
    )


def test_a_senseless_focal_length_is_refused() -> None:
    with pytest.raises(ValueError, match="depth_focal_px"):
        replace(PROFILES["azure"], depth_focal_px=0.0)
