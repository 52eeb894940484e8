"""What is known besides the tracks sharpens the posterior by what it is worth, and no more."""

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
from akm_fg.estimation.one_kind.kind_fit import _log_held, fit_rigid
from akm_fg.estimation.sources.gripper import GRIPPER, GripperPoses, GripperSource, Hold, holds_of
from akm_fg.estimation.sources.source import Contribution, NoiseLevel, Part
from akm_fg.estimation.sources.state_knowledge import StateKnowledge, StateLimits, state_priors
from akm_fg.estimation.sources.static_points import StaticPoints
from akm_fg.geometry.joint_guess import JointGuess, still
from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation
from akm_fg.perception.observe import ObservedMotion
from akm_fg.pipeline import knowledge_of
from akm_fg.records import PinholeCamera, PixelTracks, PointTracks, Recording, RgbdFrame
from factors.joint import Joint, JointKind
from factors.student_t import log_normaliser

FRAMES = 20
WHITE = GraspConfig(sigma_trans_m=0.002, sigma_rot_rad=0.02, frames_as_one=1.0)
SIGMA_M = 0.003  # of every coordinate in the openings


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


def _numbers(posterior):
    """All that a posterior says, as bytes and floats."""
    kinds = {
        name: (kind.evidence, None)
        if kind.joint is None
        else (
            kind.evidence,
            kind.joint.T_world_joint.tobytes(),
            kind.joint.cov.tobytes(),
            kind.states.mean.tobytes(),
            kind.states.sd.tobytes(),
        )
        for name, kind in posterior.alternatives.items()
    }
    return posterior.kind, posterior.kind_probability, posterior.fit, kinds


@pytest.mark.parametrize(
    "nothing",
    [
        [],
        [StateKnowledge()],
        [StateKnowledge(stamps_s=np.arange(20.0))],
        [StaticPoints(NoiseLevel(1.0, FitConfig().noise_prior_observations))],
    ],
    ids=["nothing", "no states", "stamps alone", "the level that is assumed"],
)
def test_knowing_nothing_more_changes_no_bit(kind, nothing, opening):
    tracks = opening(0, kind).tracks
    without, given = fit_tracks(tracks), fit_tracks(tracks, sources=nothing)
    if not any(isinstance(each, StaticPoints) for each in nothing):
        assert _numbers(given) == _numbers(without)
    else:  # it weighs the kinds, and leaves each of them where it was
        for name, alternative in without.alternatives.items():
            if alternative.joint is not None:
                joint = given.alternatives[name].joint
                assert_allclose(joint.T_world_joint, alternative.joint.T_world_joint, atol=0)
                assert_allclose(joint.cov, alternative.joint.cov, atol=0)


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
    assert _numbers(one) == _numbers(other)
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


def test_a_noisy_state_does_not_look_like_a_slip(opening):
    """The states' own noise is added to the grasps' when slips are looked for."""
    rng, q = np.random.default_rng(0), np.linspace(0.0, 0.5, 30)
    T_joint, poses, _ = _one_hold("prismatic", q)
    seen = q + 0.02 * np.repeat([0.0, 1.0], 15) + 0.001 * rng.normal(size=30)
    guess = JointGuess(Joint("prismatic", T_joint, 0.0), seen)
    gripper, frames = GripperPoses(poses, (0, 29), WHITE), np.arange(30)
    sure, unsure = (holds_of(gripper, frames, guess, np.full(30, sd), 1.0) for sd in (0.0005, 0.02))
    assert [len(grasp.holds) for grasp in (sure, unsure)] == [2, 1]


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


STAMPS_S = 0.1 * np.arange(FRAMES)


