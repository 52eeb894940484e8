"""What can go wrong, by cause.

A caller's mistake or a broken input is an :class:`AkmError`; its text is the one line a person
reads. Data that are sound but do not suffice are errors too where no posterior can be given
(:class:`NoMotionObserved`, :class:`AxisUnobservable`).
"""

from __future__ import annotations


class AkmError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(AkmError):
    """A file or folder that cannot be read as what it should be.

    The text names the place, what is wrong, and what is expected.
    """

    def __init__(self, place: object, problem: str, expected: str) -> None:
        super().__init__(f"{place}: {problem}; expected {expected}")
        self.place = str(place)
        self.problem = problem
        self.expected = expected


class OutputError(AkmError):
    """A result that cannot be written where it was asked for."""


class MissingDependency(AkmError):
    """An optional package that this command needs is not installed."""


class InsufficientData(AkmError):
    """Sound data that do not suffice for a posterior."""


class NoMotionObserved(InsufficientData):
    """Nothing moved beyond the noise level."""


class TracksLost(InsufficientData):
    """No point could be followed long enough to say anything."""


class AxisUnobservable(InsufficientData):
    """The data leave a direction of a variable open; the text names it."""


class GraspFailed(AkmError):
    """The gripper does not hold the part."""


class MotionInfeasible(AkmError):
    """The arm cannot follow the wanted path."""


class ArmStopped(AkmError):
    """The real arm stands still, or cannot be commanded: a person looks before it goes on."""


class CameraFailed(AkmError):
    """The real camera gives no pictures, or not those that it should."""


class DryRunEnded(AkmError):
    """A dry run has said what would move first; all else depends on what would be seen then."""
