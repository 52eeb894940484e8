"""Sources that say nothing change nothing; those that are not over the input are refused."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.sources.gripper import GripperPoses
from akm_fg.estimation.sources.source import NoiseLevel
from akm_fg.estimation.sources.state_knowledge import StateKnowledge, StateLimits
from akm_fg.estimation.sources.static_points import StaticPoints

FRAMES = 20
STAMPS_S = 0.1 * np.arange(FRAMES)


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
