"""Depth that is off is told by the arm, whatever else is off, and by nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.surface import ArmSurface
from akm_fg.arm.depth_from_arm import (
    DepthCorrection,
    DepthFromArmConfig,
    depth_from_arm,
)
from akm_fg.records import CalibrationErrors, FloatArray, PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(320, 240, 200.0, 200.0, 159.5, 119.5)
Q = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])
FINGERS_M = 0.02
NOISE_M = 2e-3
PRIOR = CalibrationErrors(np.diag([np.radians(0.1) ** 2] * 3 + [1e-3**2] * 3), 0.002, 0.01, 1e-3)
CONFIG = DepthFromArmConfig(cell_px=8, least_in_cell=20, inner_px=2)


def _looking_at(p_world: FloatArray, eye_world: FloatArray) -> gtsam.Pose3:
    z = (p_world - eye_world) / np.linalg.norm(p_world - eye_world)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])), eye_world)


T_WORLD_CAM = _looking_at(np.array([0.3, 0.0, 0.4]), np.array([-0.4, 0.7, 1.0]))


@dataclass(frozen=True)
class _Rig:
    """What is wrong with one camera and one arm."""

    scale: float = 0.0
    bias_m: float = 0.0
    eta: tuple[float, ...] = (0.0,) * 6
    focal: float = 0.0
    offsets_rad: tuple[float, ...] = (0.0,) * 7

    def frame(self, surface: ArmSurface, rng: np.random.Generator) -> RgbdFrame:
        """What it measures of the arm before nothing, at the angles that it takes for `Q`."""
        true = replace(CAMERA, fx=CAMERA.fx * (1 + self.focal), fy=CAMERA.fy * (1 + self.focal))
        T = T_WORLD_CAM * gtsam.Pose3.Expmap(np.array(self.eta))
        depth = surface.seen(Q - np.array(self.offsets_rad), FINGERS_M, true, T).depth_m
        depth = np.where(np.isfinite(depth), depth, np.nan) + rng.normal(0, NOISE_M, depth.shape)
        measured = ((depth - self.bias_m) / (1 + self.scale)).astype(np.float32)
        return _frame(measured)


def _frame(depth_m: FloatArray) -> RgbdFrame:
    rgb = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    return RgbdFrame(0.0, rgb, np.asarray(depth_m, dtype=np.float32), CAMERA, T_WORLD_CAM)


@pytest.fixture(scope="module")
def surface() -> ArmSurface:
    return ArmSurface()


def _told(
    surface: ArmSurface, frame: RgbdFrame, prior: CalibrationErrors = PRIOR
) -> DepthCorrection | None:
    return depth_from_arm([frame], surface, Q, FINGERS_M, prior, CONFIG)


def test_scale_is_told_five_times_better_than_the_data_sheet_does(surface):
    told = _told(surface, _Rig(scale=0.017).frame(surface, np.random.default_rng(1)))
    assert told is not None and told.cells > 30
    scale_sd = float(np.sqrt(told.cov[0, 0]))
    assert scale_sd < PRIOR.depth_scale_sd / 5
    assert told.scale == pytest.approx(0.017, abs=3 * scale_sd)
    assert "+1.7 % off" in told.words()


def test_deviations_are_true_over_rigs_that_err_in_everything(surface):
    """z of scale, of bias and of the depth at one metre: mean squares as they ought to be."""
    rng, squares = np.random.default_rng(7), []
    for _ in range(15):
        rig = _Rig(
            scale=rng.normal(0, PRIOR.depth_scale_sd),
            bias_m=rng.normal(0, PRIOR.depth_bias_sd_m),
            eta=tuple(rng.multivariate_normal(np.zeros(6), PRIOR.cov_world_cam)),
            focal=rng.normal(0, PRIOR.focal_sd),
            offsets_rad=tuple(rng.normal(0, CONFIG.joint_sd_rad, 7)),
        )
        told = _told(surface, rig.frame(surface, rng))
        assert told is not None
        off = np.array([rig.scale - told.scale, rig.bias_m - told.bias_m])
        at_1m = float(off.sum() / np.sqrt(told.cov.sum()))
        squares.append([*(off**2 / np.diag(told.cov)), at_1m**2])
    # Below 99.9 % of chi2 with 15 degrees of freedom; no link's mesh is off here, which the
    # deviations allow for, so that small values are right.
    assert (np.mean(squares, axis=0) < 37.7 / 15).all()
    assert (np.mean(squares, axis=0) > 0.2).all()


def test_what_turns_with_the_joints_is_not_taken_for_depth(surface):
    """An arm that is a degree off in its shoulder: where that may be, depth is told less surely."""
    rig = _Rig(offsets_rad=(0.0, np.radians(1.0), 0.0, 0.0, 0.0, 0.0, 0.0))
    frame = rig.frame(surface, np.random.default_rng(2))
    loose = replace(CONFIG, joint_sd_rad=float(np.radians(1.0)))
    told = depth_from_arm([frame], surface, Q, FINGERS_M, PRIOR, loose)
    assert told is not None
    assert abs(told.scale + told.bias_m) < 3.0 * float(np.sqrt(told.cov.sum()))
    sure = _told(surface, frame)
    assert sure is None or sure.cov[0, 0] < told.cov[0, 0]


@pytest.mark.parametrize("joint", range(7))
def test_the_surface_goes_with_the_joints_that_carry_it(surface, joint):
    """What a pixel shows when one joint has turned a little, and what it should by the formula."""
    step = np.zeros(7)
    step[joint] = 2e-4
    after = surface.seen(Q + step, FINGERS_M, CAMERA, T_WORLD_CAM).depth_m
    seen = surface.seen(Q, FINGERS_M, CAMERA, T_WORLD_CAM)
    v, u = np.nonzero(np.isfinite(seen.depth_m) & np.isfinite(after))
    ray = np.column_stack(
        [(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))]
    )
    p_world = T_WORLD_CAM.transformFrom((seen.depth_m[v, u, None] * ray).T).T
    moved_world = surface.turned_by(p_world, seen.link[v, u]) @ step
    n = seen.normal_cam[v, u]
    moved = np.einsum("ni,ni->n", n, moved_world @ T_WORLD_CAM.rotation().matrix())
    foretold = moved / np.einsum("ni,ni->n", n, ray)
    change = after[v, u] - seen.depth_m[v, u]
    facing = -np.einsum("ni,ni->n", n, ray) > 0.7
    off = np.abs(change - foretold)[facing]
    assert np.median(off) < 1e-6 and np.quantile(off, 0.9) < 2e-5  # m; single precision, edges
    assert np.abs(foretold[facing]).max() > 2e-5


def test_what_stands_before_the_arm_is_left_out(surface):
    frame = _Rig(scale=-0.012).frame(surface, np.random.default_rng(3))
    depth = np.array(frame.depth_m)
    depth[:, : CAMERA.width // 2] -= 0.03  # a cable, a hand: within the gate
    told = _told(surface, _frame(depth))
    clear = _told(surface, frame)
    assert told is not None and clear is not None and told.cells < clear.cells
    assert told.scale == pytest.approx(-0.012, abs=4 * float(np.sqrt(told.cov[0, 0])))


def test_nothing_is_told_without_an_arm_or_beyond_what_a_camera_may_err(surface):
    frame = _Rig().frame(surface, np.random.default_rng(4))
    assert _told(surface, frame) is not None
    assert _told(surface, _frame(np.full_like(frame.depth_m, np.nan))) is None
    assert _told(surface, _frame(np.full_like(frame.depth_m, 0.2))) is None
    far = _Rig(scale=0.045).frame(surface, np.random.default_rng(5))
    assert _told(surface, far) is None
    assert _told(surface, frame, replace(PRIOR, depth_scale_sd=0.0)) is None
    off = replace(CONFIG, use=False)
    assert depth_from_arm([frame], surface, Q, FINGERS_M, PRIOR, off) is None


def test_a_correction_corrects_and_leaves_its_own_deviations():
    correction = DepthCorrection(0.01, 2e-3, np.diag([1e-3**2, 5e-4**2]), 40)
    depth = np.full((CAMERA.height, CAMERA.width), 0.9)
    corrected = correction.corrected(_frame(depth)).depth_m
    np.testing.assert_allclose(corrected, 0.9 * 1.01 + 2e-3, rtol=1e-6)
    left = correction.left(PRIOR)
    assert (left.depth_scale_sd, left.depth_bias_sd_m) == pytest.approx((1e-3, 5e-4))
    np.testing.assert_array_equal(left.cov_world_cam, PRIOR.cov_world_cam)


def test_several_frames_say_again_what_they_said_before_better_than_one_does(surface):
    rng = np.random.default_rng(6)
    exact = _Rig(scale=0.01).frame(surface, rng).depth_m

    def spread(count: int) -> float:
        told = []
        for _ in range(8):
            frames = [_frame(exact + rng.normal(0, 0.01, exact.shape)) for _ in range(count)]
            correction = depth_from_arm(frames, surface, Q, FINGERS_M, PRIOR, CONFIG)
            assert correction is not None
            told.append(correction.scale + correction.bias_m)
        return float(np.std(told))

    assert spread(8) < 0.6 * spread(1)  # 0.35 is to be expected
