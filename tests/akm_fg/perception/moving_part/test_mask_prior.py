"""How far a track's label reaches, by hand: along its surface, not off it."""

import gtsam
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.moving_part.mask_prior import TrackPriorConfig, nearness
from akm_fg.records import PinholeCamera, RgbdFrame

W, H, FX = 160, 120, 300.0
CAMERA = PinholeCamera(W, H, FX, FX, (W - 1) / 2, (H - 1) / 2)
WHOLE = (slice(0, H, 1), slice(0, W, 1))
CONFIG = TrackPriorConfig()
AT = np.array([[60.0, 50.0]])


def reach(depth: np.ndarray, uv: np.ndarray = AT) -> np.ndarray:
    rgb = np.zeros((H, W, 3), np.uint8)
    frame = RgbdFrame(0.0, rgb, depth.astype(np.float32), CAMERA, gtsam.Pose3())
    return nearness(frame, WHOLE, uv, DepthNoiseModel(), CONFIG)


def test_along_the_surface_it_falls_to_one_over_e_within_six_centimetres():
    """At 1 m 18 px are 6 cm."""
    near = reach(np.ones((H, W)))
    np.testing.assert_allclose(near[50, [60, 78, 96]], np.exp([0.0, -1.0, -2.0]), rtol=1e-3)
    np.testing.assert_allclose(near[68, 60], np.exp(-1.0), rtol=1e-3)


def test_off_the_tracks_plane_it_falls_as_a_normal_with_a_deviation_of_8_mm():
    """What stands out by 16 mm, two deviations, 18 px aside; a slanted plane is the track's own."""
    depth = np.ones((H, W))
    depth[:, 70:] -= 0.016
    x = np.array([18.0 * 0.984 - 0.016 * (60 - CAMERA.cx), -0.016 * (50 - CAMERA.cy)]) / FX
    away = np.linalg.norm([*x, 0.016])
    np.testing.assert_allclose(reach(depth)[50, 78], np.exp(-away / 0.06 - 2.0), rtol=1e-2)
    u = np.arange(W)[None].repeat(H, axis=0)
    slanted = 1.0 / (1.0 + 0.002 * (u - 60))  # inverse depth is linear: a plane
    z = slanted[50, 78]
    p, q = (np.array([(c - CAMERA.cx) / FX, 0.0, 1.0]) * d for c, d in ((60, 1.0), (78, z)))
    rise = (50 - CAMERA.cy) / FX * (1.0 - z)
    away = np.hypot(np.linalg.norm(p - q), rise)
    np.testing.assert_allclose(reach(slanted)[50, 78], np.exp(-away / 0.06), rtol=1e-2)


def test_without_depth_or_tracks_nothing_is_near():
    depth = np.ones((H, W))
    depth[:, 100:] = np.nan
    assert not reach(depth)[:, 100:].any()
    assert not reach(depth, np.array([[-50.0, 20.0]])).any()
    assert not reach(np.full((H, W), np.nan)).any()
