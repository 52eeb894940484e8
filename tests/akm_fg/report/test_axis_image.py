import gtsam
import numpy as np

from akm_fg.posterior import JointPosterior
from akm_fg.records import PinholeCamera
from akm_fg.report.axis_image import axis_of_joint, project_axis
from factors.joint import Joint

CAMERA = PinholeCamera(200, 100, 100.0, 100.0, 100.0, 50.0)
AT_ORIGIN = gtsam.Pose3()
ALONG = np.linspace(-0.5, 0.5, 11)


def _line(R: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = [0, 0, 2.0]
    return T


ALONG_X = _line(np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]))  # z of the line is x of the camera


def test_uncertainty_across_the_line_becomes_pixels_by_the_focal_length_over_depth():
    cov = np.diag([0, 0, 0, 0, 0.02**2, 0])  # y of the line is z of the camera: not seen
    cov[3, 3] = 0.01**2  # x of the line is y of the camera: 0.01 m at 2 m is 0.5 px
    axis = project_axis(ALONG_X, cov, CAMERA, AT_ORIGIN, ALONG)
    np.testing.assert_allclose(axis.uv[:, 1], 50)
    np.testing.assert_allclose(axis.uv[[0, -1], 0], [75, 125])
    np.testing.assert_allclose(axis.half_width_px, 1.959964 * 0.5, rtol=1e-6)


def test_a_tilt_opens_the_band_away_from_its_origin():
    cov = np.diag([0, 0.02**2, 0, 0, 0, 0])  # about y of the line: moves s along x of the line
    axis = project_axis(ALONG_X, cov, CAMERA, AT_ORIGIN, ALONG)
    want = 1.959964 * np.abs(ALONG) * 0.02 * 100 / 2
    np.testing.assert_allclose(axis.half_width_px, want, rtol=1e-6, atol=1e-12)


def test_sampled_axes_lie_in_the_band_95_times_in_100():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    cov = 1e-5 * A @ A.T
    T = np.eye(4)
    T[:3, :3] = gtsam.Rot3.RzRyRx(0.4, 0.9, -0.3).matrix()
    T[:3, 3] = [0.1, -0.1, 1.5]
    axis = project_axis(T, cov, CAMERA, AT_ORIGIN, np.array([-0.2, 0.0, 0.3]))
    hits = []
    for xi in rng.multivariate_normal(np.zeros(6), cov, size=2000):
        moved = gtsam.Pose3(T).compose(gtsam.Pose3.Expmap(xi)).matrix()
        ends = moved[:3, 3] + np.array([[-1.0], [1.0]]) * 0.5 * moved[:3, 2]
        a, b = CAMERA.project(ends)
        across = np.array([a[1] - b[1], b[0] - a[0]])
        # where the sampled line meets the normal through each drawn point
        offset = ((a - axis.uv) @ across) / (axis.normal @ across)
        hits.append(np.abs(offset) <= axis.half_width_px)
    np.testing.assert_allclose(np.mean(hits, axis=0), 0.95, atol=0.02)


def test_pixels_that_are_not_square_widen_each_direction_by_its_own_focal_length():
    """1 cm of a point 2 m away: 0.5 px across at fx = 100, 1 px down at fy = 200."""
    camera = PinholeCamera(200, 100, 100.0, 200.0, 100.0, 50.0)
    cov = np.diag([0, 0, 0, 1e-4, 1e-4, 1e-4])
    axis = project_axis(ALONG_X, cov, camera, AT_ORIGIN, np.zeros(1))
    np.testing.assert_allclose(axis.cov_uv_px2[0], np.diag([0.5**2, 1.0**2]), atol=1e-9)


def test_the_pivot_ellipse_has_the_radius_of_two_dimensions():
    cov = np.zeros((6, 6))
    cov[3, 3] = 0.01**2
    axis = project_axis(ALONG_X, cov, CAMERA, AT_ORIGIN, ALONG)
    ellipse = axis.ellipse(0.0, n=4)
    # Tables: 5.991 is the 95 % quantile of chi-square with two degrees of freedom.
    np.testing.assert_allclose(np.ptp(ellipse[:, 1]), 2 * np.sqrt(5.991) * 0.5, rtol=1e-4)
    np.testing.assert_allclose(np.ptp(ellipse[:, 0]), 0, atol=1e-9)


def test_what_is_behind_the_camera_is_left_out():
    behind = ALONG_X.copy()
    behind[2, 3] = -2.0
    assert len(project_axis(behind, np.eye(6), CAMERA, AT_ORIGIN, ALONG).uv) == 0


def test_an_axis_seen_end_on_has_no_side():
    axis = project_axis(_line(np.eye(3)), np.eye(6), CAMERA, AT_ORIGIN, ALONG)
    middle = PinholeCamera(200, 100, 100.0, 100.0, 100.0, 50.0).project(np.array([0, 0, 2.0]))
    np.testing.assert_allclose(axis.uv, np.broadcast_to(middle, axis.uv.shape))
    assert np.isnan(axis.normal).all() and np.isnan(axis.half_width_px).all()


def test_the_arrow_of_a_drawer_moves_with_its_state():
    joint = JointPosterior(Joint("prismatic", ALONG_X, 0.0), np.eye(6) * 1e-4)
    axis = axis_of_joint(joint, 0.4, CAMERA, AT_ORIGIN, 0.2, n=3)
    np.testing.assert_allclose(axis.uv[:, 0], [120, 125, 130])
    assert axis.half_width_px[0] == 0 < axis.half_width_px[-1]


def test_an_axis_held_at_one_place_has_a_waist_there():
    # seen along y and along x of the line in turn, so that each tilt shows
    for about, along, sign, R in (
        (0, 4, 1, [[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]),
        (1, 3, -1, [[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]),
    ):
        direction = np.zeros(6)
        direction[about], direction[along] = 0.02, sign * 0.3 * 0.02  # still at 0.3 m
        cov = np.outer(direction, direction)
        axis = project_axis(_line(np.array(R)), cov, CAMERA, AT_ORIGIN, ALONG)
        want = 1.959964 * np.abs(ALONG - 0.3) * 0.02 * 100 / 2
        np.testing.assert_allclose(axis.half_width_px, want, rtol=1e-6, atol=1e-6)
