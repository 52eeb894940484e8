"""From tracks to a posterior: truth from clean data, and what must not change the answer."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import AkmError, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.records import PointTracks

OTHER = {"revolute": "prismatic", "prismatic": "revolute"}
TANGENT = ("wx", "wy", "wz", "vx", "vy", "vz")


def _axis_between_rad(a, b):
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def test_noise_free_tracks_give_the_truth_back(kind, opening, score):
    truth = opening(0, kind, noise_m=0.0)
    posterior = fit_tracks(truth.tracks)
    error = score(posterior, truth)
    assert posterior.kind == kind
    assert error.axis_error_rad < 1e-6
    assert error.pivot_error_m < 1e-6
    assert_allclose(error.state_error, 0.0, atol=1e-6)


def test_noisy_tracks_give_the_kind_and_the_joint_near_the_truth(kind, opening, score):
    truth = opening(1, kind)
    posterior = fit_tracks(truth.tracks)
    error = score(posterior, truth)
    assert posterior.kind == kind
    assert posterior.kind_probability[kind] > 0.99
    assert posterior.fit.parametric
    assert np.degrees(error.axis_error_rad) < 0.5
    assert error.pivot_error_m < 0.005
    sd = posterior.best.states.sd
    assert np.abs(error.state_error[1:] / sd[1:]).max() < 4


@pytest.mark.parametrize(("points", "frames"), [(40, 20), (40, 12), (8, 20)])
def test_what_does_not_move_is_rigid_and_nothing_speaks_against_it(points, frames, opening):
    for seed in range(3):
        still = opening(seed, "prismatic", travel=0.0, points=points, frames=frames)
        posterior = fit_tracks(still.tracks)
        assert posterior.fit.parametric
        assert posterior.kind == "rigid"
        assert posterior.best.joint is None and posterior.best.states is None


def test_probabilities_of_the_kinds_sum_to_one(kind, opening):
    for frames in (3, 20):
        probability = fit_tracks(opening(0, kind, frames=frames).tracks).kind_probability
        assert {"rigid", "prismatic", "revolute"} <= set(probability)
        assert_allclose(sum(probability.values()), 1.0)
        assert min(probability.values()) >= 0


def test_a_barely_opened_drawer_is_left_undecided_or_right(opening):
    """At two millimetres of travel a wrong kind must not be named."""
    for seed in range(3):
        truth = opening(seed, "prismatic", travel=0.002, points=8, frames=5)
        assert fit_tracks(truth.tracks).kind in ("undecided", "prismatic", "rigid")


def test_gauge_directions_have_no_covariance_and_the_others_have(kind, opening):
    joint = fit_tracks(opening(2, kind).tracks).best.joint
    gauge = [TANGENT.index(name) for name in joint.gauge]
    others = [i for i in range(6) if i not in gauge]
    assert joint.gauge == {"revolute": ("wz", "vz"), "prismatic": ("wz", "vx", "vy", "vz")}[kind]
    assert_allclose(joint.cov[gauge], 0.0)
    assert_allclose(joint.cov, joint.cov.T)
    assert np.linalg.eigvalsh(joint.cov[np.ix_(others, others)])[0] > 0


def test_pivot_is_the_point_of_the_axis_nearest_to_the_moving_points(opening):
    truth = opening(3, "revolute")
    joint = fit_tracks(truth.tracks).best.joint
    centroid = truth.tracks.p_world[0].mean(axis=0)
    assert abs((centroid - joint.pivot) @ joint.axis) < 2e-3


def test_axis_points_along_growing_states(kind, opening):
    """Also where the truth's own axis points the other way: its states then fall."""
    for seed in range(2):
        truth = opening(seed, kind, steady=True)
        fit = fit_tracks(truth.tracks).best
        assert fit.states.mean[-1] > 0
        assert fit.joint.axis @ truth.axis > 0.99


def test_frames_in_reverse_give_the_same_axis_pointing_back(kind, opening):
    truth = opening(4, kind, steady=True)
    backward = PointTracks(truth.tracks.p_world[::-1], truth.tracks.cov_world[::-1])
    there, back = fit_tracks(truth.tracks).best, fit_tracks(backward).best
    assert _axis_between_rad(there.joint.axis, -back.joint.axis) < 0.05 * there.joint.axis_sd_rad
    assert_allclose(back.joint.axis_sd_rad, there.joint.axis_sd_rad, rtol=0.02)
    assert_allclose(back.states.mean[-1], there.states.mean[-1], rtol=1e-3)
    if kind == "revolute":  # the same line: the pivot may slide along it
        across = np.cross(back.joint.pivot - there.joint.pivot, there.joint.axis)
        assert np.linalg.norm(across) < 0.1 * there.joint.pivot_sd_m


