"""What franky raises, as the one line that a person reads beside the robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from akm_fg.errors import ArmStopped

CONNECTING = "connecting"
LOST = "Net Exception"  # how a closed connection is called outside of control loops


@contextmanager
def told(host: str, doing: str) -> Iterator[None]:
    """Errors of franky and libfranka in here become one line.

    Args:
        host: of the robot.
        doing: what is done in here, as a participle.

    Raises:
        ArmStopped: there was one.
    """
    import franky

    causes = (
        franky.ControlException,
        franky.CommandException,
        franky.NetworkException,
        franky.ProtocolException,
        franky.RealtimeException,
        franky.IncompatibleVersionException,
        franky.InvalidOperationException,
        franky.GripperException,
        franky.ModelException,
        franky.Exception,
        RuntimeError,
    )
    try:
        yield
    except causes as error:
        raise ArmStopped(_line(error, host, doing)) from error


def _line(error: Exception, host: str, doing: str) -> str:
    import franky

    first = str(error).strip().split("\n", 1)[0].removeprefix("libfranka: ")
    if doing == CONNECTING:
        return (
            f"no Franka can be commanded at {host} ({first}): is it switched on, its brakes open, "
            "and FCI activated in Desk?"
        )
    if isinstance(error, franky.NetworkException) or LOST in first:
        return (
            f"the connection to the arm at {host} was lost while {doing} ({first}): without "
            "packets it stops by itself; its fingers stay as they are"
        )
    return (
        f"the arm at {host} stopped itself while {doing} ({first}): it stands still, its fingers "
        "as they are; look at it, clear the error in Desk, and start again"
    )
