"""Sources that contradict each other."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.between_kinds.agreement import (
    disagreement_warnings,
    line_apart,
    with_disagreement,
)
from akm_fg.estimation.between_kinds.all_kinds import fit_kinds
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.given.surface_registration import SurfaceToRegister
from akm_fg.records import PointTracks
from akm_fg.steps import to_end
from factors.joint import Joint, JointKind


def test_a_line_tilted_and_shifted_by_hand():
    here = Joint(JointKind.REVOLUTE, gtsam.Pose3.Expmap(np.full(6, 0.3)).matrix(), 0.0)
    xi = np.array([0.01, -0.02, 0.0, 0.003, 0.004, 0.5])  # 0.5 along the axis does not count
    there = Joint(
        JointKind.REVOLUTE,
        here.T_world_joint @ gtsam.Pose3.Expmap(xi).matrix(),
        0.0,
    )
    flat = replace(there, T_world_joint=here.T_world_joint @ _shifted([0.003, 0.004, 0.5]))
    assert_allclose(line_apart(here, flat), [0, 0, 0.003, 0.004], atol=1e-12)
    assert_allclose(line_apart(here, there)[:2], [0.01, -0.02], atol=1e-4)
    turned = replace(there, T_world_joint=there.T_world_joint @ np.diag([1.0, -1, -1, 1]))
    assert_allclose(line_apart(here, turned), line_apart(here, there), atol=1e-12)


def _shifted(t):
    T = np.eye(4)
    T[:3, 3] = t
    return T


class _Broken:
    """A fit with another covariance, whatever it counts as one."""

    def __init__(self, fit, cov):
        self.kind, self.joint, self.moving, self.cov = fit.kind, fit.joint, fit.moving, cov

    def tempered(self, as_one):
        del as_one
        return self


@pytest.fixture
def hinge(opening):
    problem = problem_of_tracks("x", opening(1, "revolute").tracks, True, 0, FitConfig())
    fits, _ = to_end(fit_kinds(problem))
    fit = next(fit for fit in fits if fit.kind == "revolute").tempered(1.0)
    return fit, problem.centroid_world


@pytest.mark.parametrize("sigmas", [1.0, 12.0])
def test_variances_grow_by_the_squared_difference_over_its_expectation(hinge, sigmas):
    """The others leave a quarter of the variance: the difference should have three quarters."""
    alone, centroid = hinge
    off = sigmas * np.sqrt(alone.cov[0, 0])
    T = alone.moving.T_world_joint @ gtsam.Pose3(gtsam.Rot3.Rx(off), np.zeros(3)).matrix()
    there = replace(
        alone, joint=replace(alone.moving, T_world_joint=T), information=2 * alone.information
    )
    left = there.tempered(1.0).cov[:4, :4]
    assert_allclose(left, alone.cov[:4, :4] / 4, rtol=0.1)
    (fit,) = with_disagreement([there], [alone], 1.0, centroid)
    if sigmas == 1.0:
        assert fit.disagreement == 1.0
        assert disagreement_warnings(fit) == []
        return
    delta = np.array([off, 0, 0, 0])
    want = delta @ np.linalg.solve(0.75 * alone.cov[:4, :4], delta) / 4
    assert fit.disagreement == pytest.approx(want, rel=0.1)
    assert_allclose(
        fit.tempered(1.0).cov, fit.disagreement * there.tempered(1.0).cov, rtol=1e-9, atol=1e-15
    )
    assert "disagree" in disagreement_warnings(fit)[0]


@pytest.mark.parametrize("variances", [np.r_[-1e3, 1.0], np.r_[1e3, 1e-30]])
def test_a_line_that_tracks_leave_open_beyond_numbers_contradicts_nothing(hinge, variances):
    """A hinge hundreds of metres away, out of the race: its covariance is none any more."""
    fit, centroid = hinge
    cov = fit.information * 0.0
    cov[:4, :4] = np.diag([variances[0], 1e-6, 1e-6, variances[1]])
    cov[0, 3] = cov[3, 0] = 2.0 * np.sqrt(abs(variances.prod()))
    broken = _Broken(fit, cov)
    (there,) = with_disagreement([fit], [broken], 1.0, centroid)
    assert there.disagreement == 1.0


@pytest.mark.parametrize("seed", range(4))
def test_tracks_of_another_scale_than_the_surface_widen_the_bounds(seed, opening, surface_of):
    """Tracks 2 % larger than the world, about a camera a metre and a half away; surfaces true."""
    truth = opening(seed, "revolute")
    surface = surface_of(truth)
    eye = surface.T_world_cam[:3, 3]
    off = PointTracks(eye + 1.02 * (truth.tracks.p_world - eye), truth.tracks.cov_world)
    sources = [SurfaceToRegister(surface)]
    agreed = fit_tracks(truth.tracks, sources=sources)
    posterior = fit_tracks(off, sources=sources)
    assert not any("disagree" in text for text in agreed.fit.warnings)
    assert any("disagree" in text for text in posterior.fit.warnings)
    joint = posterior.best.joint
    true_line = np.cross(joint.pivot - truth.T_world_joint[:3, 3], truth.axis)
    assert np.linalg.norm(true_line) <= joint.pivot_bound_m()
    assert joint.pivot_bound_m() > 2 * agreed.best.joint.pivot_bound_m()
