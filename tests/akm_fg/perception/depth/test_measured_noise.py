"""The noise of depth is measured in the picture, and believed where it is more than assumed."""

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.measured_noise import (
    MeasuredNoiseConfig,
    measured_noise,
    noise_scale,
)
from akm_fg.pipeline import fit_recording
from akm_fg.records import Recording
from tests.akm_fg.conftest import Clip, depth_noise

MODEL = DepthNoiseModel()


def noisy(clip: Clip, scale: float, light: float = 1.0) -> Recording:
    """The clip with so many times a D455's noise of disparity, and darker."""
    rng, frames = np.random.default_rng(1), []
    for frame, depth in zip(clip.frames, clip.depth, strict=True):
        z = np.where(np.isfinite(depth), depth, np.nan)
        off = scale * depth_noise(rng, np.nan_to_num(z, nan=1.0), clip.scene.focal_px)
        z = 1 / (1 / z - off / z**2)
        rgb = (light * frame.rgb).astype(np.uint8)
        frames.append(replace(frame, depth_m=z.astype(np.float32), rgb=rgb))
    return Recording("noisy", tuple(frames))


@pytest.mark.parametrize("scale", (0.0, 1.0, 2.0, 4.0, 8.0))
def test_the_noise_is_found(door, scale: float) -> None:
    found = noise_scale(noisy(door, scale).frames[0], MODEL, MeasuredNoiseConfig())
    assert abs(found - scale) < 0.15 * scale + 0.1


def test_the_model_stands_where_the_camera_is_no_worse(door) -> None:
    for scale in (0.0, 1.0, 1.4):
        assert measured_noise(noisy(door, scale).frames[0], MODEL) == MODEL
    found = measured_noise(noisy(door, 3.0).frames[0], MODEL)
    assert 2.5 < found.disparity_sigma_px / MODEL.disparity_sigma_px < 3.5


def test_too_little_depth_tells_nothing(door) -> None:
    frame = door.frames[0]
    empty = np.full(frame.depth_m.shape, np.nan, np.float32)
    assert measured_noise(replace(frame, depth_m=empty), MODEL) == MODEL


@pytest.mark.parametrize("name", ("door", "drawer"))
def test_a_camera_that_is_four_times_as_noisy_names_the_joint(name: str, request) -> None:
    clip = request.getfixturevalue(name)
    posterior = fit_recording(noisy(clip, 4.0)).posterior
    assert posterior.kind == clip.scene.joint
    assert posterior.fit.tracks_used > 50
    joint = posterior.best.joint
    true = np.array([0.0, 0.0, -1.0] if joint.turns else [1.0, 0.0, 0.0])
    assert np.linalg.norm(joint.axis - true) < 4 * joint.axis_sd_rad < 0.02


@pytest.mark.parametrize("name", ("door", "drawer"))
@pytest.mark.parametrize("scale", (0.0, 1.0, 4.0))
def test_in_the_dark_no_wrong_kind_is_named(name: str, scale: float, request) -> None:
    clip = request.getfixturevalue(name)
    posterior = fit_recording(noisy(clip, scale, light=0.0)).posterior
    assert posterior.kind in (clip.scene.joint, "undecided")
    if scale > 1:
        assert posterior.kind == "undecided"
        assert any("times as noisy as assumed" in w for w in posterior.fit.warnings)


def test_depth_alone_names_no_screw(make_clip) -> None:
    clip = make_clip(np.deg2rad(35), 15, contrast=0.0)
    posterior = fit_recording(noisy(clip, 1.0, light=0.0)).posterior
    assert posterior.kind != "helical"
