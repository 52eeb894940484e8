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
# Inside akm_fg: what a room, or a file beside the rooms, may know of the others. What is not named
# here puts them together (pipeline, stream, closed loop, settings, backends) and may know all of
# them but the command line.
RECORDS = {"records", "errors", "steps"}
INSIDE = {
    "records": set(),
    "errors": set(),
    "steps": set(),
    "interfaces": RECORDS,
    # Its own methods, when they are called.
    "posterior": RECORDS | {"posterior_views", "prediction"},
    "prediction": RECORDS | {"posterior"},
    "posterior_views": RECORDS | {"posterior"},
    "geometry": RECORDS,
    "perception": RECORDS | {"interfaces", "geometry"},
    "estimation": RECORDS | {"posterior", "geometry"},
    "arm": RECORDS | {"interfaces"},
    "grasping": RECORDS | {"interfaces", "arm"},
    "planning": RECORDS | {"posterior", "prediction"},
    "io": RECORDS | {"posterior", "posterior_views"},
    "report": RECORDS | {"posterior", "io"},
    "calibration": RECORDS | {"io"},
    "export": RECORDS | {"posterior", "io", "model"},
    # Knows no estimator: what was seen in a recording comes from perception.
    "view": RECORDS | {"posterior", "io", "model", "perception"},
    "model": RECORDS | {"posterior", "io", "geometry", "perception", "stages"},
}
# Rooms of a room, those that others stand on first; each may know those before it and those it is
# named with. Files beside the rooms stand on all of them, but for those named here.
INNER = {
    "akm_fg/estimation": [
        {"config"},
        {"joint_prior"},
        {"sources"},
        {"given"},
        {"one_kind"},
        {"between_kinds"},
        {"fit"},
        {"stream"},
    ],
    "akm_fg/perception": [
        {"depth"},
        {"fronts", "tracking"},
        {"moving_part", "observed"},
        {"change"},
        {"surface"},
    ],
    "akm_fg/arm": [{"body"}, {"motion"}],
    "factors": [
        {"adapter", "joint", "packed", "student_t"},
        {"joint_variables"},
        {"measurements"},
        {"priors"},
    ],
    "experiments": [
        {"baselines"},
        {"peers"},
        {"scores"},
        {"rows"},
        {"trials"},
        {"pages"},
        {"claims"},
        {"hands"},
    ],
}
ONLY_IN = {
    "pybullet": ("sim/",),
    "pybullet_data": ("sim/",),
    "filterpy": ("akm_fg/relocalization/bayes_filters.py",),
    "torch": ("akm_fg/backends/", "experiments/baselines/"),
    "ripl_articulation": ("experiments/peers/ripl_runner.py",),
}
THIRD_PARTY_OF_FACTORS = {"numpy", "gtsam"}


def _files():
    return [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def _imports(path):
    """Modules that a file imports when it runs; those for the type checker alone are left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing = [n for n in ast.walk(tree) if isinstance(n, ast.If) and _is_type_checking(n.test)]
    left_out = {id(node) for block in typing for node in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


def _is_type_checking(test):
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"


@pytest.mark.parametrize("path", _files(), ids=lambda p: str(p.relative_to(ROOT)))
def test_doors_inside_open_one_way_only(path):
    place = path.relative_to(ROOT).as_posix()
    here = place.removesuffix(".py").split("/")
    for module in _imports(path):
        there = module.split(".")
        if here[0] == there[0] == "akm_fg" and len(there) > 1 and here[1] != there[1]:
            known = INSIDE.get(here[1])
            allowed = there[1] in known if known is not None else there[1] != "cli"
            assert allowed or here[1] == "cli", f"{place} imports {module}"
        for room, order in INNER.items():
            outer = room.split("/")
            depth = len(outer)
            if here[:depth] == there[:depth] == outer and len(here) > depth < len(there):
                one, other = here[depth], there[depth]
                rank = {name: i for i, names in enumerate(order) for name in names}
                high = len(order)  # files beside the rooms
                below = rank.get(other, high) <= rank.get(one, high)
                assert below, f"{place} imports {module}"


def test_the_rooms_that_the_guards_name_exist():
    for room, order in INNER.items():
        for name in set().union(*order):
            assert (ROOT / room / name).is_dir() or (ROOT / room / f"{name}.py").is_file(), name
    for name in INSIDE:
        assert (ROOT / "akm_fg" / name).is_dir() or (ROOT / "akm_fg" / f"{name}.py").is_file(), name
    for places in ONLY_IN.values():
        assert all((ROOT / place).exists() for place in places), places
    assert (ROOT / COMPOSITION).is_dir() and (ROOT / ARM).is_dir()


@pytest.mark.parametrize("room", [*ROOMS, "tests"])
def test_no_folder_holds_more_than_about_a_dozen_files(room):
    for folder in [ROOT / room, *(p for p in (ROOT / room).rglob("*") if p.is_dir())]:
        files = [p for p in folder.glob("*.py") if p.name not in ("__init__.py", "conftest.py")]
        assert len(files) <= 14, folder


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
import akm_fg.pipeline
fit_loads_sklearn = "sklearn" in sys.modules  # a second, before a log of milliseconds
for name in {modules}:
    importlib.import_module(f"akm_fg.cli.{{name}}")
print("open3d" in sys.modules, fit_loads_sklearn)
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False False"


ARM_ALONE = """
import importlib, pkgutil, sys
import akm_fg.arm
for module in pkgutil.walk_packages(akm_fg.arm.__path__, "akm_fg.arm."):
    importlib.import_module(module.name)
from akm_fg.arm.body.collision import ArmCollisions
from akm_fg.arm.body.kinematics import Q_HOME, FrankaKinematics
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
