"""Two recordings of one joint: better together, and no surer than is true."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.calibrated import joint_errors
from akm_fg.manipulation.refinement import refined
from akm_fg.records import CalibrationErrors, CameraCorrection, PinholeCamera
from akm_fg.stages import RecordingFit
from factors.joint import JointKind
from tests.akm_fg.manipulation.conftest import paper_joint, paper_posterior

CAMERA = PinholeCamera(640, 480, 450.0, 450.0, 319.5, 239.5)
T_WORLD_CAM = gtsam.Pose3(
    gtsam.Rot3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])),
    np.array([-0.5, 0.0, 0.8]),
)
ERRORS = CalibrationErrors(np.diag([1e-6] * 3 + [4e-6] * 3), 0.002, 0.01, 0.001)


def moved(joint, xi, cov, gauge=None):
    T = gtsam.Pose3(joint.T_world_joint) * gtsam.Pose3.Expmap(xi)
    adjoint = np.eye(6)
    if gauge is not None:  # the same axis by another frame
        T = T * gauge
        adjoint = gauge.inverse().AdjointMap()
    cov = adjoint @ cov @ adjoint.T
    known = np.zeros(6)
    known[list(joint.kind.observable)] = 1.0
    cov = cov * np.outer(known, known)
    return replace(joint, joint=replace(joint.joint, T_world_joint=T.matrix()), cov=cov)


def recording(rng, true, E, K, c, H, gauge):
    """Joint and correction as one recording gives them; `c` is the camera's error, shared."""
    known = list(true.kind.observable)
    d = len(known)
    seen = c + np.linalg.cholesky(E) @ rng.standard_normal(d)
    hand = np.linalg.cholesky(H) @ rng.standard_normal(d)
    P = np.linalg.inv(np.linalg.inv(E + K) + np.linalg.inv(H))
    mean = P @ (np.linalg.inv(E + K) @ seen + np.linalg.inv(H) @ hand)

    def whole(x):
        out = np.zeros((6,) * np.ndim(x))
        out[np.ix_(*[known] * np.ndim(x))] = x
        return out

    joint = moved(true, whole(mean), whole(P), gauge)
    apparent = moved(true, whole(seen), whole(E), gauge)
    where = gtsam.Pose3(joint.T_world_joint) * gtsam.Pose3(apparent.T_world_joint).inverse()
    return joint, CameraCorrection(where, apparent.cov)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_what_two_recordings_share_counts_once(kind, paper_part):
    rng = np.random.default_rng(7)
    true = paper_joint(kind)
    known = list(JointKind(kind).observable)
    d = len(known)
    T_cam_joint = T_WORLD_CAM.inverse().matrix() @ true.T_world_joint
    K = joint_errors(T_cam_joint, ERRORS, true, CAMERA)[np.ix_(known, known)]
    E, H = (s**2 * np.diag([1.0] * 2 + [0.5] * (d - 2)) for s in (0.003, 0.012))
    gauge = gtsam.Pose3(gtsam.Rot3.Rz(0.7), np.array([0.0, 0.0, 0.1]))
    flipped = gauge * gtsam.Pose3(gtsam.Rot3.Rx(np.pi), np.zeros(3))  # a part that was closed
    nees, before = [], []
    for k in range(200):
        c = np.linalg.cholesky(K + 1e-12 * np.eye(d)) @ rng.standard_normal(d)
        one, correction = recording(rng, true, E, K, c, H, None)
        two = recording(rng, true, E, K, c, H, flipped if k % 2 else gauge)
        part = replace(paper_part(kind), posterior=paper_posterior(one), correction=correction)
        fit = RecordingFit(None, paper_posterior(two[0]), two[1])
        told = refined(part, fit, ERRORS, CAMERA, T_WORLD_CAM)
        assert told.note.startswith("the axis is known to")
        off = gtsam.Pose3.Logmap(
            gtsam.Pose3(told.part.joint.T_world_joint).between(gtsam.Pose3(true.T_world_joint))
        )[known]
        cov = told.part.joint.cov[np.ix_(known, known)]
        nees.append(off @ np.linalg.solve(cov, off) / d)
        before.append(np.trace(cov) < np.trace(one.cov))
        assert np.all(np.linalg.eigvalsh(one.cov[np.ix_(known, known)] - cov) > -1e-9)
    assert np.mean(nees) == pytest.approx(1.0, abs=0.2)
    assert all(before)


def test_another_joint_teaches_nothing(paper_part):
    part = paper_part("revolute", axis_sd=0.003, pivot_sd=0.002)
    elsewhere = moved(part.joint, np.array([0.0, 0.0, 0.0, 0.05, 0.0, 0.0]), part.joint.cov)
    told = refined(part, RecordingFit(None, paper_posterior(elsewhere)))
    assert told.part is part
    assert "elsewhere" in told.note
    slides = refined(part, RecordingFit(None, paper_posterior(paper_joint("prismatic", 0.01))))
    assert slides.part is part
    assert "prismatic" in slides.note


def test_without_calibration_informations_add(paper_part):
    part = paper_part("revolute", axis_sd=0.004, pivot_sd=0.002)
    told = refined(part, RecordingFit(None, paper_posterior(part.joint)))
    assert told.part.joint.axis_sd_rad == pytest.approx(0.004 / np.sqrt(2))
    assert told.part.joint.pivot_sd_m == pytest.approx(0.002 / np.sqrt(2))
