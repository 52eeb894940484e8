"""The tracks' quadratic form around free motions: against the point-track factor and its cost."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import central_difference
from factors.measurements.track_cost import TrackObservations, track_cost
from factors.measurements.track_information import track_normal_equations
from factors.motion_information import latent_points, motion_information
from factors.student_t import twice_negative_log_kernel

GAUSSIAN, ROBUST = 1e9, 4.0


def _motions(s, size=2e-3, seed=3):
    """Motions near but not at the scene's own, and not of any joint."""
    R, t = s.joint.motion(s.q)
    rng = np.random.default_rng(seed)
    return _moved(R, t, rng.normal(0, size, (s.q.size, 6)))


def _moved(R, t, d):
    """M_t Exp(d_t), d (T, 6)."""
    moved = [
        gtsam.Pose3(gtsam.Rot3(a), b).compose(gtsam.Pose3.Expmap(c)).matrix()
        for a, b, c in zip(R, t, d, strict=True)
    ]
    return np.array(moved)[:, :3, :3], np.array(moved)[:, :3, 3]


@pytest.mark.parametrize("isotropic", [True, False])
def test_chained_to_a_joint_it_is_the_point_track_factors_normal_equations(
    kind, case, isotropic, scene, chained
):
    """At a joint's own motions; with gaps, and the same latent points in both."""
    s = scene(kind, case, isotropic=isotropic, points=8)
    s.p_world[0, :2] = np.nan
    s.p_world[2:, 4] = np.nan
    q = s.q + np.array([0.0, 0.003, -0.002, 0.004])
    cost = track_cost(s.joint, q, s.tracks, GAUSSIAN, 1.3)
    H, g = track_normal_equations(s.joint, q, cost)
    motions = motion_information(*s.joint.motion(q), s.tracks, GAUSSIAN, 1.3)
    J = chained(s, q)
    assert_allclose(motions.d2, cost.d2, rtol=1e-6, atol=1e-7)
    assert_allclose(J.T @ motions.information @ J, H, atol=1e-7 * H.max())
    assert_allclose(J.T @ motions.gradient, g, atol=1e-6 * np.abs(g).max())


@pytest.mark.parametrize(("dof", "tolerance"), [(GAUSSIAN, 1e-5), (ROBUST, 3e-2)])
def test_gradient_is_that_of_the_cost_with_latent_points_at_their_best(kind, dof, tolerance, scene):
    """The robust latent points stop short of their best: hence the second tolerance."""
    s = scene(kind, points=7)
    s.p_world[1, 3] = np.nan
    R, t = _motions(s)

    def half_cost(d):
        _, d2 = latent_points(*_moved(R, t, d.reshape(-1, 6)), s.tracks, dof, 1.2)
        return np.array([twice_negative_log_kernel(d2, dof, 3).sum() / 2])

    form = motion_information(R, t, s.tracks, dof, 1.2)
    numeric = central_difference(half_cost, np.zeros(24), 3e-5)[0]
    largest = np.abs(numeric).max()
    assert largest > 10
    assert_allclose(form.gradient, numeric, atol=tolerance * largest)


def test_information_is_half_the_curvature_of_a_gaussian_cost_at_exact_points(scene):
    s = scene("revolute", sigma=0)
    R, t = s.joint.motion(s.q)

    def gradient(d):
        return motion_information(*_moved(R, t, d.reshape(-1, 6)), s.tracks, GAUSSIAN, 1.0).gradient

    H = motion_information(R, t, s.tracks, GAUSSIAN, 1.0).information
    numeric = central_difference(gradient, np.zeros(24), 1e-5)
    assert_allclose(H, numeric, atol=1e-5 * H.max())


