"""Where a joint puts its part, and how sure that is: against sampled joints and states."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import akm_fg
from akm_fg.posterior import JointPosterior
from akm_fg.prediction import predict_points, predict_pose
from factors.joint import Joint, JointKind

SAMPLES = 20_000
TOLERANCE = 0.06  # of a covariance's entries, in units of the deviations: six of the samples' own
X = np.array([[0.5, -0.3, 0.7], [0.1, 0.4, 0.2]])


def _joint(kind: JointKind, rng: np.random.Generator) -> JointPosterior:
    T = gtsam.Pose3.Expmap(rng.normal(size=6)).matrix()
    spread = rng.normal(size=(6, 6)) * np.array([[2e-3, 3e-3, 1e-3, 4e-3, 2e-3, 3e-3]]).T
    cov = spread @ spread.T
    held = [i for i in range(6) if i not in kind.observable]
    cov[held, :] = cov[:, held] = 0.0
    pitch = 0.05 if kind.has_pitch else 0.0
    return JointPosterior(Joint(kind, T, pitch), cov, 0.004 if kind.has_pitch else None)


def _sampled(joint: JointPosterior, q: float, q_sd: float, rng: np.random.Generator):
    """Motions (S, 3, 3) and (S, 3) of joints and states drawn from the posterior."""
    xi = rng.multivariate_normal(np.zeros(6), joint.cov, SAMPLES, method="eigh")
    frame, R, t = gtsam.Pose3(joint.T_world_joint), [], []
    for each in xi:
        pitch = joint.joint.pitch + (joint.pitch_sd_m_per_rad or 0.0) * rng.normal()
        one = Joint(joint.kind, frame.retract(each).matrix(), pitch)
        (Ri,), (ti,) = one.motion(np.array([q + q_sd * rng.normal()]))
        R.append(Ri)
        t.append(ti)
    return np.array(R), np.array(t)


@pytest.mark.parametrize("kind", list(JointKind))
def test_points_scatter_as_predicted(kind: JointKind) -> None:
    rng = np.random.default_rng(1)
    joint, q, q_sd = _joint(kind, rng), 0.8, 0.005
    predicted = predict_points(joint, q, X, q_sd)
    R, t = _sampled(joint, q, q_sd, rng)
    for i, x in enumerate(X):
        p = R @ x + t
        found = np.cov(p.T)
        scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
        np.testing.assert_allclose(predicted.cov_world[i] / scale, found / scale, atol=TOLERANCE)
        sds = np.sqrt(np.diag(found) / SAMPLES)
        np.testing.assert_array_less(np.abs(p.mean(axis=0) - predicted.p_world[i]), 8 * sds + 2e-5)
    assert predicted.sd_m.shape == (2,) and (predicted.sd_m > 0.001).all()


@pytest.mark.parametrize("kind", list(JointKind))
def test_poses_scatter_as_predicted(kind: JointKind) -> None:
    rng = np.random.default_rng(2)
    joint, q, q_sd = _joint(kind, rng), 0.8, 0.005
    seen = gtsam.Pose3.Expmap(np.array([0.3, -0.4, 1.0, 0.2, 0.5, -0.1]))
    spread = 1e-3 * rng.normal(size=(6, 6))
    cov_seen = spread @ spread.T
    predicted = predict_pose(joint, q, seen, q_sd, cov_seen)
    pose = gtsam.Pose3(predicted.T_world_pose)
    R, t = _sampled(joint, q, q_sd, rng)
    own = rng.multivariate_normal(np.zeros(6), cov_seen, SAMPLES)
    drawn = (
        gtsam.Pose3(gtsam.Rot3(Ri), ti) * seen * gtsam.Pose3.Expmap(xi)
        for Ri, ti, xi in zip(R, t, own, strict=True)
    )
    found = np.cov(np.array([gtsam.Pose3.Logmap(pose.between(each)) for each in drawn]).T)
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(predicted.cov / scale, found / scale, atol=TOLERANCE)
    point = predict_points(joint, q, seen.translation(), q_sd)
    alone = predict_pose(joint, q, seen.matrix(), q_sd)
    np.testing.assert_allclose(alone.cov_world, point.cov_world[0], atol=1e-12)
    np.testing.assert_allclose(alone.T_world_pose[:3, 3], point.p_world[0], atol=1e-12)


def test_a_door_opened_by_a_quarter_turn_moves_the_handle_from_x_to_y() -> None:
    cov = np.diag([0, 0, 0, 0.001, 0.002, 0]) ** 2
    joint = JointPosterior(Joint(JointKind.REVOLUTE, np.eye(4), 0.0), cov)
    predicted = predict_points(joint, np.pi / 2, np.array([1.0, 0, 0]), 0.01)
    np.testing.assert_allclose(predicted.p_world, [[0, 1, 0]], atol=1e-12)
    # A pivot that is off by v moves the handle by v - R v, the state's error moves it along x.
    along_x = 0.01**2 + 0.001**2 + 0.002**2
    along_y = 0.001**2 + 0.002**2
    np.testing.assert_allclose(np.diag(predicted.cov_world[0]), [along_x, along_y, 0], atol=1e-12)


def test_where_the_part_was_seen_nothing_is_unsure() -> None:
    joint = _joint(JointKind.REVOLUTE, np.random.default_rng(0))
    predicted = predict_points(joint, 0.0, X)
    np.testing.assert_allclose(predicted.p_world, X, atol=1e-12)
    np.testing.assert_allclose(predicted.cov_world, 0, atol=1e-15)


def test_a_posterior_predicts_by_its_best_joint(door_model) -> None:
    part = door_model.parts[0]
    predicted = part.posterior.predict(0.5, X, 0.01)
    np.testing.assert_allclose(predicted.p_world[0], part.T_world_part(0.5).transformFrom(X[0]))
    rigid = replace(part.posterior.best, joint=None, states=None)
    still = replace(part.posterior, kind_probability={"rigid": 1.0}, alternatives={"rigid": rigid})
    with pytest.raises(ValueError, match="rigid"):
        still.predict(0.5, X)
    for wrong in (X[:, :2], np.zeros((1, 2, 3))):
        with pytest.raises(ValueError, match="points"):
            part.posterior.predict(0.5, wrong)
    for q, q_sd in ((np.nan, 0.0), (0.1, -1.0)):
        with pytest.raises(ValueError, match="state"):
            part.posterior.predict(q, X, q_sd)


def test_states_come_as_a_frame(door_model, monkeypatch) -> None:
    pytest.importorskip("pandas")
    posterior = door_model.parts[0].posterior
    frame = posterior.states_frame()
    states = posterior.best.states
    np.testing.assert_array_equal(frame["state"], states.mean)
    np.testing.assert_allclose(frame["high"] - frame["low"], 2 * 1.959964 * states.sd, rtol=1e-6)
    assert frame.index.name == "frame" and frame.attrs["unit"] == "rad"
    stamps = 0.1 * np.arange(states.mean.size)
    assert posterior.states_frame(stamps).loc[stamps[3], "sd"] == states.sd[3]
    with pytest.raises(ValueError, match="stamps"):
        posterior.states_frame([0.0])
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    from akm_fg.errors import MissingDependency

    with pytest.raises(MissingDependency, match=r"akm-fg\[pandas\]"):
        posterior.states_frame()


def test_what_is_read_and_made_is_named_by_the_package() -> None:
    assert {"fit", "read_recording", "read_model", "posterior_schema"} <= set(akm_fg.__all__)
