"""How states move and where they stop: densities, and what they sharpen."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.one_kind.kind_fit import _log_held
from akm_fg.estimation.sources.source import Contribution
from akm_fg.estimation.sources.state_knowledge import StateKnowledge, StateLimits, state_priors
from akm_fg.geometry.joint_guess import JointGuess
from factors.joint import Joint, JointKind

FRAMES = 20
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
    T_world_joint = gtsam.Pose3.Expmap(np.array([0.3, -0.2, 0.9, 0.4, 0.1, 0.2])).matrix()
    guess = JointGuess(Joint(kind, T_world_joint, 0.0), np.array([0.0, 0.3, -0.2]))
    other = guess.turned()
    for one, two in zip(
        guess.motion(),
        other.motion(),
        strict=True,
    ):
        assert_allclose(one, two, atol=1e-12)