def test_a_moved_and_turned_world_moves_and_turns_the_joint(kind, opening):
    truth = opening(5, kind)
    W = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([1.0, -2.0, 0.5])), np.array([0.7, -1.0, 2.0]))
    R, t = W.rotation().matrix(), W.translation()
    p, cov = truth.tracks.p_world, truth.tracks.cov_world
    here, there = fit_tracks(truth.tracks), fit_tracks(PointTracks(p @ R.T + t, R @ cov @ R.T))
    a, b = here.best.joint, there.best.joint
    assert there.kind == here.kind
    assert _axis_between_rad(R @ a.axis, b.axis) < 0.05 * a.axis_sd_rad
    assert_allclose(b.axis_sd_rad, a.axis_sd_rad, rtol=0.02)
    spread = 0.05 * here.best.states.sd[1:].min()
    assert_allclose(there.best.states.mean, here.best.states.mean, atol=spread)
    assert_allclose(there.fit.log_evidence, here.fit.log_evidence, atol=0.2)
    if kind == "revolute":
        assert_allclose(b.pivot, R @ a.pivot + t, atol=0.05 * a.pivot_sd_m)
        assert_allclose(b.pivot_sd_m, a.pivot_sd_m, rtol=0.02)


def test_the_order_of_the_tracks_hardly_matters(kind, opening):
    truth = opening(6, kind, wild_share=0.1)
    order = np.random.default_rng(0).permutation(40)
    a, b = (fit_tracks(t).best for t in (truth.tracks, truth.tracks.select(order)))
    assert _axis_between_rad(a.joint.axis, b.joint.axis) < 0.3 * a.joint.axis_sd_rad
    assert_allclose(b.joint.axis_sd_rad, a.joint.axis_sd_rad, rtol=0.1)


def test_the_same_input_and_seed_give_the_same_answer(opening):
    truth = opening(7, "revolute", wild_share=0.2)
    a, b = (fit_tracks(truth.tracks, seed=3) for _ in range(2))
    assert_allclose(a.best.joint.T_world_joint, b.best.joint.T_world_joint, rtol=0, atol=0)
    assert a.kind_probability == b.kind_probability


def test_the_input_is_left_as_it_was(opening):
    truth = opening(8, "revolute")
    p, cov = truth.tracks.p_world.copy(), truth.tracks.cov_world.copy()
    fit_tracks(truth.tracks)
    assert (truth.tracks.p_world == p).all() and (truth.tracks.cov_world == cov).all()


def test_tracks_with_gaps_and_late_starts_give_the_joint(kind, opening, score):
    truth = opening(9, kind)
    rng = np.random.default_rng(0)
    p, cov = truth.tracks.p_world, truth.tracks.cov_world
    lost = rng.random(p.shape[:2]) < 0.2
    lost[:8, :8] = True  # late starts
    lost[10:, 8:16] = True  # early ends
    lost[:, 16] = True  # never seen
    lost[:3, 17], lost[4:, 17] = True, True  # seen once
    p[lost], cov[lost] = np.nan, np.nan
    posterior = fit_tracks(truth.tracks)
    error = score(posterior, truth)
    assert posterior.kind == kind
    assert error.nees < 25
    assert np.degrees(error.axis_error_rad) < 1.0
    assert posterior.fit.tracks_used + posterior.fit.tracks_rejected == 38


def test_a_frame_in_which_nothing_was_seen_has_no_state_or_an_uncertain_one(opening):
    truth = opening(10, "revolute")
    truth.tracks.p_world[7], truth.tracks.cov_world[7] = np.nan, np.nan
    posterior = fit_tracks(truth.tracks)
    states = posterior.best.states
    assert posterior.kind == "revolute"
    assert states.mean.shape == (20,)
    assert np.isnan(states.mean[7]) or states.sd[7] > 5 * np.nanmedian(states.sd)
    others = np.delete(np.arange(20), 7)
    assert_allclose(states.mean[others], truth.q[others], atol=0.05)


def test_less_certain_observations_widen_the_posterior(kind, opening):
    truth = opening(11, kind)
    noisier = opening(11, kind, noise_m=0.006)
    wide = PointTracks(noisier.tracks.p_world, 4 * noisier.tracks.cov_world)
    narrow_sd, wide_sd = (fit_tracks(t).best.joint.axis_sd_rad for t in (truth.tracks, wide))
    assert_allclose(wide_sd, 2 * narrow_sd, rtol=0.1)


def test_a_nominal_noise_level_is_replaced_by_the_one_in_the_data(kind, opening):
    """Ten times too wide covariances, said to be nominal: the posterior is as wide as it was."""
    truth = opening(12, kind)
    nominal = PointTracks(truth.tracks.p_world, 100 * truth.tracks.cov_world)
    known = fit_tracks(truth.tracks)
    found = fit_tracks(nominal, noise_known=False)
    assert found.kind == kind
    assert_allclose(found.best.joint.axis_sd_rad, known.best.joint.axis_sd_rad, rtol=0.1)


