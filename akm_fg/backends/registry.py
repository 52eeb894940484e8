"""Finds backends by their files' names, and makes the stages that a configuration asks for."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from akm_fg.backends import features, grasps, segmenters, trackers
from akm_fg.config import AkmConfig
from akm_fg.errors import InputError
from akm_fg.interfaces import DenseFeatures
from akm_fg.io.config_file import with_changes
from akm_fg.perception.config import PerceptionConfig
from akm_fg.stages import Stages

if TYPE_CHECKING:
    from types import ModuleType

    from _typeshed import DataclassInstance

    Tree = TypeVar("Tree", bound=DataclassInstance)


@dataclass(frozen=True, slots=True)
class BackendSettings:
    """What a backend is made with."""

    name: str
    perception: PerceptionConfig
    given: Mapping[str, Any]  # the backend's own table, as a file says it

    def own(self, default: Tree) -> Tree:
        """The backend's own tuning, a frozen dataclass, with what is given.

        Raises:
            InputError: a name that it does not have, or a value that it refuses.
        """
        return with_changes(default, self.given, f"stages.own.{self.name}")


def names(package: ModuleType) -> tuple[str, ...]:
    """Of the backends in a package such as `akm_fg.backends.trackers`; none is imported."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(package.__path__)))


def make(package: ModuleType, name: str, config: AkmConfig) -> Any:
    """The stage that a backend makes.

    Raises:
        InputError: there is no such backend, or it refuses its settings.
        MissingDependency: what it needs is not installed.
    """
    require_known(package, name)
    settings = BackendSettings(name, config.perception, config.stages.own.get(name, {}))
    return importlib.import_module(f"{package.__name__}.{name}").make(settings)


def require_known(package: ModuleType, name: str) -> None:
    """Refuse a name that no file in the package has.

    Raises:
        InputError: so.
    """
    known = names(package)
    if name not in known:
        what = package.__name__.rpartition(".")[2].removesuffix("s")
        raise InputError(
            f"{what} {name!r}", "there is none of that name", f"one of {', '.join(known)}"
        )


def features_of(config: AkmConfig) -> DenseFeatures | None:
    """The dense features that a configuration names; None for `none`.

    No fit needs them, and they load a network: so they are no part of `stages_of`.

    Raises:
        InputError: a backend that does not exist, or refuses its settings.
        MissingDependency: what it needs is not installed.
    """
    made: DenseFeatures | None = make(features, config.stages.features, config)
    return made


def stages_of(config: AkmConfig) -> Stages:
    """The stages that a configuration names.

    Raises:
        InputError: a backend that does not exist, or refuses its settings.
        MissingDependency: what it needs is not installed.
    """
    packages = (trackers, segmenters, features, grasps)
    known = tuple(name for package in packages for name in names(package))
    for name in config.stages.own:
        if name not in known:
            raise InputError(
                f"stages.own.{name}", "there is no such backend", f"one of {', '.join(known)}"
            )
    return Stages(
        tracker=make(trackers, config.stages.tracker, config),
        segmenter=make(segmenters, config.stages.segmenter, config),
    )
