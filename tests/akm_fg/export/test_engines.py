"""An exported description is the same joint in PyBullet, pinocchio and MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.export.write import write_mjcf, write_urdf
from factors.joint import JointKind


@dataclass(frozen=True)
class Loaded:
    """What an engine makes of a description: T_world_link at three quarters of the range."""

    kind: JointKind
    axis: np.ndarray
    origin: np.ndarray
    limits: tuple[float, float]
    T_world_link: np.ndarray
    shapes: int  # that something can touch or see


def in_pybullet(file: Path) -> Loaded:
    pb = pytest.importorskip("pybullet")
    client = pb.connect(pb.DIRECT)
    try:
        body = pb.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        info = pb.getJointInfo(body, 0, client)
        kinds = {pb.JOINT_REVOLUTE: JointKind.REVOLUTE, pb.JOINT_PRISMATIC: JointKind.PRISMATIC}
        pb.resetJointState(body, 0, _place(info[8], info[9]), physicsClientId=client)
        closed = pb.getLinkState(body, 0, computeForwardKinematics=1, physicsClientId=client)
        T = np.eye(4)
        T[:3, :3] = np.reshape(pb.getMatrixFromQuaternion(closed[5]), (3, 3))
        T[:3, 3] = closed[4]
        pb.resetJointState(body, 0, 0.0, physicsClientId=client)
        origin = pb.getLinkState(body, 0, computeForwardKinematics=1, physicsClientId=client)[4]
        shapes = len(pb.getVisualShapeData(body, physicsClientId=client))
        shapes += len(pb.getCollisionShapeData(body, 0, client))
        shapes += len(pb.getCollisionShapeData(body, -1, client))
        kind = kinds[info[2]]
        return Loaded(kind, np.array(info[13]), np.array(origin), info[8:10], T, shapes)
    finally:
        pb.disconnect(client)


def in_pinocchio(file: Path) -> Loaded:
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(file))
    joint = model.joints[1]
    moves_by = joint.shortname()
    kind = JointKind.REVOLUTE if "Revolute" in moves_by else JointKind.PRISMATIC
    low, high = float(model.lowerPositionLimit[0]), float(model.upperPositionLimit[0])
    data = model.createData()
    pin.forwardKinematics(model, data, np.array([_place(low, high)]))
    T = data.oMi[1].homogeneous
    subspace = np.ravel(joint.createData().S)  # translation first
    axis = subspace[3:] if kind == JointKind.REVOLUTE else subspace[:3]
    shapes = 0
    for what in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        geometry = pin.buildGeomFromUrdf(model, str(file), what, package_dirs=str(file.parent))
        shapes += len(geometry.geometryObjects)
    origin = model.jointPlacements[1].translation
    return Loaded(kind, axis, origin, (low, high), T, shapes)


def in_mujoco(file: Path) -> Loaded:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(file))
    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): JointKind.REVOLUTE,
        int(mujoco.mjtJoint.mjJNT_SLIDE): JointKind.PRISMATIC,
    }
    data = mujoco.MjData(model)
    low, high = model.jnt_range[0]
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "part-0")
    mujoco.mj_forward(model, data)
    axis, origin = data.xaxis[0].copy(), data.xanchor[0].copy()
    data.qpos[0] = _place(low, high)
    mujoco.mj_forward(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    kind = kinds[int(model.jnt_type[0])]
    return Loaded(kind, axis, origin, (float(low), float(high)), T, model.ngeom)


def _place(low: float, high: float) -> float:
    return low + 0.75 * (high - low)


ENGINES = {
    "pybullet": (in_pybullet, write_urdf),
    "pinocchio": (in_pinocchio, write_urdf),
    "mujoco": (in_mujoco, write_urdf),
    "mujoco's own format": (in_mujoco, write_mjcf),
}


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_kind_axis_origin_limits_and_motion_are_the_models(
    described, kind: str, engine: str, tmp_path: Path
) -> None:
    load, write = ENGINES[engine]
    model, description, _ = described[kind]
    loaded = load(write(tmp_path, description, model))
    part = model.parts[0]
    assert loaded.kind == part.joint.kind == kind
    np.testing.assert_allclose(loaded.axis, part.joint.axis, atol=1e-6)
    np.testing.assert_allclose(loaded.origin, part.joint.joint.origin, atol=1e-6)
    np.testing.assert_allclose(loaded.limits, part.range_seen(), atol=1e-6)
    # The link's frame lies at the joint's origin: the part's motion carries it.
    expected = part.T_world_part(_place(*part.range_seen())).matrix()
    origin = np.eye(4)
    origin[:3, 3] = part.joint.joint.origin
    np.testing.assert_allclose(loaded.T_world_link, expected @ origin, atol=1e-6)
    assert loaded.shapes == 4  # either link is seen, and touched with one hull


def test_a_closed_state_other_than_zero_is_position_zero(
    described, with_joint_of, tmp_path: Path
) -> None:
    pytest.importorskip("pybullet")
    model, _, _ = described["revolute"]
    part = replace(model.parts[0], closed_state=0.3)
    moved = replace(model, parts=(part,))
    loaded = in_pybullet(write_urdf(tmp_path, with_joint_of(moved), moved))
    low, high = part.range_seen()
    np.testing.assert_allclose(loaded.limits, (low - 0.3, high - 0.3), atol=1e-6)
    expected = part.T_world_part(0.3 + _place(*loaded.limits)).matrix()
    np.testing.assert_allclose(loaded.T_world_link[:3, :3], expected[:3, :3], atol=1e-6)


def test_a_screw_is_a_hinge_that_takes_a_slide_along(
    screw_model, with_joint_of, tmp_path: Path
) -> None:
    mujoco = pytest.importorskip("mujoco")
    file = write_mjcf(tmp_path, with_joint_of(screw_model), screw_model)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.njnt == 2 and model.neq == 1
    np.testing.assert_allclose(model.eq_data[0, :3], [0, 0.05, 0])
    data = mujoco.MjData(model)
    # joint1 = polycoef(joint2): the slide follows the hinge.
    assert model.jnt_type[model.eq_obj1id[0]] == mujoco.mjtJoint.mjJNT_SLIDE
    assert model.jnt_type[model.eq_obj2id[0]] == mujoco.mjtJoint.mjJNT_HINGE
    data.qpos[model.eq_obj2id[0]], data.qpos[model.eq_obj1id[0]] = 0.4, 0.02
    mujoco.mj_forward(model, data)
    assert abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() < 1e-9
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "part-0")
    part = screw_model.parts[0]
    there = part.T_world_part(0.4).transformFrom(part.joint.joint.origin)
    np.testing.assert_allclose(data.xpos[body], there, atol=1e-6)
