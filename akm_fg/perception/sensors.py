"""Depth cameras by name: how noisy each is, and where that is written.

Cameras that measure time of flight have no baseline. Their noise grows with the distance too, and
is given as that of a stereo camera with f b = TOF_FB: sigma = disparity_sigma_px z^2 / TOF_FB.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel

SensorName = Literal["d455", "l515", "kinect", "azure", "measured"]

TOF_FOCAL_PX, TOF_BASELINE_M = 1000.0, 0.1
TOF_FB = TOF_FOCAL_PX * TOF_BASELINE_M  # px m


def _time_of_flight(near_m: float, far_m: float, at_m: float) -> DepthNoiseModel:
    """With a standard deviation of `near_m` near the camera, and `far_m` at `at_m`."""
    grown_m = (far_m**2 - near_m**2) ** 0.5
    return DepthNoiseModel(
        baseline_m=TOF_BASELINE_M,
        disparity_sigma_px=grown_m / at_m**2 * TOF_FB,
        floor_m=near_m,
        depth_focal_px=TOF_FOCAL_PX,
    )


PROFILES: dict[SensorName, DepthNoiseModel] = {
    "d455": DepthNoiseModel(),
    # Intel, L515 data sheet, rev. 003, 2021: standard deviation 2.5 mm at 1 m, 15.5 mm at 9 m.
    "l515": _time_of_flight(0.0025, 0.0155, 9.0),
    # The first Kinect. Khoshelham and Elberink, Sensors 12(2), 2012: sigma = 1.425e-3 z^2 (m), half
    # a step of 1/8 px of disparity with f = 580 px and b = 75 mm. Nguyen, Izadi and Lovell, 3DIMPVT
    # 2012: 1.2 mm at the nearest, 0.4 m.
    "kinect": DepthNoiseModel(
        baseline_m=0.075, disparity_sigma_px=0.062, floor_m=0.0012, depth_focal_px=580.0
    ),
    # Microsoft, Azure Kinect DK hardware specification: random error of up to 17 mm over its range,
    # in the narrow field up to 3.86 m; confirmed by Toelgyessy et al., Sensors 21(2), 2021. Depth
    # comes in whole millimetres.
    "azure": _time_of_flight(0.001, 0.017, 3.86),
}


def with_sensor(perception: PerceptionConfig, sensor: SensorName) -> PerceptionConfig:
    """The settings with the noise of a camera.

    `measured`: as the first picture shows it, more or less than the settings say. Else a picture
    that shows clearly more noise than its camera should have is believed, as ever.
    """
    observe = perception.observe
    if sensor == "measured":
        measured = replace(observe.measured_noise, trusted=0.0)
        return replace(perception, observe=replace(observe, measured_noise=measured))
    return replace(perception, observe=replace(observe, noise=PROFILES[sensor]))
