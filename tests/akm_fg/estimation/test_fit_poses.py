"""From the poses of one marker to a posterior, with nothing known of the noise."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_poses
from akm_fg.records import PoseTrack


def _handle(seed, kind, travel, frames=30, noise_m=0.001, noise_rad=0.01):
    """A marker on a handle half a metre from the hinge; returns track, axis, pivot, states."""
    rng = np.random.default_rng(seed)
    W = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3), rng.normal(size=3) / 2]))
    q = np.linspace(0, travel, frames)
    p, R = [], []
    for state in q:
        if kind == "revolute":
            motion = gtsam.Pose3(gtsam.Rot3.Rz(state), np.zeros(3))
        else:
            motion = gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, state]))
        pose = W * motion * gtsam.Pose3(gtsam.Rot3.Ry(0.4), np.array([0.5, 0.0, 0.1]))
        p.append(pose.translation() + noise_m * rng.normal(size=3))
        R.append(pose.rotation().retract(noise_rad * rng.normal(size=3)).matrix())
    R_world = W.rotation().matrix()
    return PoseTrack(np.array(p), np.array(R)), R_world[:, 2], W.translation(), q


TRAVEL = {"revolute": 1.0, "prismatic": 0.3}


def test_noise_free_poses_give_the_truth_back(kind):
    poses, axis, pivot, q = _handle(0, kind, TRAVEL[kind], noise_m=0.0, noise_rad=0.0)
    posterior = fit_poses(poses)
    fit = posterior.best
    assert posterior.kind == kind
    assert_allclose(fit.joint.axis, axis, atol=1e-5)
    assert_allclose(fit.states.mean, q, atol=1e-5)
    if kind == "revolute":
        across = np.cross(fit.joint.pivot - pivot, axis)
        assert_allclose(across, 0.0, atol=1e-4)  # the hinge-distance prior pulls a little


@pytest.mark.parametrize("with_orientations", [True, False])
def test_noisy_poses_or_positions_give_the_kind_and_the_axis(kind, with_orientations):
    poses, axis, _, q = _handle(1, kind, TRAVEL[kind])
    if not with_orientations:
        poses = PoseTrack(poses.p_world)
    posterior = fit_poses(poses)
    assert posterior.kind == kind
    assert np.degrees(np.arccos(min(posterior.best.joint.axis @ axis, 1.0))) < 2.0
    assert_allclose(posterior.best.states.mean, q, atol=0.03)


@pytest.mark.parametrize("noise_m", [0.0, 1e-6, 1e-5, 1e-4])
def test_a_door_is_told_from_positions_however_precise_they_are(noise_m):
    """Residuals far below what a hinge's play leaves are no evidence of slow errors."""
    poses, axis, _, _ = _handle(8, "revolute", 1.0, frames=60, noise_m=noise_m)
    posterior = fit_poses(PoseTrack(poses.p_world))
    assert posterior.kind == "revolute"
    assert_allclose(posterior.best.joint.axis, axis, atol=0.01)


def test_a_drawer_with_one_orientation_off_by_45_degrees_stays_a_drawer():
    poses, axis, _, _ = _handle(2, "prismatic", 0.3)
    poses.R_world_part[12] = poses.R_world_part[12] @ gtsam.Rot3.Ry(np.pi / 4).matrix()
    posterior = fit_poses(poses)
    assert posterior.kind == "prismatic"
    assert posterior.fit.parametric
    assert_allclose(posterior.best.joint.axis, axis, atol=0.01)


def test_a_door_with_one_orientation_flipped_stays_a_door():
    poses, axis, _, _ = _handle(3, "revolute", 1.0)
    poses.R_world_part[12] = poses.R_world_part[12] @ gtsam.Rot3.Rx(np.pi).matrix()
    posterior = fit_poses(poses)
    assert posterior.kind == "revolute"
    assert_allclose(posterior.best.joint.axis, axis, atol=0.03)


