"""A part of a model that exists on paper: a door or a drawer with a bar, exactly known or less."""

import gtsam
import numpy as np
import pytest

from akm_fg.model.records import Contact, ModelPart, Surface
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from factors.joint import Joint, JointKind

# The hand comes along +x to a bar at x = 0.5; the front is behind it, at x = 0.54.
GRASP = gtsam.Pose3(
    gtsam.Rot3(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])),
    np.array([0.5, 0.0, 0.4]),
)
HINGE = gtsam.Pose3(gtsam.Rot3(), np.array([0.54, 0.4, 0.4]))  # vertical, 0.4 m beside the bar
SLIDE = gtsam.Pose3(  # z of the joint is -x of the world: out of the front
    gtsam.Rot3(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])),
    np.array([0.54, 0.0, 0.4]),
)


def paper_joint(kind, axis_sd=0.0, pivot_sd=0.0):
    kind = JointKind(kind)
    T = HINGE if kind.turns else SLIDE
    sd = np.array([axis_sd, axis_sd, 0.0, pivot_sd, pivot_sd, 0.0])
    seen = np.zeros(6)
    seen[list(kind.observable)] = 1.0
    return JointPosterior(Joint(kind, T.matrix(), 0.0), np.diag((sd * seen) ** 2))


def paper_posterior(joint, last=0.3):
    states = StatePosterior(joint.kind.unit, np.array([0.0, last]), np.full(2, 1e-3))
    best = KindPosterior(joint, states, Evidence(0.0, 0.0, 0.0, 0.0))
    kind = str(joint.kind)
    report = FitReport(0.0, 1, 0, 0.0, 1.0, 1.0, 1.0, True)
    return ArticulationPosterior("x", kind, {kind: 1.0}, {kind: best}, report)


@pytest.fixture
def paper_part():
    def made(kind, axis_sd=0.0, pivot_sd=0.0, T_grasp=GRASP, correction=None):
        y, z = np.meshgrid(np.linspace(-0.3, 0.3, 31), np.linspace(0.2, 0.6, 21))
        front = np.stack([np.full(y.size, 0.54), y.ravel(), z.ravel()], axis=1)
        bar = np.stack([np.full(41, 0.495), np.zeros(41), np.linspace(0.3, 0.5, 41)], axis=1)
        p = np.concatenate([front, bar])
        surface = Surface(
            p, np.tile([-1.0, 0.0, 0.0], (len(p), 1)), np.zeros((len(p), 3), np.uint8)
        )
        joint = paper_joint(kind, axis_sd, pivot_sd)
        contact = Contact(T_grasp, 0.0, succeeded=1)
        return ModelPart(
            "part-0", paper_posterior(joint), surface, contacts=(contact,), correction=correction
        )

    return made
