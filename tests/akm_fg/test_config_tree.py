"""All tuning of a run is one tree: whatever is a config is a leaf or a table of it."""

import dataclasses
import importlib
import inspect
import pkgutil
from typing import get_args, get_type_hints

import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

import akm_fg
import sim
from akm_fg.cli.demo_config import DemoConfig

# Tables of backends, which a run asks for by name: `stages.own.NAME`.
OF_BACKENDS = {
    "AntipodalConfig",
    "CoTracker3Config",
    "DiftConfig",
    "DinoConfig",
    "EfficientNetConfig",
    "ExternalGraspsConfig",
    "Sam2Config",
}
# Rooms that no run hands any settings yet: they work with their defaults.
DEFAULTS_ALONE = {
    "CheckConfig",
    "ContactConfig",
    "ExportConfig",
    "FrontConfig",
    "HintConfig",
    "NamingConfig",
    "TransferConfig",
}
# What objects, places and pictures of suites are made with: the same for everybody, whoever runs.
NOT_OF_A_RUN = {
    "FaceConfig",
    "FixedViewConfig",
    "FurniturePlaceConfig",
    "PlacementConfig",
    "PoseConfig",
    "PublishedPlaceConfig",
    "SheetConfig",
}


def _configs(package):
    """Dataclasses of all files of a package that call themselves a config."""
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        module = importlib.import_module(info.name)
        for name, cls in inspect.getmembers(module, dataclasses.is_dataclass):
            if name.endswith("Config") and cls.__module__ == info.name:
                yield cls


def _tables(cls):
    """A tree's class and those of all its tables, also of tables that are absent by default."""
    yield cls
    for hint in get_type_hints(cls).values():
        for each in (hint, *get_args(hint)):
            if dataclasses.is_dataclass(each):
                yield from _tables(each)


def test_every_config_is_in_the_tree():
    found = [cls for package in (akm_fg, sim) for cls in _configs(package)]
    assert len(found) > 50
    # Of what is simulated, and of real devices.
    roots = [DemoConfig, *(cls for cls in found if cls.__name__ == "RobotConfig")]
    roots += [cls for cls in found if cls.__name__ in OF_BACKENDS | DEFAULTS_ALONE]
    there = {f"{cls.__module__}.{cls.__name__}" for root in roots for cls in _tables(root)}
    outside = [
        cls
        for cls in found
        if f"{cls.__module__}.{cls.__name__}" not in there and not issubclass(DemoConfig, cls)
    ]
    assert {cls.__name__ for cls in outside} <= NOT_OF_A_RUN