def test_one_track_in_five_drifting_is_found_and_dropped(kind, opening, score):
    truth = opening(13, kind, wild_share=0.2)
    posterior = fit_tracks(truth.tracks)
    assert posterior.kind == kind
    assert posterior.fit.tracks_rejected >= 7
    assert posterior.fit.tracks_used >= 30
    assert score(posterior, truth).nees < 25


def test_what_no_joint_does_is_not_given_one(opening):
    """A part that wobbles by some ten degrees about three axes while it slides."""
    truth = opening(14, "prismatic", steady=True)
    p, t = truth.tracks.p_world, np.linspace(0, 2 * np.pi, 20)
    centre = p[0].mean(axis=0)
    for k in range(20):
        turn = 0.3 * np.array([np.sin(t[k]), np.sin(2 * t[k]), np.sin(3 * t[k])])
        p[k] = (p[k] - centre) @ gtsam.Rot3.Expmap(turn).matrix().T + centre
    posterior = fit_tracks(truth.tracks)
    assert not posterior.fit.parametric
    assert posterior.kind == "undecided"


def test_more_frames_than_fit_the_graph_still_get_their_states(opening):
    truth = opening(15, "revolute", frames=90, points=12, steady=True)
    config = replace(FitConfig(), max_frames=20)
    states = fit_tracks(truth.tracks, config=config).best.states
    assert states.mean.shape == states.sd.shape == (90,)
    assert np.isfinite(states.mean).all()
    assert (states.sd[1:] > 0).all() and states.sd.max() < 0.02
    whitened = (states.mean[1:] - truth.q[1:]) / states.sd[1:]
    assert np.abs(whitened).max() < 4.5
    assert 0.3 < np.sqrt((whitened**2).mean()) < 1.7


def test_name_and_time_are_in_the_answer(opening):
    posterior = fit_tracks(opening(0, "revolute", frames=5).tracks, name="left door")
    assert posterior.name == "left door"
    assert posterior.time_s["total"] > 0


def test_one_frame_is_not_enough(opening):
    tracks = opening(0, "revolute", frames=20).tracks
    with pytest.raises(TracksLost, match=r"drawer 7: .* seen in two frames"):
        fit_tracks(PointTracks(tracks.p_world[:1], tracks.cov_world[:1]), name="drawer 7")


def test_tracks_that_are_all_lost_after_the_first_frame_are_named_as_the_cause(opening):
    tracks = opening(0, "revolute").tracks
    tracks.p_world[1:] = np.nan
    with pytest.raises(TracksLost, match="seen in two frames"):
        fit_tracks(tracks)


def test_no_tracks_at_all_are_named_as_the_cause():
    with pytest.raises(TracksLost):
        fit_tracks(PointTracks(np.zeros((5, 0, 3)), np.zeros((5, 0, 3, 3))))


@pytest.mark.parametrize("points", [1, 2, 3])
@pytest.mark.parametrize("frames", [2, 3, 6])
def test_hardly_any_data_end_in_an_answer_or_a_named_cause(points, frames, opening):
    truth = opening(0, "revolute", points=points, frames=frames, steady=True)
    try:
        posterior = fit_tracks(truth.tracks)
    except AkmError as cause:
        assert len(str(cause)) > 20
    else:
        assert_allclose(sum(posterior.kind_probability.values()), 1.0)
        assert posterior.kind in ("undecided", "revolute", "prismatic")


def test_a_single_point_on_a_wide_arc_is_a_hinge(opening):
    truth = opening(16, "revolute", travel=1.2, points=1, frames=40, steady=True, noise_m=0.001)
    tracks = PointTracks(truth.tracks.p_world, truth.tracks.cov_world / 9)
    posterior = fit_tracks(tracks)
    assert posterior.kind == "revolute"
    assert np.degrees(_axis_between_rad(posterior.best.joint.axis, truth.axis)) < 3


def test_frames_outside_the_graph_get_their_own_states_however_they_jump(kind, opening, score):
    """States at random: what lies between two keyframes says nothing of the frame between."""
    truth = opening(4, kind, frames=100)
    posterior = fit_tracks(truth.tracks)
    states = posterior.best.states
    error = score(posterior, truth).state_error
    assert np.isfinite(states.mean).all()
    assert np.abs(error[1:] / states.sd[1:]).max() < 4.5
    assert np.mean(np.abs(error[1:]) < 1.96 * states.sd[1:]) > 0.85
    assert states.sd[1:].max() < 2 * np.median(states.sd[1:])
