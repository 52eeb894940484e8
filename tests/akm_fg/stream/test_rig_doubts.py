"""Answers that rest on too little."""

from dataclasses import replace

import pytest

from akm_fg.estimation.fit import fit_tracks
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.posterior import doubted
from akm_fg.stream.rig_doubts import RigDoubts
from experiments.trials.openings import make_opening

CONFIG = PerceptionConfig()


def _doubts(patches):
    """About a hinge that two points and so many patches tell of."""
    posterior = fit_tracks(make_opening(1, "revolute").tracks)
    fit = replace(posterior.fit, tracks_used=2, patches_used=patches)
    posterior = replace(posterior, fit=fit)
    return posterior, RigDoubts(CONFIG)._of_depth_alone(posterior, DepthNoiseModel())


def test_a_joint_by_two_points_and_a_hundred_patches_is_not_named():
    posterior, doubts = _doubts(100)
    assert doubted(posterior, doubts).kind == "undecided"
    assert "2 points could be followed and 100 patches" in doubts[0].text


@pytest.mark.parametrize("patches", [CONFIG.rig.least_patches, 3000])
def test_a_joint_by_a_whole_front_is_named(patches):
    posterior, doubts = _doubts(patches)
    assert doubts == []
    assert doubted(posterior, doubts).kind == "revolute"