def test_state_priors_integrate_to_one():
    """Gaussian in every direction that the motion fixes, flat (density 1) in the others."""
    for states, open_directions in (
        (StateKnowledge(STAMPS_S, sigma_m_per_sqrt_s=0.1), 0),
        (StateKnowledge(STAMPS_S, sigma_m_per_s_three_halves=0.2), 1),
    ):
        priors = state_priors(states, JointKind.REVOLUTE, np.arange(0, FRAMES, 2), 0.5)
        q = np.concatenate([[0.0], np.full(9, 0.2)])
        H = priors.information(q)
        if open_directions:  # pinned at the last state, whose density is flat
            H = H[:-1, :-1]
        centre = np.zeros(10)  # the mode: at rest
        log_mass = priors.log_density(centre, 0.0) + 0.5 * (
            H.shape[0] * np.log(2 * np.pi) - np.linalg.slogdet(H)[1]
        )
        assert_allclose(log_mass, 0.0, atol=1e-9)


def test_states_that_depend_on_each_other_are_integrated_together():
    """Two states, seen with information h each, under a walk: the integral on a grid."""
    states = StateKnowledge(np.array([0.0, 0.1, 0.3]), sigma_m_per_sqrt_s=0.1)
    priors = state_priors(states, JointKind.PRISMATIC, np.arange(3), 1.0)
    seen, h = np.array([0.03, -0.02]), np.array([900.0, 400.0])
    H = np.diag(h) + priors.information(np.zeros(3))
    best = np.linalg.solve(H, h * seen)  # the walk's mode is zero
    q = np.concatenate([[0.0], best])
    none = np.zeros((2, 2))
    said = [
        Contribution(information=none, held=h),
        Contribution(information=none, held=np.zeros(2), tied=priors.information(q)),
    ]
    log_det = _log_held(said)
    assert_allclose(log_det, np.linalg.slogdet(H)[1])
    log_states = priors.log_density(q, 0.0) + np.log(2 * np.pi) - 0.5 * log_det
    axis = np.linspace(-0.5, 0.5, 401)
    likelihood = [np.exp(-0.5 * w * (axis - p) ** 2) for w, p in zip(h, seen, strict=True)]
    prior = np.array(
        [[np.exp(priors.log_density(np.array([0.0, a, b]), 0.0)) for b in axis] for a in axis]
    )
    integral = likelihood[0] @ prior @ likelihood[1] * (axis[1] - axis[0]) ** 2
    at_best = -0.5 * h @ (best - seen) ** 2
    assert_allclose(at_best + log_states, np.log(integral), atol=1e-6)


def test_the_random_walk_of_a_door_is_that_of_its_arc():
    """One metre a radian: the drawer's; half a metre: twice the angle. Evidence in metres alike."""
    states = StateKnowledge(STAMPS_S, sigma_m_per_sqrt_s=0.1)
    arc = np.linspace(0.0, 0.3, FRAMES)
    at = np.arange(FRAMES)
    drawer = state_priors(states, JointKind.PRISMATIC, at, 1.0).log_density(arc, 0.0)
    door = state_priors(states, JointKind.REVOLUTE, at, 0.5).log_density(arc / 0.5, np.log(0.5))
    assert_allclose(door, drawer)


@pytest.mark.parametrize("motion", ["sigma_m_per_sqrt_s", "sigma_m_per_s_three_halves"])
def test_smooth_motion_sharpens_the_states_and_leaves_the_kind(kind, motion, opening, score):
    """A steady opening seen by four noisy points: neighbours in time help."""
    truth = opening(0, kind, points=4, steady=True, noise_m=0.008, claimed_m=0.008)
    states = StateKnowledge(STAMPS_S, **{motion: 0.03})
    without = fit_tracks(truth.tracks)
    given = fit_tracks(truth.tracks, sources=[states])
    assert given.kind == kind
    before, after = (p.alternatives[kind].states.sd[1:] for p in (without, given))
    assert np.median(after / before) < 0.97
    error = score(given, truth).state_error[1:]
    assert np.abs(error / after).max() < 4.5


