"""The arm's description: found, taken from elsewhere, and refused in one line."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body import description
from akm_fg.arm.body.collision import ArmCollisions, arm_corners, inside_arm
from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.kinematics import Q_HOME, FrankaKinematics
from akm_fg.arm.body.model import ROBOT_LINKS, read_meshes, read_model
from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.arm.motion.surroundings import KnownScene
from akm_fg.errors import InputError, MissingDependency
from akm_fg.records import PinholeCamera, RgbdFrame
from sim.camera.views import look_at

CAMERA = PinholeCamera(80, 60, 75.0, 75.0, 39.5, 29.5)
T_WORLD_CAM = look_at(np.array([0.2, -1.0, 0.6]), np.array([0.4, 0.0, 0.4]))


@pytest.fixture
def elsewhere(tmp_path: Path) -> ArmDescription:
    """The Franka of the installed package, copied."""
    source = franka_description().urdf.parent
    shutil.copytree(source, tmp_path / "my robot")
    return ArmDescription(tmp_path / "my robot" / "panda.urdf")


def without_default(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(name: str) -> None:
        raise AssertionError(f"{name}: the given description was not handed on")

    monkeypatch.setattr(importlib.util, "find_spec", nowhere)


def numbers(arm: ArmDescription | None) -> list[np.ndarray]:
    """What every part of the arm's code makes of a description."""
    moves = FrankaKinematics(description=arm)
    reached = moves.T_world_gripper(Q_HOME)
    points = np.stack([reached.translation(), reached.translation() + 0.1])
    scene = KnownScene(0.0, description=arm)
    depth = np.full((60, 80), 2.0, np.float32)
    frame = RgbdFrame(0.0, np.zeros((60, 80, 3), np.uint8), depth, CAMERA, T_WORLD_CAM)
    scene.see(frame, Q_HOME)
    around = scene.around(reached * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.1])), 0.02)
    folded = Q_HOME - 2.3 * np.eye(7)[5]
    return [
        reached.matrix(),
        np.array(moves.solve(reached, Q_HOME + 0.05)),
        np.concatenate(arm_corners(Q_HOME, arm)),
        inside_arm(points, Q_HOME, 0.03, arm),
        np.array([ArmCollisions([], 0.02, description=arm).free(q) for q in (Q_HOME, folded)]),
        np.array([around.free_motion.free(Q_HOME), around.approach.free(Q_HOME)]),
        ArmSilhouette(arm).depth(Q_HOME, 0.02, CAMERA, T_WORLD_CAM),
    ]


def test_a_description_in_another_folder_gives_the_same_arm(
    elsewhere: ArmDescription, monkeypatch: pytest.MonkeyPatch
):
    expected = numbers(None)
    without_default(monkeypatch)
    found = numbers(elsewhere)
    assert np.isfinite(found[-1]).sum() > 100 and len(np.unique(found[4])) == 2
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_the_description_says_is_what_the_arm_is(elsewhere: ArmDescription):
    """A hand that is 50 mm longer, and a gripper frame of another name."""
    text = elsewhere.urdf.read_text().replace("panda_grasptarget", "my_tcp")
    elsewhere.urdf.write_text(text.replace('xyz="0 0 0.105"', 'xyz="0 0 0.155"'))
    moves = FrankaKinematics(description=ArmDescription(elsewhere.urdf, gripper_frame="my_tcp"))
    longer, usual = (x.T_world_gripper(Q_HOME) for x in (moves, FrankaKinematics()))
    np.testing.assert_allclose(usual.between(longer).translation(), [0, 0, 0.05], atol=1e-12)
    q = moves.solve(longer, Q_HOME + 0.05)
    assert q is not None and moves.T_world_gripper(q).equals(longer, 1e-4)
    with pytest.raises(InputError, match="no link panda_grasptarget; expected a URDF of"):
        FrankaKinematics(description=elsewhere)


def test_meshes_may_lie_in_a_folder_of_their_own(elsewhere: ArmDescription, tmp_path: Path):
    shutil.move(elsewhere.urdf, tmp_path / "arm.urdf")
    alone = ArmDescription(tmp_path / "arm.urdf")
    with pytest.raises(InputError, match=r"link0.obj could not be found\.; expected its meshes in"):
        read_meshes(alone, read_model(alone))
    both = ArmDescription(tmp_path / "arm.urdf", (tmp_path / "my robot",))
    assert len(read_meshes(both, read_model(both)).geometryObjects) == len(ROBOT_LINKS)


def test_without_the_package_the_line_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependency, match=r"install akm-fg\[sim\], or hand in") as told:
        FrankaKinematics()
    assert "\n" not in str(told.value)
    empty = SimpleNamespace(origin=str(tmp_path / "__init__.py"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: empty)
    with pytest.raises(InputError, match=r"panda.urdf: no such file; expected the Franka of pybul"):
        description.franka_description()


@pytest.mark.parametrize(
    ("found", "put", "told"),
    [
        ("</robot>", "", "not XML"),
        ("robot", "arm", "its root is <arm>"),
        ("panda_joint3", "elbow", "its joints are panda_joint1, panda_joint2, elbow"),
        ("panda_link8", "flange", None),  # no mesh, and nobody asks for it
        ("panda_hand", "my_hand", "no link panda_hand"),
        ("<collision>", "<collision><origin/></collision><collision>", "pinocchio|URDF|shapes"),
        ("collision/link5.obj", "collision/none.obj", "none.obj could not be found"),
        ('<mesh filename="package://meshes/collision/link7.obj"/>', "<sphere radius='1'/>", "mesh"),
    ],
)
def test_another_urdf_is_refused_in_one_line(
    elsewhere: ArmDescription, found: str, put: str, told: str | None, capfd
):
    elsewhere.urdf.write_text(elsewhere.urdf.read_text().replace(found, put))
    if told is None:
        ArmCollisions([], 0.0, description=elsewhere)
        return
    with pytest.raises(InputError, match=told) as error:
        ArmCollisions([], 0.0, description=elsewhere)
    assert str(elsewhere.urdf) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("place", ["nowhere.urdf", "."])
def test_what_is_no_file_is_refused(place: str, tmp_path: Path, capfd):
    with pytest.raises(InputError, match=r"(No such file|Is a directory).*; expected a URDF"):
        FrankaKinematics(description=ArmDescription(tmp_path / place))
    assert capfd.readouterr() == ("", "")
