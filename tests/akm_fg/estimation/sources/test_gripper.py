"""The gripper's poses sharpen the posterior by what they are worth, and no more."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.config import FitConfig, GraspConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_surface
from akm_fg.estimation.one_kind.joint_graph import initial_values, read, variables_of
from akm_fg.estimation.one_kind.kind_fit import fit_rigid
from akm_fg.estimation.sources.gripper import GRIPPER, GripperPoses, GripperSource, Hold, holds_of
from akm_fg.estimation.sources.source import Part
from akm_fg.geometry.joint_guess import JointGuess, still
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.records import PointTracks
from factors.joint import Joint
from factors.student_t import log_normaliser

FRAMES = 20
WHITE = GraspConfig(sigma_trans_m=0.002, sigma_rot_rad=0.02, frames_as_one=1.0)


def _gripper(truth, seed, noise=WHITE, slip_at=None, correlation=0.0):
    """Poses (T, 4, 4) of a gripper on the panel's far edge, by GTSAM's own group operations.

    From frame `slip_at` on the hand holds 4 cm away; noise is correlated from frame to frame.
    """
    rng = np.random.default_rng([seed, 77])
    S = np.array([0, 0, 1, 0, 0, 0] if truth.kind == "revolute" else [0, 0, 0, 0, 0, 1.0])
    joint = gtsam.Pose3(truth.T_world_joint)
    grasp = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), np.array([0.35, 0.0, 0.1]))
    slipped = grasp * gtsam.Pose3(gtsam.Rot3.Rx(0.1), np.array([0.02, 0.03, 0.02]))
    sigmas, off = np.repeat([noise.sigma_rot_rad, noise.sigma_trans_m], 3), rng.normal(size=6)
    poses = []
    for t, q in enumerate(truth.q):
        new = np.sqrt(1 - correlation**2) * rng.normal(size=6)
        off = correlation * off + new if t else off
        e = sigmas * off
        held = grasp if slip_at is None or t < slip_at else slipped
        error = gtsam.Pose3(gtsam.Rot3.Expmap(e[:3]), e[3:])
        poses.append((joint * gtsam.Pose3.Expmap(q * S) * held * error).matrix())
    return np.array(poses)


def _holding(truth, seed, noise=WHITE, last=FRAMES - 1, **settings):
    poses = _gripper(truth, seed, noise, **settings)
    return [GripperPoses(poses, (0, last), noise)]


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_a_grasp_shrinks_the_covariance_and_does_not_flip_the_kind(kind, share, opening):
    travel = share * {"revolute": 0.5, "prismatic": 0.15}[kind]
    for seed in range(3):
        truth = opening(seed, kind, travel=travel, points=8)
        without = fit_tracks(truth.tracks)
        given = fit_tracks(truth.tracks, sources=_holding(truth, seed))
        before, after = without.alternatives[kind].joint, given.alternatives[kind].joint
        assert after.axis_sd_rad < 0.97 * before.axis_sd_rad
        assert given.fit.holds == ((0, FRAMES - 1),)
        assert given.kind_probability[kind] > without.kind_probability[kind] - 0.01


def _runs_with_grasps(runs, kind, opening, score, steady=False, **settings):
    posteriors, scores = [], []
    for seed in range(runs):
        truth = opening(seed, kind, points=6, steady=steady)
        posteriors.append(fit_tracks(truth.tracks, sources=_holding(truth, seed, **settings)))
        scores.append(score(posteriors[-1], truth))
    return posteriors, scores


def _assert_nees(scores, level):
    dof = sum(s.dimensions for s in scores)
    low, high = stats.chi2.interval(level, dof)
    assert low / dof <= sum(s.nees for s in scores) / dof <= high / dof


def test_joint_nees_with_grasps_is_inside_its_band(kind, opening, score):
    """Few tracks, so that the grasps say half of it."""
    _, scores = _runs_with_grasps(8, kind, opening, score)
    _assert_nees(scores, 0.998)


@pytest.mark.slow
@pytest.mark.parametrize("slip_at", [None, 10])
def test_joint_nees_of_many_openings_with_grasps_is_inside_its_band(kind, slip_at, opening, score):
    posteriors, scores = _runs_with_grasps(60, kind, opening, score, slip_at=slip_at)
    _assert_nees(scores, 0.99)
    assert sum(p.kind == kind for p in posteriors) >= 58


@pytest.mark.slow
def test_errors_of_the_grasp_that_last_are_covered_by_the_frames_that_count_as_one(
    kind, opening, score
):
    """AR(1) with 0.67: five frames count as one. Counted singly, NEES of doors is 1.33 a number."""
    lasting = replace(WHITE, sigma_trans_m=0.004, frames_as_one=5.0)
    _, scores = _runs_with_grasps(
        60, kind, opening, score, steady=True, noise=lasting, correlation=0.67
    )
    dof = sum(s.dimensions for s in scores)
    assert sum(s.nees for s in scores) / dof <= stats.chi2.ppf(0.995, dof) / dof


def test_a_slip_in_mid_hold_starts_a_new_hold_and_leaves_the_joint(kind, opening, score):
    for seed in range(3):
        truth = opening(seed, kind, points=8)
        given = fit_tracks(truth.tracks, sources=_holding(truth, seed, slip_at=12))
        assert given.fit.holds == ((0, 11), (12, 19))
        assert given.kind == kind
        error = score(given, truth)
        assert error.nees < stats.chi2.ppf(0.9999, error.dimensions)


def test_frames_outside_the_hold_are_not_looked_at(kind, opening):
    truth = opening(0, kind)
    poses = _gripper(truth, 0)
    wild = poses.copy()
    wild[12:] = np.nan
    knowledge = [[GripperPoses(p, (0, 11), WHITE)] for p in (poses, wild)]
    one, other = (fit_tracks(truth.tracks, sources=k) for k in knowledge)
    said = [posterior_as_dict(p) | {"time_s": None} for p in (one, other)]
    assert said[0] == said[1]
    assert one.fit.holds == ((0, 11),)


def test_a_gripper_that_stays_with_a_part_that_stays_is_rigid(opening):
    for seed in range(3):
        still = opening(seed, "prismatic", travel=0.0, points=8)
        posterior = fit_tracks(still.tracks, sources=_holding(still, seed))
        assert posterior.kind == "rigid"


def _one_hold(kind, q, noise=WHITE, count=1.0):
    """A hold without error, and the values of its joint."""
    T_joint = gtsam.Pose3(gtsam.Rot3.Expmap([0.3, -0.2, 0.9]), np.array([0.4, 0.1, 0.2])).matrix()
    R, t = Joint(kind, T_joint, 0.0).motion(q)
    poses = np.tile(np.eye(4), (q.size, 1, 1))
    start = gtsam.Pose3(gtsam.Rot3.Expmap([1.0, 0.5, 0.0]), np.array([0.2, 0.6, 0.3])).matrix()
    poses[:, :3, :3], poses[:, :3, 3] = R @ start[:3, :3], R @ start[:3, 3] + t
    grasp = GripperSource((Hold(np.arange(q.size), poses),), noise, count)
    return T_joint, poses, grasp


def _rigid(grasp):
    """What a gripper says if nothing moved."""
    frames = 1 + max(int(hold.frames.max()) for hold in grasp.holds)
    none = PointTracks(np.zeros((frames, 0, 3)), np.zeros((frames, 0, 3, 3)))
    problem = problem_of_surface("x", none, still(frames), np.zeros(3), FitConfig())
    return fit_rigid(problem.with_source(grasp)).said[GRIPPER]


def test_evidence_of_a_still_grasp_is_the_one_worked_on_paper():
    """F frames, Gaussian: likelihood at its mode; information F / sigma^2 on each number."""
    F, noise = 7, replace(WHITE, dof=1e9)
    _, _, grasp = _one_hold("prismatic", np.zeros(F), noise)
    fit = _rigid(grasp)
    sigmas = np.repeat([noise.sigma_rot_rad, noise.sigma_trans_m], 3)
    assert_allclose(fit.log_likelihood, -F * np.log(np.sqrt(2 * np.pi) * sigmas).sum(), rtol=1e-6)
    assert_allclose(fit.own_log_det, np.log(F / sigmas**2).sum(), rtol=1e-6)
    assert fit.own_variables == 6


def test_grasps_enter_likelihood_and_volume_of_the_evidence(opening):
    """Of a part at rest, tracks and grasps share nothing: their evidence adds up."""
    still = opening(0, "prismatic", travel=0.0, points=7, frames=6)
    poses = _gripper(still, 0)
    knowledge = [GripperPoses(poses, (0, 5), WHITE)]
    without, given = fit_tracks(still.tracks), fit_tracks(still.tracks, sources=knowledge)
    assert given.fit.holds == ((0, 5),)
    alone = _rigid(GripperSource((Hold(np.arange(6), poses),), WHITE, 1.0))
    want = alone.log_likelihood + 3 * np.log(2 * np.pi) - 0.5 * alone.own_log_det
    gained = given.alternatives["rigid"].log_evidence - without.alternatives["rigid"].log_evidence
    assert_allclose(gained, want, atol=1e-3)


@pytest.mark.parametrize("frames_as_one", [1.0, 4.0])
def test_covariance_by_grasps_alone_is_the_one_worked_on_paper(frames_as_one, opening):
    """Drawer, tracks next to mute: var w = sigma^2 frames_as_one / sum (q - mean q)^2."""
    truth = opening(0, "prismatic", points=6, noise_m=0.05, claimed_m=0.05)
    noise = replace(WHITE, sigma_trans_m=0.001, dof=100.0, frames_as_one=frames_as_one)
    posterior = fit_tracks(truth.tracks, sources=_holding(truth, 0, noise))
    spread = np.sqrt(((truth.q - truth.q.mean()) ** 2).sum())
    sd = posterior.alternatives["prismatic"].joint.axis_sd_rad
    assert_allclose(sd, 0.001 * np.sqrt(frames_as_one) / spread, rtol=0.1)


def test_rigid_and_a_joint_at_rest_say_the_same_of_a_still_grasp():
    q = np.zeros(6)
    T_joint, _, grasp = _one_hold("revolute", q)
    guess = JointGuess(Joint("revolute", T_joint, 0.0), q)
    term = grasp.term(guess, Part(FitConfig(), np.zeros(3), 0.0, np.arange(6)), None)
    variables = variables_of(guess.kind, 6)
    at = read(initial_values(guess, variables, [term]), variables, {GRIPPER: 1.0})
    fit, resting = term.contribution(at, 1.0), _rigid(grasp)
    assert_allclose(fit.log_likelihood, resting.log_likelihood)
    assert_allclose(fit.own_log_det, resting.own_log_det)
    assert fit.information.shape == (9, 9)


def test_frames_that_count_as_one_divide_likelihood_and_information():
    q = np.linspace(0.0, 0.5, 6)
    (_, _, one), (_, _, few) = (_one_hold("prismatic", q, count=c) for c in (1.0, 3.0))
    single, counted = (_rigid(grasp) for grasp in (one, few))
    assert_allclose(counted.log_likelihood, single.log_likelihood / 3, rtol=1e-3)
    assert_allclose(counted.own_log_det, single.own_log_det - 6 * np.log(3), rtol=1e-3)
    assert_allclose(single.variance_fixed, (WHITE.dof + 8) / (WHITE.dof + 6))
    assert_allclose(counted.variance_fixed, single.variance_fixed / 3)


def test_a_hold_needs_two_frames_of_the_graph():
    q = np.linspace(0.0, 0.5, 6)
    T_joint, poses, _ = _one_hold("revolute", q)
    guess, sd = JointGuess(Joint("revolute", T_joint, 0.0), q), np.zeros(6)
    keyframes = np.array([0, 3, 6, 9, 12, 15])
    many = np.repeat(poses, 3, axis=0)
    assert holds_of(GripperPoses(many, (1, 4)), keyframes, guess, sd, 1.0) is None
    held = holds_of(GripperPoses(many, (1, 10)), keyframes, guess, sd, 2.0)
    assert [hold.frames.tolist() for hold in held.holds] == [[1, 2, 3]]
    assert held.count_as_one == GraspConfig().frames_as_one / 2


def test_in_another_graph_the_holds_keep_their_frames():
    poses = np.tile(np.eye(4), (3, 1, 1))
    holds = Hold(np.array([1, 2]), poses[:2]), Hold(np.array([4, 5]), poses[1:])
    source = GripperSource(holds, GraspConfig(), 1.0)
    np.testing.assert_array_equal(source.own_frames, [1, 2, 4, 5])
    there = source.moved(np.array([0, 2, 3, -1, 7, 8]))  # others came in; frame 3 is gone
    np.testing.assert_array_equal(there.own_frames, [2, 3, 7, 8])
    assert there.holds[1].T_world_gripper is holds[1].T_world_gripper


def test_a_noisy_state_does_not_look_like_a_slip(opening):
    """The states' own noise is added to the grasps' when slips are looked for."""
    rng, q = np.random.default_rng(0), np.linspace(0.0, 0.5, 30)
    T_joint, poses, _ = _one_hold("prismatic", q)
    seen = q + 0.02 * np.repeat([0.0, 1.0], 15) + 0.001 * rng.normal(size=30)
    guess = JointGuess(Joint("prismatic", T_joint, 0.0), seen)
    gripper, frames = GripperPoses(poses, (0, 29), WHITE), np.arange(30)
    sure, unsure = (holds_of(gripper, frames, guess, np.full(30, sd), 1.0) for sd in (0.0005, 0.02))
    assert [len(grasp.holds) for grasp in (sure, unsure)] == [2, 1]


def test_the_likelihood_of_a_grasp_is_normalised():
    """At its mode, six numbers a frame: the density of the multivariate Student-t."""
    _, _, grasp = _one_hold("prismatic", np.zeros(3))
    want = 3 * log_normaliser(WHITE.dof, 6)
    want -= 9 * np.log(WHITE.sigma_rot_rad) + 9 * np.log(WHITE.sigma_trans_m)
    assert_allclose(_rigid(grasp).log_likelihood, want)


def test_a_noisy_angle_hides_slips_near_the_hinge_less_than_far_from_it():
    """0.02 rad are 2 mm at 0.1 m and 16 mm at 0.8 m: a slip of 12 mm is six of the one."""
    for lever_m, holds in ((0.1, 2), (0.8, 1)):
        poses = np.tile(np.eye(4), (30, 1, 1))
        poses[:, 0, 3] = lever_m
        poses[15:, 2, 3] = 0.012
        guess = JointGuess(Joint("revolute", np.eye(4), 0.0), np.zeros(30))
        found = holds_of(
            GripperPoses(poses, (0, 29), WHITE), np.arange(30), guess, np.full(30, 0.02), 1.0
        )
        assert len(found.holds) == holds


def test_frames_as_one_stay_those_of_the_gripper_whatever_the_tracks_count_by():
    """`count_as_one` is relative to the tracks': tempered with them it is the gripper's own."""
    poses = np.tile(np.eye(4), (6, 1, 1))
    gripper, frames, sd = GripperPoses(poses, (0, 5)), np.arange(6), np.zeros(6)
    for as_one in (1.0, 2.0, 5.0):
        first = holds_of(gripper, frames, still(6), sd, 1.0)
        counted = first.recounted(as_one)
        assert_allclose(counted.count_as_one * as_one, GraspConfig().frames_as_one)
        assert_allclose(
            holds_of(gripper, frames, still(6), sd, as_one).count_as_one, counted.count_as_one
        )
