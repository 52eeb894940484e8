"""Static points tell how noisy the moving ones are."""

from dataclasses import replace

import gtsam
import numpy as np
from numpy.testing import assert_allclose

from akm_fg.estimation.config import FitConfig, GraspConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.sources.source import NoiseLevel
from akm_fg.estimation.sources.static_points import StaticPoints
from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import PinholeCamera, PixelTracks, PointTracks, Recording, RgbdFrame
from akm_fg.stream.joint_estimate import knowledge_of

WHITE = GraspConfig(sigma_trans_m=0.002, sigma_rot_rad=0.02, frames_as_one=1.0)
SIGMA_M = 0.003  # of every coordinate in the openings


def test_static_points_tell_the_noise_level_of_the_moving():
    rng, config = np.random.default_rng(0), FitConfig()
    rest = rng.uniform(-1, 1, (80, 3))
    noise = 2.0 * SIGMA_M * rng.normal(size=(50, 80, 3))
    mixing = np.sqrt(rng.chisquare(config.dof, (50, 80, 1)) / config.dof)
    cov = np.tile(SIGMA_M**2 * np.eye(3), (50, 80, 1, 1))
    level = StaticPoints.of(PointTracks(rest + noise / mixing, cov), config).level
    assert_allclose(level.scale, 2.0 * config.moving_noise, rtol=0.1)
    assert_allclose(level.observations, 0.5 / config.moving_noise_sd_log**2, rtol=0.1)


def test_static_points_that_tell_no_level_change_nothing():
    config, cov = FitConfig(), np.tile(np.eye(3), (5, 4, 1, 1))
    frozen = PointTracks(np.ones((5, 4, 3)), cov)
    once = PointTracks(np.where(np.arange(5)[:, None, None] == 2, np.ones((5, 4, 3)), np.nan), cov)
    none = frozen.select(np.zeros(0, dtype=int))
    assert [StaticPoints.of(t, config) for t in (frozen, once, none)] == [None] * 3


def _seen(frames=6, points=12):
    """A recording in which half of the points rest, and the gripper's poses are known."""
    rng, camera = np.random.default_rng(0), PinholeCamera(4, 4, 5.0, 5.0, 2.0, 2.0)
    rgb, depth_m = np.zeros((4, 4, 3), dtype=np.uint8), np.ones((4, 4), dtype=np.float32)
    clip = tuple(RgbdFrame(0.1 * t, rgb, depth_m, camera, gtsam.Pose3()) for t in range(frames))
    hands = tuple(gtsam.Pose3(gtsam.Rot3(), np.array([0.1 * t, 0, 0])) for t in range(frames))
    static = np.arange(points) < points // 2
    p = rng.normal(size=(1, points, 3)) + 0.001 * rng.normal(size=(frames, points, 3))
    p[:, ~static] += 0.1 * np.arange(frames)[:, None, None]
    tracks = PointTracks(p, np.tile(0.001**2 * np.eye(3), (frames, points, 1, 1)))
    cov_px2 = np.tile(np.eye(2), (frames, points, 1, 1))
    pixels = PixelTracks(p[..., :2], np.ones((frames, points), dtype=bool), cov_px2)
    segmentation = MotionSegmentation(~static, static, np.zeros_like(static), 0.0, 0.3, 1.0)
    observed = ObservedMotion(tracks, pixels, segmentation, np.ones((4, 4), dtype=bool))
    return Recording("clip", clip, None, hands, (1, 4)), observed


def test_a_recording_tells_its_noise_level_and_the_gripper_only_where_asked(caplog):
    recording, observed = _seen()
    plain = knowledge_of(recording, observed, FitConfig())
    (static,) = plain
    assert_allclose(static.level.scale, FitConfig().moving_noise, rtol=0.4)  # not the moving
    _, asked = knowledge_of(recording, observed, FitConfig(grasp=WHITE))
    assert asked.grasp_frames == (1, 4) and asked.noise is WHITE
    assert_allclose(asked.T_world_gripper[:, 0, 3], 0.1 * np.arange(6))
    assert caplog.text == ""
    without = knowledge_of(replace(recording, grasp_frames=None), observed, FitConfig(grasp=WHITE))
    assert len(without) == 1 and "no gripper poses" in caplog.text


def test_a_noise_level_is_its_own_most_probable_scale_and_as_sharp_as_it_says():
    level, h = NoiseLevel(0.6, 30.0), 1e-3
    assert_allclose(level.log_density(0.6), 0.0, atol=1e-12)
    beside = [level.log_density(0.6 * np.exp(step)) for step in (-h, h)]
    assert_allclose(-sum(beside) / h**2, 2 * 30.0, rtol=1e-4)


def test_the_noise_level_pulls_the_scale_of_few_tracks_and_weighs_the_kinds(opening):
    truth = opening(0, "prismatic", points=4, frames=5)
    scales = [
        fit_tracks(truth.tracks, sources=[StaticPoints(NoiseLevel(s, 1e4))])
        for s in (0.5, 1.0, 2.0)
    ]
    assert_allclose([p.fit.noise_scale for p in scales], [0.5, 1.0, 2.0], rtol=0.05)
    kinds = fit_tracks(truth.tracks, sources=[StaticPoints(NoiseLevel(1.0, 12.5))]).alternatives
    # What rests would have to be that noisy to explain the drawer's travel.
    assert kinds["rigid"].evidence.log_noise < -5
    assert kinds["prismatic"].evidence.log_noise > -1
