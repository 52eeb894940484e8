"""`akm-fg doctor`, and targets as people write them."""

import importlib.util
import json

import numpy as np
import pytest

from akm_fg.cli import doctor as doctor_module
from akm_fg.cli.main import main
from akm_fg.cli.target import parse_target
from akm_fg.errors import InputError


def test_doctor_names_every_package_with_its_version(capfd):
    assert main(["doctor", "--json", "-"]) == 0
    report = json.loads(capfd.readouterr().out.splitlines()[-1])
    found = {p["package"]: p for p in report["packages"]}
    assert found["gtsam"]["version"].startswith("4.3")
    assert found["numpy"]["problem"] is None
    assert found["open3d"]["version"].startswith("0.19")  # whichever of its builds is there


def test_doctor_says_what_is_missing_and_fails(capfd):
    absent = doctor_module.Package("no-such-package", "no_such_module", "the moon", False)
    assert doctor_module.doctor(doctor_module.DoctorArguments(), (absent,)) == 2
    assert "not installed" in capfd.readouterr().out


def test_doctor_names_the_renderer_and_why(monkeypatch, capfd):
    pytest.importorskip("pybullet", reason="the simulator is not installed")
    monkeypatch.setenv("AKM_FG_RENDERER", "tiny")
    assert main(["doctor", "--json", "-"]) == 0
    report = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert report["renderer"] == "tiny (AKM_FG_RENDERER=tiny)"
    monkeypatch.setenv("AKM_FG_RENDERER", "vulkan")
    assert main(["doctor"]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert "drawn by: none: AKM_FG_RENDERER='vulkan', expected one of auto, tiny, egl" in shown


def test_doctor_says_where_the_arm_is_described(monkeypatch, capfd):
    pytest.importorskip("pybullet_data", reason="the simulator is not installed")
    assert main(["doctor", "--json", "-"]) == 0
    report = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert report["arm_description"].endswith("franka_panda/panda.urdf")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["doctor"]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert "described by: none: the Franka's URDF comes with pybullet_data" in shown
    assert "install akm-fg[sim], or hand in" in shown


def test_an_absent_optional_package_is_no_failure(capfd):
    absent = doctor_module.Package("no-such-package", "no_such_module", "the moon", True)
    assert doctor_module.doctor(doctor_module.DoctorArguments(), (absent,)) == 0
    assert "optional" in capfd.readouterr().out


def test_a_package_that_does_not_load_is_told(monkeypatch):
    broken = doctor_module.Package("numpy", "no_such_module", "everything", False)
    assert "does not load" in doctor_module.examine(broken).problem


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("0.30", 0.30, "m"),
        ("30cm", 0.30, "m"),
        ("30 deg", np.deg2rad(30), "rad"),
        ("0.5rad", 0.5, "rad"),
        ("-5deg", np.deg2rad(-5), "rad"),
    ],
)
def test_targets_are_metres_or_degrees(text, value, unit):
    found, found_unit = parse_target(text)
    assert found == pytest.approx(value)
    assert found_unit == unit


@pytest.mark.parametrize("text", ["", "wide", "30 furlongs", "nan", "1.2.3", "inf"])
def test_other_targets_are_refused(text):
    with pytest.raises(InputError, match="expected metres"):
        parse_target(text)
