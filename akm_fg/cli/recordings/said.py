"""What the flags of a command say of a recording's poses and depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from akm_fg.errors import InputError

if TYPE_CHECKING:
    from akm_fg.io.conventions import Axes, InputConventions, Up


class SaidOfPoses(Protocol):
    """The flags, by their names."""

    @property
    def convention(self) -> Axes | None:
        """Axes of the camera."""

    @property
    def invert_pose(self) -> bool:
        """Poses are T_cam_world."""

    @property
    def up(self) -> Up | None:
        """Axis of the world that points up."""

    @property
    def depth_unit(self) -> float | None:
        """Metres a unit of depth."""


def said_conventions(arguments: SaidOfPoses) -> InputConventions:
    """The flags as the readers take them.

    Raises:
        InputError: a unit that is none.
    """
    from akm_fg.io.conventions import InputConventions

    try:
        return InputConventions(
            arguments.convention, arguments.invert_pose or None, arguments.up, arguments.depth_unit
        )
    except ValueError as e:
        raise InputError("--depth-unit", str(e), "metres a unit, such as 0.001") from e
