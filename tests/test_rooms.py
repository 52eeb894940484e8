"""Which room may import which: experiments -> sim -> akm_fg -> factors."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("factors", "akm_fg", "sim", "experiments")
MAY_IMPORT = {
    "factors": set(),
    "akm_fg": {"factors"},
    "sim": {"akm_fg"},
    "experiments": {"sim", "akm_fg", "factors"},
}
# The command line puts all rooms together; sim knows akm_fg's records, errors and interfaces only.
COMPOSITION = "akm_fg/cli/"
SIM_MAY_IMPORT = ("akm_fg.records", "akm_fg.errors", "akm_fg.interfaces", "akm_fg.arm")
# What a real robot needs as much as the simulated one knows no simulator and no estimator.
ARM = "akm_fg/arm/"
ARM_MAY_IMPORT = ("akm_fg.arm", "akm_fg.records", "akm_fg.errors", "akm_fg.interfaces", "factors")
ONLY_IN = {
    "pybullet": ("sim/",),
    "pybullet_data": ("sim/",),
    "filterpy": ("akm_fg/relocalization/",),
    "torch": ("akm_fg/backends/", "experiments/baselines/"),
    "ripl_articulation": ("experiments/peers/ripl_runner.py",),
}
THIRD_PARTY_OF_FACTORS = {"numpy", "gtsam"}


def _files():
    return [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


@pytest.mark.parametrize("path", _files(), ids=lambda p: str(p.relative_to(ROOT)))
def test_doors_open_one_way_only(path):
    place = path.relative_to(ROOT).as_posix()
    room = place.split("/")[0]
    for module in _imports(path):
        top = module.split(".")[0]
        if top in ROOMS and top != room:
            allowed = top in MAY_IMPORT[room] or (place.startswith(COMPOSITION) and top == "sim")
            assert allowed, f"{place} imports {module}"
            if room == "sim":
                assert module.startswith(SIM_MAY_IMPORT), f"{place} imports {module}"
        if place.startswith(ARM) and top in ROOMS:
            assert module.startswith(ARM_MAY_IMPORT), f"{place} imports {module}"
        if top in ONLY_IN:
            assert place.startswith(ONLY_IN[top]), f"{place} imports {module}"
        if room == "factors" and top not in ROOMS:
            known = THIRD_PARTY_OF_FACTORS | set(sys.stdlib_module_names)
            assert top in known, f"{place} imports {module}"


def test_importing_the_package_loads_nothing_heavy():
    heavy = ("numpy", "gtsam", "cv2", "open3d")
    code = f"import sys, akm_fg; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_command_loads_open3d_before_it_needs_it():
    modules = [path.stem for path in sorted((ROOT / "akm_fg" / "cli").glob("[!_]*.py"))]
    code = f"""
import importlib, sys
for name in {modules}:
    importlib.import_module(f"akm_fg.cli.{{name}}")
import akm_fg.pipeline
print("open3d" in sys.modules)
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"


ARM_ALONE = """
import importlib, pkgutil, sys
import akm_fg.arm
for module in pkgutil.walk_packages(akm_fg.arm.__path__, "akm_fg.arm."):
    importlib.import_module(module.name)
from akm_fg.arm.collision import ArmCollisions
from akm_fg.arm.kinematics import Q_HOME, FrankaKinematics
FrankaKinematics().T_world_gripper(Q_HOME)
assert ArmCollisions([], 0.0).free(Q_HOME)
strange = ("pybullet", "pybullet_data", "sim", "experiments")
estimator = ("akm_fg.estimation", "akm_fg.perception", "akm_fg.pipeline", "akm_fg.closed_loop")
print(sorted(m for m in sys.modules if m.split(".")[0] in strange or m.startswith(estimator)))
"""


def test_the_arm_works_without_simulator_and_estimator():
    pytest.importorskip("pinocchio", reason="the arm's packages are not installed")
    command = [sys.executable, "-c", ARM_ALONE]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


READS_CONTACTS = ("getContactPoints", "getClosestPoints", "getOverlappingObjects")


def test_contacts_are_read_in_one_place():
    files = [*_files(), *(ROOT / "tests").rglob("*.py")]
    readers = {
        path.relative_to(ROOT).as_posix()
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in READS_CONTACTS
    }
    assert readers == {"sim/robot/contacts.py"}
