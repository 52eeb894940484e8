"""What an exploration opened, remembered for the next object: the memory of contacts grows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from akm_fg.exploration.analogy.contacts import Opened
from akm_fg.exploration.analogy.memory_folder import INDEX, add_contact
from akm_fg.exploration.perceive import Perceiver
from akm_fg.exploration.records import Exploration
from akm_fg.records import FloatArray

KINDS = ("prismatic", "revolute", "helical")


def remember(
    folder: Path, exploration: Exploration, perceiver: Perceiver, object_name: str, family: str
) -> int | None:
    """Add the contact that opened to the memory in a folder, which begins with what was asked.

    Returns how many are remembered then; None where there is nothing to remember: nothing was
    opened, its kind is not known, or nothing looks at objects as this memory does.

    Raises:
        InputError: what the folder holds is broken.
        OutputError: the disk refuses.
    """
    opened, frame = opened_at(exploration, object_name, family), exploration.first_look
    if opened is None or frame is None:
        return None
    told = perceiver.as_remembered(frame, opened)
    if told is None:
        return None
    contact, asked = told
    if not (folder / INDEX).exists():
        asked.write(folder)
    try:
        return len(add_contact(folder, contact, asked.made_by).contacts)
    except ValueError as error:
        exploration.notes.append(f"{folder}: nothing added: {error}")
        return None


def opened_at(exploration: Exploration, object_name: str, family: str) -> Opened | None:
    """Where, which way and as what the object opened; None where that is not known."""
    fit = exploration.fit
    if not exploration.opened or fit is None or fit.posterior.kind not in KINDS:
        return None
    attempt, best = exploration.attempts[-1], fit.posterior.best
    assert best.joint is not None and best.states is not None
    q = best.states.mean[np.isfinite(best.states.mean)]
    return Opened(
        object_name=object_name,
        family=family,
        kind=fit.posterior.kind,  # type: ignore[arg-type]
        contact_world=attempt.contact.p_world,
        direction_world=_unit(
            np.sign(q[-1] - q[0]) * best.joint.joint.velocity(attempt.contact.p_world)
        ),
        normal_world=attempt.contact.normal_world,
    )


def _unit(direction: FloatArray) -> FloatArray:
    return np.asarray(direction / np.linalg.norm(direction))
