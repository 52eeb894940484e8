"""Users' objects in the world: built, gripped, pulled; the same every time, and from the cache."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from sim.bullet import load_urdf, p, quiet
from sim.episode import open_world
from sim.objects.imported.imported_build import build_imported
from sim.objects.imported.imported_spec import MASS_KG
from sim.objects.part_spec import standard_range
from sim.objects.staging import find_spec
from sim.objects.suites.catalogue import load_spec
from sim.objects.suites.furniture_build import build_furniture
from sim.robot.contacts import nearby
from sim.world import SimWorld

PULL_N = 25.0
DOOR = {"kind": "revolute", "axis": "0 1 0", "origin": (-0.45, 0.0, 0.52), "limits": (-1.57, 0.0)}


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def upright_bar(solid):
    """A door's handle at its free edge."""
    bars = [((0.35, 0.0, 0.61), (0.03, 0.30, 0.03))]
    bars += [((0.35, y, 0.57), (0.03, 0.03, 0.07)) for y in (-0.13, 0.13)]
    return [solid(middle, sides, "metal") for middle, sides in bars]


@pytest.mark.parametrize("case", ["drawer", "door", "continuous", "no collision"])
def test_an_object_settles_closed_and_opens_when_pulled_at_its_grip(
    case: str, mobility_object, upright_bar, tmp_path: Path
):
    given = {
        "drawer": {"limits": (0.0, -1.0), "axis": "0 0 -1"},
        "door": {**DOOR, "handle": upright_bar},
        "continuous": {**DOOR, "kind": "continuous", "limits": None, "handle": upright_bar},
        "no collision": {"limits": (-0.576, 0.136), "axis": "0 0 -1", "collision": False},
    }[case]
    folder = mobility_object(**given).write(tmp_path / "1")
    with SimWorld(f"partnet:{folder}", 0) as world:
        built, spec = world.built, world.spec
        assert MASS_KG[0] <= spec.mass_kg <= MASS_KG[1]
        run(world, 0.2)
        assert abs(world.part_state()) < 1e-3
        run(world, 0.4, PULL_N)
        assert world.part_state() > (0.02 if spec.kind == "prismatic" else 0.05)
        T = world.placement.T_world_object
        out = T.rotation().matrix() @ outwards(built)
        grip = T.transformFrom(built.T_object_handle.translation())
        assert out[:2] @ -grip[:2] > 0.0  # towards the robot, which stands at the origin
        assert standard_range(spec) <= (0.40 if spec.kind == "prismatic" else np.deg2rad(40.0))


def outwards(built) -> np.ndarray:
    arm = built.T_object_handle.translation() - built.pivot_object
    axis = built.axis_object
    way = axis if built.spec.kind == "prismatic" else np.cross(axis, arm)
    return way / np.linalg.norm(way)


def run(world: SimWorld, seconds: float, pull_n: float = 0.0) -> None:
    T = world.placement.T_world_object
    force = pull_n * (T.rotation().matrix() @ outwards(world.built))
    at = T.transformFrom(world.built.T_object_handle.translation())
    for _ in range(round(seconds / world.config.step_s)):
        if pull_n > 0.0:
            p.applyExternalForce(
                world.object_id,
                world.part_joint,
                force.tolist(),
                at.tolist(),
                p.WORLD_FRAME,
                physicsClientId=world.client,
            )
        world.step()


def test_the_part_has_the_inertia_of_its_shape_and_no_motor_but_friction(
    mobility_object, tmp_path: Path
):
    folder = mobility_object().write(tmp_path / "1")
    with SimWorld(f"partnet:{folder}", 0) as world:
        info = p.getDynamicsInfo(world.object_id, world.part_joint, physicsClientId=world.client)
        mass, width, height = world.spec.mass_kg, *(world.spec.size_m[[0, 2]] * [0.9, 1.1 / 1.2])
        assert info[0] == pytest.approx(mass)
        assert 0.5 <= world.spec.handle_mu <= 1.1  # dry rubber on metal or lacquer
        # A board of that mass: about its long sides and about its normal, within a tenth.
        board = sorted(mass / 12.0 * np.array([width**2, height**2, width**2 + height**2]))
        np.testing.assert_allclose(sorted(info[2]), board, rtol=0.12)
    body = world.built.urdf.parent / "object.urdf"
    with quiet():
        client = p.connect(p.DIRECT)
    try:
        import gtsam

        loaded = load_urdf(client, body, gtsam.Pose3())
        p.setGravity(0.0, -1.0, 0.0, physicsClientId=client)  # the drawer may run freely
        for _ in range(240):
            p.stepSimulation(physicsClientId=client)
        assert p.getJointState(loaded, 0, physicsClientId=client)[0] > 0.3
    finally:
        p.disconnect(client)


