"""Board-view factor: corners tell camera, poses and lens; a corner gone astray costs itself."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, central_difference, numeric_gradient
from factors.measurements.board_view import board_view_factor, board_view_residual, project_corners
from factors.student_t import twice_negative_log_kernel

K, CAM, HOLDER, BOARD = (gtsam.symbol(c, 0) for c in "kchb")
LENS = {
    "none": np.array([600.0, 590.0, 0.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0]),
    "strong": np.array([600.0, 590.0, 1.5, 320.0, 240.0, -0.3, 0.12, 0.004, -0.003]),
}
# Rotation between camera and board; the transforms in between take shares of it.
TURNS = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-9, -2e-7, 1e-6]),
    "generic": np.array([0.4, -0.5, 0.9]),
    "pi": np.pi * np.array([0.0, 0.0, 1.0]),
}
GRID = np.array([[x, y, 0.0] for y in (0.0, 0.05, 0.1, 0.15) for x in (0.0, 0.06, 0.12)])
GAUSSIAN, ROBUST = 1e9, 5.0


def _poses(turn):
    """T_mount_cam, T_mount_holder, T_holder_board: the board 0.8 m ahead of the camera."""
    T_cam_board = gtsam.Pose3(gtsam.Rot3.Expmap(turn), np.array([-0.05, 0.08, 0.8]))
    T_mount_cam = gtsam.Pose3(gtsam.Rot3.Expmap(-0.7 * turn), np.array([0.3, -0.5, 0.9]))
    T_holder_board = gtsam.Pose3(gtsam.Rot3.Expmap(turn), np.array([0.05, 0.02, 0.2]))
    return T_mount_cam, T_mount_cam * T_cam_board * T_holder_board.inverse(), T_holder_board


def _seen(lens, turn, size=0.0, seed=0):
    """Pixels by GTSAM's own camera, each off by `size` pixels rms."""
    T_mount_cam, T_mount_holder, T_holder_board = _poses(turn)
    camera = gtsam.PinholeCameraCal3DS2(T_mount_cam, gtsam.Cal3DS2(LENS[lens]))
    T_mount_board = T_mount_holder * T_holder_board
    uv = np.array([camera.project(T_mount_board.transformFrom(p)) for p in GRID])
    return uv + size * np.random.default_rng(seed).normal(size=uv.shape)


def _values(lens, turn):
    values = gtsam.Values()
    values.insert(K, gtsam.Cal3DS2(LENS[lens]))
    for key, pose in zip((CAM, HOLDER, BOARD), _poses(turn), strict=True):
        values.insert(key, pose)
    return values


def _factor(uv, p_board=GRID, sigma_px=0.2, dof=ROBUST, count=1.0):
    return board_view_factor(K, CAM, HOLDER, BOARD, p_board, uv, sigma_px, dof, count)


@pytest.fixture(params=list(TURNS))
def turn(request):
    return TURNS[request.param]


@pytest.fixture(params=list(LENS))
def lens(request):
    return request.param


def test_jacobians_match_differences(lens, turn):
    uv, poses = _seen(lens, turn, 3.0), _poses(turn)
    scale = np.array([1.0] * 5 + [1e-2] * 4)  # distortion in steps that move a pixel as far

    def moved(d):
        shifted = [
            pose.compose(gtsam.Pose3.Expmap(d[9 + 6 * i : 15 + 6 * i])).matrix()
            for i, pose in enumerate(poses)
        ]
        return board_view_residual(LENS[lens] + scale * d[:9], *shifted, GRID, uv)[0].ravel()

    _, J = board_view_residual(LENS[lens], *(T.matrix() for T in poses), GRID, uv)
    numeric = central_difference(moved, np.zeros(27)).reshape(-1, 2, 27)
    numeric[..., :9] /= scale
    assert_allclose(J, numeric, rtol=1e-6, atol=2e-5)


@pytest.mark.parametrize("dof", [GAUSSIAN, ROBUST])
def test_gradient_of_the_factor_is_that_of_its_error(lens, turn, dof):
    factor, values = _factor(_seen(lens, turn, 0.5), dof=dof), _values(lens, turn)
    numeric = numeric_gradient(factor, values, [9, 6, 6, 6])
    analytic = analytic_gradient(factor, values)
    assert_allclose(analytic, numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max())


def test_the_truth_gives_zero(lens, turn):
    assert_allclose(_factor(_seen(lens, turn)).error(_values(lens, turn)), 0.0, atol=1e-15)


def test_a_point_a_tenth_to_the_right_at_one_metre_lies_sixty_pixels_off_the_centre():
    uv, _, _ = project_corners(LENS["none"], np.array([[0.1, 0.0, 1.0]]))
    assert_allclose(uv, [[380.0, 240.0]])


def test_barrel_distortion_draws_a_point_in():
    """x = 0.5, k1 = -0.2: x_d = 0.5 (1 - 0.2 * 0.25) = 0.475, at 600 pixels 285."""
    lens = LENS["none"].copy()
    lens[5] = -0.2
    uv, _, _ = project_corners(lens, np.array([[1.0, 0.0, 2.0]]))
    assert_allclose(uv, [[320.0 + 285.0, 240.0]])


def test_cost_is_the_kernel_over_all_corners(lens):
    uv = _seen(lens, TURNS["generic"], 0.4)
    d2 = ((uv - _seen(lens, TURNS["generic"])) ** 2).sum(axis=1) / 0.2**2
    want = 0.5 * twice_negative_log_kernel(d2, ROBUST, 2).sum()
    values = _values(lens, TURNS["generic"])
    assert_allclose(_factor(uv).error(values), want, rtol=1e-9)
    assert_allclose(_factor(uv, count=4.0).error(values), want / 4.0, rtol=1e-9)


def test_a_corner_far_astray_has_no_say():
    uv = _seen("none", TURNS["generic"])
    uv[4] += [80.0, -50.0]
    others = np.delete(np.arange(len(uv)), 4)
    values = _values("none", TURNS["generic"])
    A, _ = _factor(uv).linearize(values).jacobian()
    B, _ = _factor(uv[others], GRID[others]).linearize(values).jacobian()
    assert_allclose(A.T @ A, B.T @ B, rtol=0.02, atol=1e-3 * np.abs(B.T @ B).max())


def test_a_board_behind_the_camera_costs_a_lot():
    values, uv = _values("none", TURNS["generic"]), _seen("none", TURNS["generic"])
    turned = values.atPose3(CAM) * gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3))
    values.update(CAM, turned)
    assert _factor(uv, dof=GAUSSIAN).error(values) > 1e6


@pytest.mark.parametrize(
    ("p_board", "uv", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 2)), "without corners"),
        (GRID, np.zeros((5, 2)), r"expected \(N, 3\), \(N, 2\)"),
        (GRID[:, :2], np.zeros((12, 2)), r"expected \(N, 3\), \(N, 2\)"),
        (GRID, np.full((12, 2), np.nan), "not all finite"),
    ],
)
def test_bad_corners_are_refused(p_board, uv, message):
    with pytest.raises(ValueError, match=message):
        _factor(uv, p_board)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("name", ["sigma_px", "dof", "count"])
def test_noise_that_is_not_positive_is_refused(name, bad):
    with pytest.raises(ValueError, match="expected > 0"):
        _factor(_seen("none", TURNS["zero"]), **{name: bad})
