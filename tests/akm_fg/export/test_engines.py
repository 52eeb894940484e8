"""An exported description is the same joint in PyBullet, pinocchio and MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.export.write import write_mjcf, write_urdf
from akm_fg.model.records import ModelPart
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


def in_pybullet(file: Path, part: int = 0) -> Loaded:
    pb = pytest.importorskip("pybullet")
    client = pb.connect(pb.DIRECT)
    try:
        body = pb.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        names = [pb.getJointInfo(body, i, client)[1] for i in range(pb.getNumJoints(body, client))]
        joint = names.index(f"part-{part}-joint".encode())
        info = pb.getJointInfo(body, joint, client)
        kinds = {pb.JOINT_REVOLUTE: JointKind.REVOLUTE, pb.JOINT_PRISMATIC: JointKind.PRISMATIC}
        pb.resetJointState(body, joint, _place(info[8], info[9]), physicsClientId=client)
        closed = pb.getLinkState(body, joint, computeForwardKinematics=1, physicsClientId=client)
        T = np.eye(4)
        T[:3, :3] = np.reshape(pb.getMatrixFromQuaternion(closed[5]), (3, 3))
        T[:3, 3] = closed[4]
        pb.resetJointState(body, joint, 0.0, physicsClientId=client)
        origin = pb.getLinkState(body, joint, computeForwardKinematics=1, physicsClientId=client)[4]
        shapes = len(pb.getVisualShapeData(body, physicsClientId=client))
        for link in range(-1, len(names)):
            shapes += len(pb.getCollisionShapeData(body, link, client))
        kind = kinds[info[2]]
        return Loaded(kind, np.array(info[13]), np.array(origin), info[8:10], T, shapes)
    finally:
        pb.disconnect(client)


def in_pinocchio(file: Path, part: int = 0) -> Loaded:
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(file))
    number = model.getJointId(f"part-{part}-joint")
    joint = model.joints[number]
    at = joint.idx_q
    moves_by = joint.shortname()
    kind = JointKind.REVOLUTE if "Revolute" in moves_by else JointKind.PRISMATIC
    low, high = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])
    data, q = model.createData(), np.zeros(model.nq)
    q[at] = _place(low, high)
    pin.forwardKinematics(model, data, q)
    T = data.oMi[number].homogeneous
    subspace = np.ravel(joint.createData().S)  # translation first
    axis = subspace[3:] if kind == JointKind.REVOLUTE else subspace[:3]
    shapes = 0
    for what in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        geometry = pin.buildGeomFromUrdf(model, str(file), what, package_dirs=str(file.parent))
        shapes += len(geometry.geometryObjects)
    origin = model.jointPlacements[number].translation
    return Loaded(kind, axis, origin, (low, high), T, shapes)


def in_mujoco(file: Path, part: int = 0) -> Loaded:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(file))
    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): JointKind.REVOLUTE,
        int(mujoco.mjtJoint.mjJNT_SLIDE): JointKind.PRISMATIC,
    }
    data = mujoco.MjData(model)
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"part-{part}-joint")
    low, high = model.jnt_range[joint]
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"part-{part}")
    mujoco.mj_forward(model, data)
    axis, origin = data.xaxis[joint].copy(), data.xanchor[joint].copy()
    data.qpos[joint] = _place(low, high)
    mujoco.mj_forward(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    kind = kinds[int(model.jnt_type[joint])]
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
    assert part.joint.kind == kind
    assert_is_the_models(loaded, part)
    assert loaded.shapes == 4  # either link is seen, and touched with one hull


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_every_joint_of_several_parts_is_the_models(
    two_part_model, several_described, engine: str, tmp_path: Path
) -> None:
    load, write = ENGINES[engine]
    file = write(tmp_path, several_described, two_part_model)
    assert [part.joint.kind for part in two_part_model.parts] == ["revolute", "prismatic"]
    for place, part in enumerate(two_part_model.parts):
        loaded = load(file, place)
        assert_is_the_models(loaded, part)
        assert loaded.shapes == 6


def assert_is_the_models(loaded: Loaded, part: ModelPart) -> None:
    """Kind, axis, origin and limits of a joint, and the place of its link."""
    assert loaded.kind == part.joint.kind
    np.testing.assert_allclose(loaded.axis, part.joint.axis, atol=1e-6)
    np.testing.assert_allclose(loaded.origin, part.joint.joint.origin, atol=1e-6)
    np.testing.assert_allclose(loaded.limits, part.range_seen(), atol=1e-6)
    # The link's frame lies at the joint's origin: the part's motion carries it.
    expected = part.T_world_part(_place(*part.range_seen())).matrix()
    origin = np.eye(4)
    origin[:3, 3] = part.joint.joint.origin
    np.testing.assert_allclose(loaded.T_world_link, expected @ origin, atol=1e-6)


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