@pytest.mark.parametrize("isotropic", [True, False])
def test_a_correction_common_to_all_frames_costs_nothing(kind, isotropic, scene):
    s = scene(kind, isotropic=isotropic)
    form = motion_information(*_motions(s), s.tracks, ROBUST, 1.0)
    common = np.tile(np.eye(6), (4, 1))
    largest = form.information.max()
    assert_allclose(form.information @ common, 0.0, atol=1e-11 * largest)
    assert_allclose(form.gradient @ common, 0.0, atol=1e-9 * np.abs(form.gradient).max())
    eigenvalues = np.linalg.eigvalsh(form.information)
    assert (eigenvalues[6:] > 1e-7 * largest).all()  # nothing else is free


def test_one_number_and_six_numbers_a_covariance_give_the_same_form(kind, scene):
    s = scene(kind, isotropic=True, points=8)
    s.p_world[2, 5] = np.nan
    nearly = s.cov_world.copy()
    nearly[..., 1, 1] *= 1 + 1e-12
    six = TrackObservations.from_points(s.p_world, nearly)
    assert six.information_world.shape[1] == 6 and s.tracks.information_world.shape[1] == 1
    one, other = (motion_information(*_motions(s), t, ROBUST, 1.1) for t in (s.tracks, six))
    assert_allclose(one.information, other.information, atol=1e-9 * one.information.max())
    assert_allclose(one.gradient, other.gradient, atol=1e-8 * np.abs(one.gradient).max())


def test_a_point_seen_once_says_nothing_of_the_motions(kind, scene):
    s, without = scene(kind, points=7), scene(kind, points=7)
    s.p_world[1:, 3] = np.nan
    keep = [0, 1, 2, 4, 5, 6]
    fewer = TrackObservations.from_points(without.p_world[:, keep], without.cov_world[:, keep])
    forms = [motion_information(*_motions(s), t, ROBUST, 1.0) for t in (s.tracks, fewer)]
    assert_allclose(forms[0].d2[1:, 3], 0.0)
    assert_allclose(forms[0].d2[:, keep], forms[1].d2, atol=1e-9)
    largest = forms[1].information.max()
    assert_allclose(forms[0].information, forms[1].information, atol=1e-9 * largest)
    assert_allclose(forms[0].gradient, forms[1].gradient, atol=1e-6 * np.sqrt(largest))


def test_a_frame_in_which_nothing_is_seen_is_free(scene):
    s = scene("revolute")
    s.p_world[2] = np.nan
    form = motion_information(*_motions(s), s.tracks, ROBUST, 1.0)
    assert_allclose(form.information[12:18], 0.0, atol=1e-12 * form.information.max())
    assert_allclose(form.gradient[12:18], 0.0)


def test_two_frames_and_one_point_hold_their_distance_by_half_its_information():
    """By hand: two observations of variance v; sliding one of them by d costs d^2 / (2 v) / 2."""
    tracks = TrackObservations.from_points(
        np.zeros((2, 1, 3)), np.tile(1e-4 * np.eye(3), (2, 1, 1, 1))
    )
    form = motion_information(
        np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), tracks, GAUSSIAN, 1.0
    )
    slide = form.information[3:6, 3:6]
    assert_allclose(slide, np.eye(3) / 2e-4, rtol=1e-7)
    assert_allclose(form.information[3:6, 9:12], -np.eye(3) / 2e-4, rtol=1e-7)
    assert_allclose(form.information[:3], 0.0, atol=1e-9)  # a point at the origin does not turn


def test_latent_points_are_the_scenes_own_at_the_true_motions(kind, scene):
    """In the reference pose, in world."""
    s = scene(kind, sigma=0)
    x, d2 = latent_points(*s.joint.motion(s.q), s.tracks, ROBUST, 1.0)
    assert_allclose(x, s.p_world[0].T, atol=1e-12)
    assert_allclose(d2, 0.0, atol=1e-15)


def test_motions_of_another_number_of_frames_are_refused(scene):
    s = scene()
    R, t = s.joint.motion(s.q)
    with pytest.raises(ValueError, match="tracks have 4 frames"):
        motion_information(R[:3], t[:3], s.tracks, ROBUST, 1.0)
    with pytest.raises(ValueError, match="tracks have 4 frames"):
        latent_points(R, t[:3], s.tracks, ROBUST, 1.0)
