"""Recordings of a cabinet by a camera that moves."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
import pytest

from akm_fg.records import Recording, RgbdFrame
from tests.akm_fg.conftest import Cabinet, depth_noise, render


def film_moving(
    scene: Cabinet, states: Sequence[float], T_cam_moved: Sequence[gtsam.Pose3], told: bool
) -> Recording:
    """Frames of a camera that is off its place by T_cam_moved, one a frame; told, or not."""
    rng, frames = np.random.default_rng(0), []
    for i, (q, moved) in enumerate(zip(states, T_cam_moved, strict=True)):
        T_true = scene.T_world_cam * moved
        rgb, depth, _ = render(scene.camera, T_true, scene.at(float(q)))
        noisy = np.where(np.isfinite(depth), depth, np.nan)
        noisy = noisy + depth_noise(rng, np.nan_to_num(noisy, nan=1.0), scene.focal_px)
        image = np.clip(rgb + rng.normal(scale=2.0, size=rgb.shape), 0, 255).astype(np.uint8)
        T = T_true if told else scene.T_world_cam
        frames.append(RgbdFrame(0.1 * i, image, noisy.astype(np.float32), scene.camera, T))
    return Recording("moving camera", tuple(frames))


@pytest.fixture(scope="session")
def film() -> Callable[..., Recording]:
    return film_moving
