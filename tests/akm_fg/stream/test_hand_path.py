from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.estimation.config import GraspConfig
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
HAND_AT = PLACE.transformFrom(np.array([0.35, 0.02, 0.05]))
HAND = GraspConfig(frames_as_one=1.0)


def seen(kind: JointKind, T: gtsam.Pose3, cov: np.ndarray, q: np.ndarray) -> ArticulationPosterior:
    joint = JointPosterior(Joint(kind, T.matrix(), 0.0), cov)
    sd = np.full(q.size, 1e-4)
    best = KindPosterior(joint, StatePosterior(kind.unit, q, sd), Evidence(0.0, 0.0, 0.0, 0.0))
    report = FitReport(0.0, 9, 0, 0.0, 1.0, 1.0, 1.0, True)
    return ArticulationPosterior("x", str(kind), {str(kind): 1.0}, {str(kind): best}, report)


def spread(kind: JointKind) -> np.ndarray:
    """What a camera leaves open: 0.1 deg of the axis, 2 cm of the pivot, most of it in depth."""
    cov = np.zeros((6, 6))
    for i in kind.observable:
        cov[i, i] = (2e-3 if i < 3 else 0.005) ** 2
    if kind.turns:
        v = np.array([0.0, 0.0, 0.0, 0.016, 0.012, 0.0])
        cov += np.outer(v, v)
    return cov


@pytest.mark.parametrize("kind", [JointKind.REVOLUTE, JointKind.PRISMATIC])
def test_the_hands_path_betters_the_joint_and_its_covariance_is_true(kind):
    rng, known = np.random.default_rng(4), list(kind.observable)
    q_true = np.linspace(0.0, 0.6 if kind.turns else 0.25, 25)
    truth = Joint(kind, PLACE.matrix(), 0.0)
    R, t = truth.motion(q_true)
    way = np.einsum("tij,j->ti", R, HAND_AT) + t
    cov, length_sd, nees, before = spread(kind), 0.01, [], []
    for _ in range(150):
        xi = rng.multivariate_normal(np.zeros(6), cov)
        T_seen = PLACE.compose(gtsam.Pose3.Expmap(xi).inverse())
        scale = 1.0 if kind.turns else 1.0 + length_sd * rng.standard_normal()
        posterior = seen(kind, T_seen, cov, q_true / scale)
        hands = dict(enumerate(way + HAND.sigma_trans_m * rng.standard_normal(way.shape)))
        told = with_hand_path(posterior, hands, length_sd, HAND)[0].best.joint
        off = gtsam.Pose3.Logmap(gtsam.Pose3(told.T_world_joint).between(PLACE))[known]
        nees.append(off @ np.linalg.solve(told.cov[np.ix_(known, known)], off))
        before.append(np.trace(told.cov) / np.trace(cov))
    d = len(known)
    assert abs(np.mean(nees) - d) < 3.5 * np.sqrt(2 * d / 150)
    assert np.mean(before) < (0.25 if kind.turns else 0.95)


def test_a_drawers_length_is_the_hands_where_the_camera_does_not_know_its_scale():
    kind = JointKind.PRISMATIC
    q = np.linspace(0.0, 0.3, 20)
    posterior = seen(kind, PLACE, spread(kind), q)
    best = posterior.best
    wide = replace(best, states=replace(best.states, sd=np.hypot(1e-4, 0.02 * q)))
    posterior = replace(posterior, alternatives={"prismatic": wide})
    axis = PLACE.rotation().matrix()[:, 2]
    hands = {k: HAND_AT + 1.03 * state * axis for k, state in enumerate(q)}
    told = with_hand_path(posterior, hands, 0.02, HAND)[0].best.states
    assert told.mean[-1] == pytest.approx(0.309, abs=2.5e-3)  # the camera still counts
    assert told.sd[-1] < 0.5 * wide.states.sd[-1]


def test_a_hand_that_slides_is_believed_no_more_than_it_slides():
    kind = JointKind.REVOLUTE
    q = np.linspace(0.0, 0.6, 25)
    posterior = seen(kind, PLACE, spread(kind), q)
    R, t = posterior.best.joint.joint.motion(q)
    way = np.einsum("tij,j->ti", R, HAND_AT) + t
    astray = {k: p + np.array([0.0, 0.0, 0.15 * (k % 5)]) for k, p in enumerate(way)}
    steady = with_hand_path(posterior, dict(enumerate(way)), 0.0, HAND)[0].best.joint
    told = with_hand_path(posterior, astray, 0.0, HAND)[0].best.joint
    assert told.pivot_sd_m > 0.9 * posterior.best.joint.pivot_sd_m
    assert steady.pivot_sd_m < 0.4 * posterior.best.joint.pivot_sd_m


def test_without_frames_that_hold_nothing_changes():
    posterior = seen(JointKind.REVOLUTE, PLACE, spread(JointKind.REVOLUTE), np.linspace(0, 0.6, 9))
    assert with_hand_path(posterior, {0: HAND_AT, 1: HAND_AT}, 0.0, HAND) == (posterior, None)
