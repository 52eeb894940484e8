"""Errors that last: against the full covariance of a track over all its frames."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.measurements.lasting_errors import LastingModes, Slips
from factors.measurements.track_cost import TrackObservations, track_cost
from factors.measurements.track_information import (
    state_step,
    track_normal_equations,
    twist_jacobian,
)
from factors.motion_information import motion_information

GAUSSIAN, SCALE = 1e9, 1.3
LASTING = np.array([1, 4, 5])  # of eight tracks
ONE = np.ones((1, LASTING.size))


@pytest.fixture
def slipping(kind, scene):
    """A scene whose tracks 1, 4 and 5 slip in two ways, and what was seen of it."""
    s = scene(kind, points=8)
    s.p_world[0, :2] = np.nan
    s.p_world[2:, 5] = np.nan
    rng = np.random.default_rng(7)
    vectors = rng.normal(0, 0.008, (2, s.q.size, 3, LASTING.size))
    vectors *= np.isfinite(s.p_world[:, LASTING]).all(axis=-1)[:, None]
    s.p_world[:, LASTING] += np.einsum("mtil,ml->tli", vectors, rng.normal(size=(2, LASTING.size)))
    modes = LastingModes(LASTING, vectors, rng.uniform(0.5, 2.0, (2, LASTING.size)))
    return s, TrackObservations.from_points(s.p_world, s.cov_world, modes)


def _by_full_covariances(R, t, s, modes, x):
    """H (6 T, 6 T), g, squared error and log determinants by generalised least squares a track."""
    T, G = len(R), twist_jacobian(x)
    H, g, cost, log_det = np.zeros((6 * T, 6 * T)), np.zeros(6 * T), 0.0, 0.0
    for n in range(x.shape[1]):
        seen = np.flatnonzero(np.isfinite(s.p_world[:, n, 0]))
        z = np.einsum("tji,tj->ti", R[seen], s.p_world[seen, n] - t[seen]).ravel()
        cov = np.zeros((z.size, z.size))
        for k, f in enumerate(seen):
            here = slice(3 * k, 3 * k + 3)
            cov[here, here] = SCALE**2 * R[f].T @ s.cov_world[f, n] @ R[f]
        log_det -= np.linalg.slogdet(cov)[1]
        if n in modes.tracks:
            at = int(np.flatnonzero(modes.tracks == n)[0])
            for way, sd in zip(modes.vectors[..., at][:, seen], modes.sd[:, at], strict=True):
                off = np.einsum("tji,tj->ti", R[seen], way).ravel()
                cov += sd**2 * np.outer(off, off)
        X = np.tile(np.eye(3), (seen.size, 1))
        J = np.zeros((z.size, 6 * T))
        for k, f in enumerate(seen):
            J[3 * k : 3 * k + 3, 6 * f : 6 * f + 6] = G[:, :, n]
        inverse = np.linalg.inv(cov)
        A = X.T @ inverse @ X
        P = inverse - inverse @ X @ np.linalg.solve(A, X.T @ inverse)
        H += J.T @ P @ J
        g += J.T @ P @ z
        cost += z @ P @ z
        log_det += np.linalg.slogdet(cov)[1] + np.linalg.slogdet(A)[1]
    return H, g, cost, log_det


def test_free_motions_are_as_well_known_as_by_the_full_covariances(slipping):
    s, tracks = slipping
    R, t = s.joint.motion(s.q + np.array([0.0, 0.002, -0.003, 0.001]))
    form = motion_information(R, t, tracks, GAUSSIAN, SCALE)
    H, g, _, _ = _by_full_covariances(R, t, s, tracks.lasting, form.x_world)
    assert_allclose(form.information, H, atol=1e-7 * H.max())
    assert_allclose(form.gradient, g, atol=1e-6 * np.abs(g).max())
    blind = motion_information(R, t, replace(tracks, lasting=None), GAUSSIAN, SCALE)
    assert np.abs(blind.information - H).max() > 0.02 * H.max()


def test_cost_and_evidence_are_those_of_the_full_covariances(slipping):
    s, tracks = slipping
    q = s.q + np.array([0.0, 0.002, -0.003, 0.001])
    cost = track_cost(s.joint, q, tracks, GAUSSIAN, SCALE)
    R, t = s.joint.motion(q)
    _, _, twice, log_det = _by_full_covariances(R, t, s, tracks.lasting, cost.x_joint)
    assert_allclose(cost.twice_cost, twice, rtol=1e-6)
    assert_allclose(cost.log_det_latent, log_det, rtol=1e-9)


def test_chained_to_a_joint_both_forms_are_one(slipping, chained):
    s, tracks = slipping
    q = s.q + np.array([0.0, 0.002, -0.003, 0.001])
    H, g = track_normal_equations(s.joint, q, track_cost(s.joint, q, tracks, GAUSSIAN, SCALE))
    form = motion_information(*s.joint.motion(q), tracks, GAUSSIAN, SCALE)
    J = chained(s, q)
    assert_allclose(J.T @ form.information @ J, H, atol=1e-7 * H.max())
    assert_allclose(J.T @ form.gradient, g, atol=1e-6 * np.abs(g).max())


def test_a_state_is_solved_with_the_slips_that_were_found(scene):
    """Exact points that have slipped as found: the state is where it was."""
    s = scene("revolute", sigma=0, points=8)
    rng = np.random.default_rng(3)
    modes = LastingModes(LASTING, rng.normal(0, 0.01, (1, s.q.size, 3, LASTING.size)), ONE)
    amount = rng.normal(size=(1, LASTING.size))
    s.p_world[:, LASTING] += modes.off(amount).swapaxes(1, 2)
    tracks = TrackObservations.from_points(s.p_world, s.cov_world, modes)
    step, _ = state_step(s.joint, s.q, s.x_joint.T, tracks, GAUSSIAN, 1.0, Slips(LASTING, amount))
    assert_allclose(step, 0, atol=1e-12)
    blind, _ = state_step(s.joint, s.q, s.x_joint.T, tracks, GAUSSIAN, 1.0)
    assert np.abs(blind).max() > 1e-3


def test_an_outlier_of_a_slipping_track_loses_its_weight(slipping):
    s, _ = slipping
    s.p_world[3, 4] += 0.3
    modes = slipping[1].lasting
    tracks = TrackObservations.from_points(s.p_world, s.cov_world, modes)
    cost = track_cost(s.joint, s.q, tracks, 4.0, 1.0)
    assert cost.d2[3, 4] > 500
    assert np.median(cost.d2[:3, 4]) < 12


def test_what_the_part_takes_with_it_is_no_error_of_its_motion(slipping):
    """Off alike as the part itself sees it: the latent point takes it up."""
    s, _ = slipping
    R, t = s.joint.motion(s.q)
    fixed = np.random.default_rng(2).normal(0, 0.05, (1, 1, 3, LASTING.size))
    seen = np.isfinite(s.p_world[:, LASTING]).all(axis=-1)
    modes = LastingModes(LASTING, (R @ fixed) * seen[:, None], ONE)
    with_it = TrackObservations.from_points(s.p_world, s.cov_world, modes)
    without = TrackObservations.from_points(s.p_world, s.cov_world)
    forms = [motion_information(R, t, each, GAUSSIAN, 1.0) for each in (with_it, without)]
    H = forms[1].information
    assert_allclose(forms[0].information, H, atol=1e-7 * H.max())


def test_tracks_and_frames_keep_what_lasts(slipping):
    _, tracks = slipping
    some = tracks.select(np.array([0, 4, 5, 7])).at(np.array([0, 2]))
    assert some.lasting.tracks.tolist() == [1, 2]
    assert_allclose(some.lasting.vectors, tracks.lasting.vectors[:, [0, 2]][..., 1:])
    assert tracks.select(np.array([0, 2])).lasting is None
