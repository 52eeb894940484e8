import math
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.estimation.config import HandPathConfig
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.stream.hand_path import with_hand_path
from factors.joint import Joint, JointKind

PLACE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.2, -0.3, 0.4), np.array([0.6, -0.2, 0.5]))
HAND_AT = gtsam.Pose3(
    gtsam.Rot3.RzRyRx(0.3, 0.1, -1.0), PLACE.transformFrom(np.array([0.35, 0.02, 0.05]))
)
HAND = HandPathConfig()
BOTH = pytest.mark.parametrize("kind", [JointKind.REVOLUTE, JointKind.PRISMATIC])


def seen(kind: JointKind, T: gtsam.Pose3, cov: np.ndarray, q: np.ndarray) -> ArticulationPosterior:
    joint = JointPosterior(Joint(kind, T.matrix(), 0.0), cov)
    sd = np.full(q.size, 1e-4)
    best = KindPosterior(joint, StatePosterior(kind.unit, q, sd), Evidence(0.0, 0.0, 0.0, 0.0))
    report = FitReport(0.0, 9, 0, 0.0, 1.0, 1.0, 1.0, True)
    return ArticulationPosterior("x", str(kind), {str(kind): 1.0}, {str(kind): best}, report)


def spread(kind: JointKind) -> np.ndarray:
    """What a camera leaves open: 1 deg of the axis, 2 cm of the pivot, most of it in depth."""
    cov = np.zeros((6, 6))
    for i in kind.observable:
        cov[i, i] = (0.02 if i < 3 else 0.005) ** 2
    if kind.turns:
        v = np.array([0.0, 0.0, 0.0, 0.016, 0.012, 0.0])
        cov += np.outer(v, v)
    return cov


def states(kind: JointKind) -> np.ndarray:
    return np.linspace(0.0, 0.6 if kind.turns else 0.25, 25)


def held(
    kind: JointKind,
    q: np.ndarray,
    lever: np.ndarray | None = None,
    turned: np.ndarray | None = None,
    slipped: np.ndarray | None = None,
) -> dict[int, gtsam.Pose3]:
    """The hand of a part at states (T,).

    It turns by (T, 3) in its grasp about a point (3,) of its own that slips by (T, 3) in the part.
    """
    lever = np.zeros(3) if lever is None else lever
    turned = np.zeros((q.size, 3)) if turned is None else turned
    slipped = np.zeros((q.size, 3)) if slipped is None else slipped
    R, t = Joint(kind, PLACE.matrix(), 0.0).motion(q)
    hands = {}
    for k in range(q.size):
        rotation = gtsam.Rot3(R[k] @ HAND_AT.rotation().matrix()) * gtsam.Rot3.Expmap(turned[k])
        point = R[k] @ (HAND_AT.transformFrom(lever) + slipped[k]) + t[k]
        hands[k] = gtsam.Pose3(rotation, point - rotation.matrix() @ lever)
    return hands


def told(posterior: ArticulationPosterior, hands, length_sd=0.0, config=HAND):
    before = posterior.best.joint
    return with_hand_path(posterior, before, hands, length_sd, config)


def hidden(posterior: ArticulationPosterior, frames: slice) -> ArticulationPosterior:
    mean, sd = (x.copy() for x in (posterior.best.states.mean, posterior.best.states.sd))
    mean[frames], sd[frames] = np.nan, np.nan
    return posterior.with_states(mean, sd)


def off_truth(joint: JointPosterior) -> np.ndarray:
    xi = gtsam.Pose3.Logmap(gtsam.Pose3(joint.T_world_joint).between(PLACE))
    return xi[list(joint.kind.observable)]


def astray(kind: JointKind, xi: np.ndarray) -> gtsam.Pose3:
    return PLACE.compose(gtsam.Pose3.Expmap(xi).inverse())


