"""The memory that comes with the package: contacts that opened objects of `furniture-dev`.

Made by `python -m experiments.hands.contact_memory --ship`.
"""

from __future__ import annotations

from pathlib import Path

from akm_fg.exploration.analogy.contacts import ContactMemory

SHIPPED = Path(__file__).parent / "data"


def shipped_memory() -> ContactMemory:
    """The memory to begin with, described by the default features.

    Raises:
        InputError: it was left out where the package was installed.
    """
    return ContactMemory.read(SHIPPED)