def test_colours_are_those_of_the_materials_and_pictures(mobility_object, tmp_path: Path):
    folder = mobility_object().write(tmp_path / "1")
    with open_world(f"partnet:{folder}", 0, "clean") as episode:
        rgb, _ = episode.camera.exact()
        built = episode.world.built
    files = built.urdf.parent
    shown = {path.read_text() for path in files.glob("part_*.mtl")}
    assert any("Kd 0.1020 0.2000 0.8000" in text for text in shown)  # paint: 0.1 0.2 0.8
    assert any("map_Kd" in path.read_text() for path in files.glob("corpus_*.mtl"))
    blue = (rgb[..., 2] > 100) & (rgb[..., 0] < 60)
    assert 0.03 < blue.mean() < 0.6


def test_fingers_fit_behind_a_handle_that_is_one_mesh(mobility_object, tmp_path: Path):
    folder = mobility_object().write(tmp_path / "1")
    with SimWorld(f"partnet:{folder}", 0) as world:
        T = world.placement.T_world_object * world.built.T_object_handle
        bar, gap = T.translation(), T.transformFrom(np.array([0.0, 0.0, 0.03]))
        thin = world.spec.handle.thickness_m
        assert overlaps(world, bar, 0.004)
        assert not overlaps(world, gap, 0.006)
        assert not overlaps(world, T.transformFrom(np.array([0.0, 0.7 * thin + 0.006, 0.0])), 0.003)
        assert world.spec.handle.fits and world.spec.handle.style == "handle"


def overlaps(world: SimWorld, p_world: np.ndarray, radius_m: float) -> bool:
    """Whether a small ball there would touch the part."""
    ball = p.createCollisionShape(p.GEOM_SPHERE, radius=radius_m, physicsClientId=world.client)
    body = p.createMultiBody(1.0, ball, -1, p_world.tolist(), physicsClientId=world.client)
    found = nearby(world.client, body, world.object_id, 0.0, link=-1, other_link=world.part_joint)
    p.removeBody(body, physicsClientId=world.client)
    return bool(found)


def test_the_same_file_builds_the_same_bytes_wherever_it_lies(mobility_object, tmp_path: Path):
    made = []
    for place in ("a", "b"):
        folder = mobility_object(second_joint=True).write(tmp_path / place)
        out = tmp_path / f"out-{place}"
        out.mkdir()
        spec = find_spec(f"partnet:{folder}", 3, joint="joint_0")
        build_imported(spec, out)
        made.append(out)
    files = sorted(f.name for f in made[0].iterdir())
    assert files == sorted(f.name for f in made[1].iterdir()) and "object.urdf" in files
    for file in files:
        a, b = ((folder / file).read_bytes() for folder in made)
        assert a.replace(b"/a", b"/b") == b, file


def test_the_other_joints_are_fixed(mobility_object, tmp_path: Path):
    folder = mobility_object(second_joint=True).write(tmp_path / "1")
    spec = find_spec(f"partnet:{folder}#joint_2", 0)
    assert spec.joint == "joint_2" and spec.kind == "revolute"
    out = tmp_path / "out"
    out.mkdir()
    build_imported(spec, out)
    robot = ET.parse(out / "moving.urdf").getroot()
    assert [joint.get("type") for joint in robot.iter("joint")] == ["revolute"]


@pytest.mark.parametrize("name", ["drawer-004", "door-008", "door-020", "slide-001"])
def test_our_own_furniture_comes_back_from_its_urdf_alone(name: str, tmp_path: Path):
    spec = load_spec(f"furniture-dev/{name}", 0)
    built = build_furniture(spec, tmp_path)
    found = find_spec(str(built.urdf), 0)
    assert (found.kind, found.hinge, found.closed) == (spec.kind, spec.hinge, 0.0)
    assert found.upper == pytest.approx(spec.upper, abs=1e-5)
    assert found.mass_kg == pytest.approx(spec.mass_kg, abs=1e-5)
    np.testing.assert_allclose(found.size_m[[0, 2]], spec.size_m[[0, 2]], atol=2e-3)
    assert found.handle.style == "protrusion" and found.handle.fits
    p_grip, p_handle = found.handle.T_object_handle[:3, 3], built.T_object_handle.translation()
    np.testing.assert_allclose(p_grip[[0, 2]], p_handle[[0, 2]], atol=0.02)
    along = found.handle.T_object_handle[:3, 0] @ built.T_object_handle.rotation().matrix()[:, 0]
    assert abs(along) > 0.99  # x runs along the bar


@pytest.mark.slow
def test_another_process_gets_the_very_same_object(mobility_object, tmp_path: Path):
    """Same seed, same bytes: also where hashes and threads fall otherwise."""
    folder = mobility_object().write(tmp_path / "1")
    code = (
        "import sys; from sim.objects.staging import find_spec, stage; "
        "from akm_fg.arm.body.kinematics import FrankaKinematics; "
        "from sim.objects.object_record import RECORD; b, _ = stage(find_spec("
        "sys.argv[1], 5), FrankaKinematics()); print((b.urdf.parent / RECORD).read_text())"
    )
    told = set()
    for place in ("x", "y"):
        env = {"XDG_CACHE_HOME": str(tmp_path / place), "PATH": "/usr/bin:/bin"}
        told.add(
            subprocess.run(
                [sys.executable, "-c", code, f"partnet:{folder}"],
                env=env,
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
    assert len(told) == 1
