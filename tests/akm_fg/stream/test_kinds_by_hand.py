import math
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.estimation.config import FitConfig
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.stream.kinds_by_hand import evidence_by_hand, with_kinds_by_hand
from factors.joint import Joint, JointKind

CONFIG = FitConfig()
HINGE = gtsam.Pose3(gtsam.Rot3(), np.array([0.6, -0.2, 0.5]))
RADIUS_M = 0.4
START = HINGE.transformFrom(np.array([RADIUS_M, 0.0, 0.1]))
SLIDE = gtsam.Pose3(gtsam.Rot3.Rx(-math.pi / 2), START)  # its z is where the hinge's hand sets off
Q = np.linspace(0.0, 0.25, 20)


def kind_of(kind: JointKind, T: gtsam.Pose3, q: np.ndarray) -> KindPosterior:
    cov = np.zeros((6, 6))
    for i in kind.observable:
        cov[i, i] = (0.05 if i < 3 else 0.02) ** 2
    states = StatePosterior(kind.unit, q, np.full(q.size, 1e-3))
    joint = JointPosterior(Joint(kind, T.matrix(), 0.0), cov)
    return KindPosterior(joint, states, Evidence(0.0, 0.0, 0.0, 0.0))


def undecided(p_slide: float = 0.5) -> ArticulationPosterior:
    """A camera that has seen a front come out, and nothing else."""
    alternatives = {
        "rigid": KindPosterior(None, None, Evidence(0.0, 0.0, 0.0, 0.0)),
        "prismatic": kind_of(JointKind.PRISMATIC, SLIDE, RADIUS_M * Q),
        "revolute": kind_of(JointKind.REVOLUTE, HINGE, Q),
    }
    probability = {"rigid": 0.0, "prismatic": p_slide, "revolute": 1.0 - p_slide}
    report = FitReport(0.0, 9, 0, 0.0, 1.0, 1.0, 1.0, True)
    return ArticulationPosterior("x", "undecided", probability, alternatives, report)


def hand(kind: str) -> dict[int, gtsam.Pose3]:
    joint = undecided().alternatives[kind].joint
    assert joint is not None
    R, t = joint.joint.motion(Q if joint.turns else RADIUS_M * Q)
    rng = np.random.default_rng(3)
    places = R @ START + t + 1e-4 * rng.standard_normal((Q.size, 3))
    return {k: gtsam.Pose3(gtsam.Rot3(), p) for k, p in enumerate(places)}


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_line_is_a_slides_and_an_arc_a_hinges(kind):
    told = with_kinds_by_hand(undecided(), hand(kind), 0.0, CONFIG, True)
    assert told.kind == kind and told.best.joint.kind == kind
    other = {"prismatic": "revolute", "revolute": "prismatic"}[kind]
    said = evidence_by_hand(undecided().alternatives, hand(kind), 0.0, CONFIG.hand_path)
    assert said[kind] - said[other] > 10.0
    assert sum(told.kind_probability.values()) == pytest.approx(1.0)


def test_what_the_hand_says_is_bounded():
    sure = undecided(p_slide=1.0 - 1e-4)
    told = with_kinds_by_hand(sure, hand("revolute"), 0.0, CONFIG, True)
    assert told.kind == "prismatic"
    odds = told.kind_probability["revolute"] / told.kind_probability["prismatic"]
    assert odds == pytest.approx(1e-4 * math.exp(CONFIG.hand_path.kind_nats), rel=1e-3)


def test_a_doubt_or_a_path_of_no_joint_keeps_the_kind_undecided():
    assert with_kinds_by_hand(undecided(), hand("revolute"), 0.0, CONFIG, False).kind == "undecided"
    bent = undecided()
    bent = replace(bent, fit=replace(bent.fit, parametric=False))
    assert with_kinds_by_hand(bent, hand("revolute"), 0.0, CONFIG, True).kind == "undecided"


def test_a_kind_that_was_named_loses_its_name_to_an_arc_that_speaks_against_it():
    named = replace(undecided(p_slide=0.96), kind="prismatic")
    told = with_kinds_by_hand(named, hand("revolute"), 0.0, CONFIG, True)
    assert told.kind == "undecided" and told.best.joint.turns


def test_few_frames_say_nothing():
    few = {k: T for k, T in hand("revolute").items() if k < 5}
    before = undecided()
    assert with_kinds_by_hand(before, few, 0.0, CONFIG, True) is before