@BOTH
def test_the_hands_path_betters_the_joint_and_its_covariance_is_true(kind):
    rng, known = np.random.default_rng(4), list(kind.observable)
    q = states(kind)
    cov, length_sd, nees, shrunk = spread(kind), 0.01, [], []
    for _ in range(150):
        xi = rng.multivariate_normal(np.zeros(6), cov)
        scale = 1.0 if kind.turns else 1.0 + length_sd * rng.standard_normal()
        posterior = seen(kind, astray(kind, xi), cov, q / scale)
        # Grips settle at first, by millimetres, and hold then.
        steps = np.zeros((q.size, 3))
        steps[1:6] = 1e-3 * rng.standard_normal((5, 3))
        turned = np.linspace(0, 1, q.size)[:, None] * 0.4 * rng.standard_normal(3)
        lever = HAND.lever_m * rng.standard_normal(3)
        hands = held(kind, q, lever, turned, np.cumsum(steps, axis=0))
        by_arm = gtsam.Rot3.Expmap(HAND.turn_rad * rng.standard_normal(3))
        start = hands[0].translation()
        hands = {
            k: gtsam.Pose3(
                T.rotation(),
                start
                + by_arm.rotate(T.translation() - start)
                + HAND.jitter_m * rng.standard_normal(3),
            )
            for k, T in hands.items()
        }
        joint = told(posterior, hands, length_sd).posterior.best.joint
        off = off_truth(joint)
        nees.append(off @ np.linalg.solve(joint.cov[np.ix_(known, known)], off))
        shrunk.append(joint.axis_sd_rad / posterior.best.joint.axis_sd_rad)
    assert 0.6 * len(known) < np.mean(nees) < 1.2 * len(known)
    assert np.median(shrunk) < 0.75


def test_a_drawers_length_is_the_hands_where_the_camera_does_not_know_its_scale():
    kind = JointKind.PRISMATIC
    q = np.linspace(0.0, 0.3, 20)
    posterior = seen(kind, PLACE, spread(kind), q)
    best = posterior.best
    wide = replace(best, states=replace(best.states, sd=np.hypot(1e-4, 0.02 * q)))
    posterior = replace(posterior, alternatives={"prismatic": wide})
    there = told(posterior, held(kind, 1.03 * q), 0.02).posterior.best.states
    assert there.mean[-1] == pytest.approx(0.309, abs=1e-3)
    assert there.sd[-1] < 0.3 * wide.states.sd[-1]


@BOTH
def test_a_grip_that_settles_is_believed_once_it_holds(kind):
    q = states(kind)
    settled = np.minimum(np.arange(q.size) / 5.0, 1.0)[:, None] * np.array([3e-3, -4e-3, 4e-3])
    xi = np.array([0.03, -0.02, 0, 0, 0, 0])
    posterior = seen(kind, astray(kind, xi), spread(kind), q)
    joint = told(posterior, held(kind, q, slipped=settled)).posterior.best.joint
    assert np.abs(off_truth(joint)[:2]).max() < math.radians(0.5)
    assert np.abs(xi[:2]).max() > math.radians(1.0)


def test_a_hand_that_turns_in_its_grasp_does_not_move_the_hinge():
    kind = JointKind.REVOLUTE
    q = states(kind)
    axis_in_hand = HAND_AT.rotation().unrotate(PLACE.rotation().matrix()[:, 2])
    lag = -q[:, None] * axis_in_hand
    hands = held(kind, q, np.array([0.01, 0.004, 0.012]), 0.8 * lag)
    posterior = seen(kind, PLACE, spread(kind), q)
    joint = told(posterior, hands).posterior.best.joint
    assert np.abs(off_truth(joint)[2:]).max() < 1.5e-3
    rigid = told(posterior, hands, config=replace(HAND, lever_m=1e-6)).posterior.best.joint
    assert np.abs(off_truth(rigid)[2:]).max() > 4e-3


@BOTH
def test_a_camera_that_claims_too_much_is_overruled_and_both_are_widened(kind):
    q = states(kind)
    xi = np.array([0.04, -0.03, 0, 0, 0, 0])
    cov = spread(kind) / 25.0  # 0.2 deg: it is ten deviations off
    posterior = seen(kind, astray(kind, xi), cov, q)
    joint = told(posterior, held(kind, q)).posterior.best.joint
    off = off_truth(joint)[:2]
    assert np.abs(off).max() < 0.65 * np.abs(xi).max()
    assert (np.abs(off) / np.sqrt(np.diag(joint.cov)[:2])).max() < 3.0