def test_limits_hold_states_that_noise_would_take_past_them(opening):
    truth = opening(0, "prismatic", points=4, noise_m=0.01, claimed_m=0.01)
    far = fit_tracks(truth.tracks).alternatives["prismatic"].states.mean.max()
    stop = StateLimits(0.0, far - 0.004, 1e-4)
    given = fit_tracks(truth.tracks, sources=[StateKnowledge(limits_m=stop)])
    assert given.alternatives["prismatic"].states.mean.max() < far - 0.0035
    assert given.fit.warnings == ()


def test_limits_that_all_states_keep_change_nothing(kind, opening):
    """Whichever way the axis pointed at the start: states are those that grow."""
    for seed in range(4):
        tracks = opening(seed, kind).tracks
        wide = StateKnowledge(
            limits_m=StateLimits(-0.05, 0.5, 0.01), limits_rad=StateLimits(-0.1, 1.6, 0.02)
        )
        without, given = fit_tracks(tracks), fit_tracks(tracks, sources=[wide])
        assert_allclose(
            [k.log_evidence for k in given.alternatives.values()],
            [k.log_evidence for k in without.alternatives.values()],
            atol=0.05,
        )
        one, other = (p.alternatives[kind].states for p in (without, given))
        assert_allclose(other.mean, one.mean, atol=0.1 * one.sd.max())


def test_limits_that_the_data_contradict_are_named(kind, opening):
    narrow = StateLimits(0.0, 0.05, 0.005)
    states = StateKnowledge(limits_m=narrow, limits_rad=narrow)
    given = fit_tracks(opening(0, kind).tracks, sources=[states])
    assert any("pass the given limits 0.0 to 0.05" in text for text in given.fit.warnings)


def test_a_joint_turned_about_its_x_moves_the_part_alike(kind):
    guess = JointGuess(
        Joint(kind, _one_hold(kind, np.zeros(2))[0], 0.0), np.array([0.0, 0.3, -0.2])
    )
    other = guess.turned()
    for one, two in zip(
        guess.motion(),
        other.motion(),
        strict=True,
    ):
        assert_allclose(one, two, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StateLimits(None, None, 0.1), "expected one or two numbers"),
        (lambda: StateLimits(0.0, np.nan, 0.1), "expected one or two numbers"),
        (lambda: StateLimits(0.3, 0.1, 0.1), "expected lower < upper"),
        (lambda: StateLimits(0.2, 0.4, 0.1), "state, zero, between them"),
        (lambda: StateLimits(0.0, 0.4, 0.0), "width is 0.0"),
        (lambda: StateKnowledge(STAMPS_S, 0.1, 0.1), "expected one motion prior"),
        (lambda: StateKnowledge(STAMPS_S, -0.1), "expected > 0"),
        (lambda: StateKnowledge(None, 0.1), "needs the stamps"),
        (lambda: StateKnowledge(np.zeros(5), 0.1), "grow strictly"),
        (lambda: GripperPoses(np.zeros((5, 3, 4)), (0, 4)), r"expected \(T, 4, 4\)"),
        (lambda: GripperPoses(np.zeros((5, 4, 4)), (0, 5)), r"outside 0\.\.4"),
    ],
)
def test_bad_knowledge_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("knowledge", "message"),
    [
        ([GripperPoses(np.tile(np.eye(4), (7, 1, 1)), (0, 6))], "7 gripper poses"),
        ([StateKnowledge(np.arange(7.0), 0.1)], r"stamps \(7,\)"),
    ],
)
def test_knowledge_of_other_frames_is_refused(knowledge, message, opening):
    with pytest.raises(ValueError, match=message):
        fit_tracks(opening(0, "prismatic").tracks, sources=knowledge)


def test_the_likelihood_of_a_grasp_is_normalised():
    """At its mode, six numbers a frame: the density of the multivariate Student-t."""
    _, _, grasp = _one_hold("prismatic", np.zeros(3))
    want = 3 * log_normaliser(WHITE.dof, 6)
    want -= 9 * np.log(WHITE.sigma_rot_rad) + 9 * np.log(WHITE.sigma_trans_m)
    assert_allclose(_rigid(grasp).log_likelihood, want)
