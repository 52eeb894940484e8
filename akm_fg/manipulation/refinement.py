"""Learning while doing: a model's joint with what a later recording of it tells.

With j the joint's tangent about the model's frame, c what the camera's calibration puts it off by,
shared by both recordings, c ~ N(0, K): the cameras tell a_i = j + c + e_i, e_i ~ N(0, E_i), and
the hands that held the part h_i = j + n_i. Each posterior of one recording, N(m_i, P_i), has both,
so the hand's share of it is P_i^-1 - (E_i + K)^-1, and of both together

    Lambda = sum_i [P_i^-1 - (E_i + K)^-1] + (E + K)^-1,   E^-1 = E_1^-1 + E_2^-1,

with information vectors alike: what is shared counts once. Without errors of calibration this is
the sum of the two informations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.stats import chi2

from akm_fg.calibrated import joint_errors
from akm_fg.model.records import ModelPart
from akm_fg.posterior import JointPosterior
from akm_fg.records import CalibrationErrors, CameraCorrection, FloatArray, PinholeCamera
from akm_fg.stages import RecordingFit

LEVEL = 0.999  # of a chi-square, beyond which two recordings are not of the same joint


@dataclass(frozen=True, slots=True)
class Refined:
    """A part as it is known after a further recording."""

    part: ModelPart
    note: str  # one line: what was learned, or why nothing was


@dataclass(frozen=True, slots=True)
class _Told:
    """What one recording says, in the observable tangent about one frame."""

    m: FloatArray  # (d,) the joint
    P: FloatArray  # (d, d)
    a: FloatArray  # (d,) the joint as the camera sees it
    E: FloatArray  # (d, d)


def refined(
    part: ModelPart,
    fit: RecordingFit,
    calibration: CalibrationErrors | None = None,
    camera: PinholeCamera | None = None,
    T_world_cam: gtsam.Pose3 | None = None,
) -> Refined:
    """A part of a model with what a fitted recording of it tells of its joint.

    Args:
        part: of the model.
        fit: of a later recording by the same camera; its posterior need not count from closed.
        calibration: what is not known of the camera; needs the next two.
        camera: that was.
        T_world_cam: where it is taken to stand.
    """
    best = fit.posterior.best
    if best.joint is None or str(fit.posterior.kind) != str(part.joint.kind):
        return Refined(part, f"nothing learned: the joint seems {fit.posterior.kind}")
    known = list(part.joint.kind.observable)
    T0 = gtsam.Pose3(part.joint.T_world_joint)
    one = _told(T0, part.joint, part.correction, known)
    two = _told(T0, best.joint, fit.correction, known)
    apart = two.a - one.a
    off = float(apart @ np.linalg.solve(one.E + two.E, apart))
    if off > chi2.ppf(LEVEL, len(known)):
        return Refined(
            part, f"nothing learned: the joint is seen elsewhere than before (chi-square {off:.0f})"
        )
    K = np.zeros((len(known), len(known)))
    if calibration is not None and camera is not None and T_world_cam is not None:
        T_cam_joint = T_world_cam.inverse().matrix() @ part.joint.T_world_joint
        K = joint_errors(T_cam_joint, calibration, part.joint, camera)[np.ix_(known, known)]
    mean, cov, a, E = _together(one, two, K)
    joint = _moved(part.joint, known, mean, cov)
    correction = part.correction
    if correction is not None:
        seen = _moved(part.joint, known, a, E)
        where = gtsam.Pose3(joint.T_world_joint) * gtsam.Pose3(seen.T_world_joint).inverse()
        correction = CameraCorrection(
            where, seen.cov, correction.length_share, correction.length_share_sd
        )
    kind = replace(part.posterior.best, joint=joint)
    alternatives = {**part.posterior.alternatives, str(joint.kind): kind}
    posterior = replace(part.posterior, alternatives=alternatives)
    before, after = (np.rad2deg(each.axis_bound_rad()) for each in (part.joint, joint))
    note = f"the axis is known to {after:.2f} deg, before to {before:.2f} deg"
    return Refined(replace(part, posterior=posterior, correction=correction), note)


def _told(
    T0: gtsam.Pose3, joint: JointPosterior, correction: CameraCorrection | None, known: list[int]
) -> _Told:
    m, P = _about(T0, gtsam.Pose3(joint.T_world_joint), joint.cov, known)
    if correction is None:
        return _Told(m, P, m, P)
    T_seen = correction.T_world_seen.inverse() * gtsam.Pose3(joint.T_world_joint)
    a, E = _about(T0, T_seen, correction.cov_seen_joint, known)
    return _Told(m, P, a, E)


def _about(
    T0: gtsam.Pose3, T: gtsam.Pose3, cov: FloatArray, known: list[int]
) -> tuple[FloatArray, FloatArray]:
    """A joint frame as an increment (d,) of T0, its gauge taken from T0, and its covariance."""
    G = _gauge(T0, T)  # T = T' G with T' the same axis, nearest to T0
    near = T * G.inverse()
    adjoint = G.AdjointMap()
    moved = adjoint @ cov @ adjoint.T
    xi = gtsam.Pose3.Logmap(T0.inverse() * near)
    return np.asarray(xi[known]), np.asarray(moved[np.ix_(known, known)])


def _gauge(T0: gtsam.Pose3, T: gtsam.Pose3) -> gtsam.Pose3:
    """T'^-1 T, for T' on the axis of T: z along that of T0, x and origin nearest to T0's."""
    R0, R = T0.rotation().matrix(), T.rotation().matrix()
    z = R[:, 2] if R[:, 2] @ R0[:, 2] >= 0 else -R[:, 2]
    x = R0[:, 0] - (R0[:, 0] @ z) * z
    x = x / np.linalg.norm(x)
    origin = T.translation() + ((T0.translation() - T.translation()) @ z) * z
    near = gtsam.Pose3(gtsam.Rot3(np.stack([x, np.cross(z, x), z], axis=1)), origin)
    return near.inverse() * T


def _together(
    one: _Told, two: _Told, K: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mean and covariance of the joint, and of the joint as the camera sees it."""
    E = _inverse(_inverse(one.E) + _inverse(two.E))
    a = E @ (_inverse(one.E) @ one.a + _inverse(two.E) @ two.a)
    information = _inverse(E + K)
    weighted = information @ a
    for each in (one, two):
        both, camera = _inverse(each.P), _inverse(each.E + K)
        information = information + _positive(both - camera)
        weighted = weighted + both @ each.m - camera @ each.a
    cov = _inverse(information)
    return cov @ weighted, cov, a, E


def _inverse(matrix: FloatArray) -> FloatArray:
    inverse = np.linalg.inv(matrix)
    return np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)


def _positive(matrix: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues: a difference of informations, rounded."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)


def _moved(
    joint: JointPosterior, known: list[int], xi: FloatArray, cov: FloatArray
) -> JointPosterior:
    whole, increment = np.zeros((6, 6)), np.zeros(6)
    whole[np.ix_(known, known)], increment[known] = cov, xi
    T = gtsam.Pose3(joint.T_world_joint) * gtsam.Pose3.Expmap(increment)
    return replace(joint, joint=replace(joint.joint, T_world_joint=T.matrix()), cov=whole)
