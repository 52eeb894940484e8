"""What a command needs that may not be installed."""

from __future__ import annotations

from importlib.util import find_spec

from akm_fg.errors import MissingDependency

ARM_MODULES = ("pinocchio", "pink", "daqp", "ompl")


def require_arm() -> None:
    """Refuse to go on without what plans for a robot arm.

    Raises:
        MissingDependency: it is not installed.
    """
    absent = [module for module in ARM_MODULES if find_spec(module) is None]
    if absent:
        needs = f"a robot arm needs {' and '.join(absent)}"
        raise MissingDependency(f"{needs}; install akm-fg[hardware]")