def test_a_hand_that_slides_is_believed_no_more_than_it_slides():
    kind = JointKind.REVOLUTE
    q = states(kind)
    posterior = seen(kind, PLACE, spread(kind), q)
    to_and_fro = np.array([[0.0, 0.0, 0.15 * (k % 5)] for k in range(q.size)])
    before = posterior.best.joint
    steady = told(posterior, held(kind, q)).posterior.best.joint
    sliding = told(posterior, held(kind, q, slipped=to_and_fro)).posterior.best.joint
    assert sliding.pivot_sd_m > 0.9 * before.pivot_sd_m
    assert steady.pivot_sd_m < 0.4 * before.pivot_sd_m


@BOTH
def test_a_correction_is_the_calibrations_or_the_fits_as_they_are_known(kind):
    q, known = states(kind), list(kind.observable)
    xi = np.array([0.02, -0.01, 0, 0, 0, 0])
    cov = spread(kind)
    posterior = seen(kind, astray(kind, xi), cov, q)
    sure = replace(posterior.best.joint, cov=1e-4 * cov)
    for of_fit, turned in ((sure, 0.02), (posterior.best.joint, 0.0)):
        correction = with_hand_path(posterior, of_fit, held(kind, q), 0.0, HAND).correction
        way = gtsam.Rot3.Logmap(correction.T_world_seen.rotation())
        assert np.linalg.norm(way) == pytest.approx(turned * math.sqrt(1.25), abs=4e-3)
        own = correction.cov_seen_joint[np.ix_(known, known)]
        assert np.trace(own) <= np.trace(of_fit.cov[np.ix_(known, known)]) * (1 + 1e-9)
        assert np.linalg.eigvalsh(own).min() > 0


def test_without_frames_that_hold_nothing_changes():
    posterior = seen(JointKind.REVOLUTE, PLACE, spread(JointKind.REVOLUTE), np.linspace(0, 0.6, 9))
    assert told(posterior, {0: HAND_AT, 1: HAND_AT}) is None


def test_a_door_that_is_hidden_later_is_known_by_the_hand_that_goes_on_with_it():
    kind = JointKind.REVOLUTE
    q = np.linspace(0.0, 1.2, 40)
    posterior = seen(kind, astray(kind, np.array([0.02, 0.01, 0, 0, 0, 0])), spread(kind), q)
    half = hidden(posterior, slice(16, None))
    hands = held(kind, q)
    short = told(half, {k: hands[k] for k in range(16)})
    whole = told(half, hands)
    assert whole.posterior.best.joint.axis_sd_rad < 0.75 * short.posterior.best.joint.axis_sd_rad
    assert np.abs(off_truth(whole.posterior.best.joint)[:2]).max() < math.radians(0.4)
    assert np.isnan(whole.posterior.best.states.mean[16:]).all()  # nobody saw them
    assert whole.carried.mean == pytest.approx(q, abs=0.02)
    assert (np.abs(whole.carried.mean - q) < 3 * whole.carried.sd)[16:].all()


def test_states_that_are_nowhere_near_the_hand_are_left_out():
    kind = JointKind.REVOLUTE
    q = np.linspace(0.0, 1.2, 40)
    wrong = q.copy()
    wrong[30:] = -1.5
    posterior = seen(kind, PLACE, spread(kind), wrong)
    found = told(posterior, held(kind, q))
    assert np.isnan(found.posterior.best.states.mean[30:]).all()
    assert found.posterior.best.states.mean[:30] == pytest.approx(q[:30])
    assert found.carried.mean[30:] == pytest.approx(q[30:], abs=0.02)
    assert np.abs(off_truth(found.posterior.best.joint)[:2]).max() < math.radians(0.3)