def test_a_drawer_with_one_position_off_by_ten_centimetres_stays_a_drawer():
    poses, axis, _, _ = _handle(4, "prismatic", 0.3)
    poses.p_world[20] += [0.1, 0.0, 0.0]
    posterior = fit_poses(poses)
    assert posterior.kind == "prismatic"
    assert_allclose(posterior.best.joint.axis, axis, atol=0.03)


def test_pivot_of_a_path_is_the_point_of_the_axis_nearest_to_its_start():
    poses, *_ = _handle(9, "revolute", 1.0)
    joint = fit_poses(poses).best.joint
    assert abs((poses.p_world[0] - joint.pivot) @ joint.axis) < 1e-5


def test_orientations_make_the_axis_of_a_door_better_known():
    poses, *_ = _handle(5, "revolute", 0.3)
    with_them = fit_poses(poses).alternatives["revolute"].joint.axis_sd_rad
    without = fit_poses(PoseTrack(poses.p_world)).alternatives["revolute"].joint.axis_sd_rad
    assert with_them < without


def test_a_marker_at_rest_is_rigid_or_undecided():
    rng = np.random.default_rng(6)
    posterior = fit_poses(PoseTrack(np.array([1.0, 2.0, 3.0]) + 0.001 * rng.normal(size=(60, 3))))
    assert posterior.kind in ("rigid", "undecided")
    assert max(posterior.kind_probability, key=posterior.kind_probability.get) == "rigid"


def test_probabilities_sum_to_one_and_states_cover_every_frame():
    poses, *_ = _handle(7, "revolute", 1.0, frames=90)
    posterior = fit_poses(poses)
    assert_allclose(sum(posterior.kind_probability.values()), 1.0)
    assert posterior.best.states.mean.shape == posterior.best.states.sd.shape == (90,)
    assert np.isfinite(posterior.best.states.mean).all()


def test_one_pose_is_not_enough():
    with pytest.raises(TracksLost, match=r"hatch: one frame"):
        fit_poses(PoseTrack(np.zeros((1, 3))), name="hatch")


def test_what_positions_err_by_does_not_sharpen_orientations():
    """The axis of a hinge known by its orientations: inside its 95 % region as often as that says.

    The share of the travel that a path may be off makes the positions' residuals small against
    their noise; their correction once made orientations ten times as sure as they were.
    """
    inside = 0
    for seed in range(15):
        poses, axis, _, _ = _handle(seed, "revolute", 1.0, 40, noise_m=0.002, noise_rad=0.005)
        joint = fit_poses(poses).alternatives["revolute"].joint
        inside += np.arccos(min(abs(joint.axis @ axis), 1.0)) <= joint.axis_bound_rad()
    assert inside >= 12  # of binomial(15, 0.95), 12 or more in 99.5 of 100 cases


def _turning(turns, frames, radius_m=0.2, pitch_m=0.0, noise_m=0.001, noise_rad=0.005, seed=0):
    """A marker that goes about the z axis for so many turns, `pitch_m` a turn."""
    rng = np.random.default_rng(seed)
    q = np.linspace(0, 2 * np.pi * turns, frames)
    p = np.column_stack([radius_m * np.cos(q), radius_m * np.sin(q), pitch_m * q / (2 * np.pi)])
    R = [gtsam.Rot3.Rz(a).retract(noise_rad * rng.normal(size=3)).matrix() for a in q]
    return PoseTrack(p + noise_m * rng.normal(size=p.shape), np.array(R)), q


@pytest.mark.parametrize("with_orientations", [True, False])
@pytest.mark.parametrize("turns", [0.97, 3.0])
def test_states_run_on_over_full_turns(turns, with_orientations):
    poses, q = _turning(turns, 120)
    if not with_orientations:
        poses = PoseTrack(poses.p_world)
    posterior = fit_poses(poses)
    assert posterior.kind == "revolute"
    assert_allclose(posterior.best.states.mean, q, atol=0.05)
    assert not any("too far apart" in text for text in posterior.fit.warnings)


def test_a_lid_of_two_and_a_half_turns_is_a_screw():
    poses, q = _turning(2.5, 100, radius_m=0.04, pitch_m=0.004, noise_m=0.0005)
    posterior = fit_poses(poses)
    assert posterior.kind == "helical"
    assert_allclose(posterior.best.joint.pitch_m_per_rad, 0.004 / (2 * np.pi), atol=1e-4)
    assert_allclose(posterior.best.states.mean, q, atol=0.05)


def test_where_frames_are_half_a_turn_apart_the_count_of_turns_is_not_vouched_for():
    poses, _ = _turning(6.0, 15)
    posterior = fit_poses(poses)
    assert any("too far apart to count" in text for text in posterior.fit.warnings)


@pytest.mark.parametrize("seed", range(5))
def test_a_slider_whose_hand_tilts_by_a_degree_and_a_half_is_no_door(seed):
    """2.5 cm, the tilt grows along the way: a door of a metre's radius would turn so."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 0.025, 150)
    p = np.column_stack([s, np.zeros_like(s), np.zeros_like(s)])
    p += 0.0003 * np.sin(np.pi * s / 0.025)[:, None] * rng.normal(size=3)
    p += 1e-5 * rng.normal(size=p.shape)
    tilt = np.radians(1.5) * s / s[-1]
    R = np.array([gtsam.Rot3.Rz(a).matrix() for a in tilt])
    assert fit_poses(PoseTrack(p, R)).kind != "revolute"


def _tag_on_a_drawer(seed, frames=150, noise_m=0.012, noise_rad=0.07):
    """Its corners are biased with the view: in step with the way, by two noises and more."""
    rng = np.random.default_rng(seed)
    way = np.linspace(-1, 1, frames)
    p = np.column_stack([0.125 * way, 2.0 * noise_m * way**2, np.zeros(frames)])
    p += noise_m * rng.normal(size=p.shape)
    biased = [gtsam.Rot3.Rz(2.5 * noise_rad * w) for w in way]
    R = [turn.retract(noise_rad * rng.normal(size=3)).matrix() for turn in biased]
    return PoseTrack(p, np.array(R))


@pytest.mark.parametrize("seed", [0, 2])
def test_a_drawer_whose_tag_wanders_in_step_with_it_is_no_door(seed):
    posterior = fit_poses(_tag_on_a_drawer(seed))
    assert posterior.kind == "undecided"
    assert any("as a tag's orientation is" in said for said in posterior.fit.warnings)


def test_a_door_with_a_tag_as_noisy_stays_a_door():
    poses, *_ = _handle(2, "revolute", 1.2, 150, noise_m=0.012, noise_rad=0.07)
    assert fit_poses(poses).kind == "revolute"


def test_a_drawer_does_not_explain_a_turn_of_42_degrees_as_noise():
    """A stapler: seven centimetres from the hinge, 3 mm of slow errors on a path of 5 cm."""
    rng = np.random.default_rng(1)
    q = np.linspace(0, np.radians(42), 120)
    p = 0.07 * np.column_stack([np.cos(q), np.sin(q), 0 * q])
    p += 0.003 * np.cos(3 * np.pi * q / q[-1])[:, None] * [0.6, 0.3, 0.7]
    p += 2e-5 * rng.normal(size=p.shape)
    R = np.array([gtsam.Rot3.Rz(a).matrix() for a in q])
    posterior = fit_poses(PoseTrack(p, R))
    assert posterior.kind in ("revolute", "undecided")
    assert posterior.kind_probability["prismatic"] < 0.05


@pytest.mark.parametrize("bend_m", [0.0, 0.0002])
def test_a_vague_hinge_wins_nothing_by_its_volume(bend_m):
    """Prior and volume together are what the prior allows; no bound is above half a turn."""
    rng = np.random.default_rng(2)
    s = np.linspace(0, 0.02, 100)
    p = np.column_stack([s, bend_m * np.sin(np.pi * s / 0.02), 0 * s])
    posterior = fit_poses(PoseTrack(p + 1e-5 * rng.normal(size=p.shape)))
    hinge = posterior.alternatives["revolute"]
    assert hinge.evidence.log_joint_prior + hinge.evidence.log_joint_volume < 1.0
    assert hinge.joint.axis_bound_rad() < np.pi
    assert posterior.kind != "revolute"


def test_a_hinge_is_found_by_the_turn_of_its_marker_where_the_path_bends_too_little():
    poses, axis, pivot, _ = _handle(11, "revolute", 0.25, 60, noise_m=0.003, noise_rad=0.003)
    hinge = fit_poses(poses).alternatives["revolute"].joint
    assert np.degrees(np.arccos(min(abs(hinge.axis @ axis), 1.0))) < 3.0
    assert np.linalg.norm(np.cross(hinge.pivot - pivot, axis)) < 0.1


def _off_the_way(amplitude_m, seed, waves=3.0):
    """A handle on an arc of half a metre, led off it by a smooth wave, as by a four-bar linkage."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0, 1, 100)
    q, phase = 0.9 * u, rng.uniform(0, 2 * np.pi)
    r = 0.5 + amplitude_m * np.sin(waves * np.pi * u + phase)
    p = np.column_stack([r * np.cos(q), r * np.sin(q), 0 * u])
    return PoseTrack(p + 0.001 * rng.normal(size=p.shape))


@pytest.mark.parametrize("seed", range(6))
def test_a_smooth_path_two_centimetres_off_every_joint_is_none(seed):
    """Smooth misfit looks like correlated noise; 2 % of this way of 45 cm are 9 mm."""
    posterior = fit_poses(_off_the_way(0.028, seed))
    assert not posterior.fit.parametric
    assert posterior.kind == "undecided"


@pytest.mark.parametrize("seed", range(6))
def test_a_door_with_systematic_errors_of_two_per_cent_is_a_joint(seed):
    assert fit_poses(_off_the_way(0.009 * np.sqrt(2), seed)).fit.parametric


def test_a_kind_that_larger_systematic_errors_would_take_back_is_not_named():
    """A bend of 1.1 cm in 29: a hinge at 2 % of errors, open at eight times as much."""
    rng = np.random.default_rng(4)
    q = np.linspace(0, 0.32, 60)
    p = 0.9 * np.column_stack([np.cos(q), np.sin(q), 0 * q]) + 0.004 * rng.normal(size=(60, 3))
    poses = PoseTrack(p)
    trusting = fit_poses(poses, config=FitConfig(doubt=1.0))
    assert trusting.kind == "revolute" and max(trusting.kind_probability.values()) < 0.9995
    doubting = fit_poses(poses, config=FitConfig(doubt=8.0))
    assert doubting.kind == "undecided"
    assert any("8 times as large" in text for text in doubting.fit.warnings)
    assert doubting.kind_probability == trusting.kind_probability


@pytest.mark.parametrize("seed", range(3))
def test_a_kind_that_is_sure_but_explains_the_path_badly_is_not_named(seed):
    """Nearly a full turn: nothing but a hinge goes so, and this one is five centimetres off."""
    rng = np.random.default_rng(seed)
    q = np.linspace(0, 5.5, 150)
    r = 0.5 + 0.05 * np.sin(5 * q + rng.uniform(0, 6))
    p = np.column_stack([r * np.cos(q), r * np.sin(q), 0 * q]) + 0.001 * rng.normal(size=(150, 3))
    posterior = fit_poses(PoseTrack(p))
    assert posterior.kind_probability["revolute"] > 0.95
    assert not posterior.fit.parametric
    assert posterior.kind == "undecided"


def test_orientations_without_noise_do_not_make_states_as_narrow_as_they_are_printed():
    """What is judged by 1.5 degrees may not cost a state as if it were known to a microradian."""
    poses, *_ = _handle(3, "revolute", 1.0, 30, noise_rad=0.0)
    with_them = fit_poses(poses).alternatives["revolute"].evidence.log_states
    without = fit_poses(PoseTrack(poses.p_world)).alternatives["revolute"].evidence.log_states
    assert with_them > without - 2.0 * 29
