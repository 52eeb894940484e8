"""Explorations as JSON (`akm-fg/explore/1`, docs/conventions.md), there and back.

Beyond what the schema promises, everything is in it that a resumed exploration needs.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.exploration.records import (
    Attempt,
    BeliefSnapshot,
    Bounds,
    Contact,
    Exploration,
    FoundPart,
    Hypothesis,
    Stretch,
)

SCHEMA = "akm-fg/explore/1"


def exploration_as_dict(exploration: Exploration) -> dict[str, Any]:
    """Plain numbers, lists and strings. Who ran it adds object, seed, model and truth."""
    return {
        "schema": SCHEMA,
        "opened": exploration.opened,
        "pulls": exploration.pulls,
        "attempts": [_attempt(attempt) for attempt in exploration.attempts],
        "parts": [_found(part, exploration) for part in exploration.found],
        "stop": exploration.stop,
        "failure": exploration.failure,
        "notes": exploration.notes,
        "time_s": exploration.time_s,
        "contacts": [_contact(contact) for contact in exploration.contacts],
        "beliefs": [
            {
                "by_contact": belief.by_contact.tolist(),
                "anything": belief.anything,
                "free": belief.free,
            }
            for belief in exploration.beliefs
        ],
    }


def exploration_from_dict(data: dict[str, Any], place: str) -> Exploration:
    """What `exploration_as_dict` wrote; without pictures and fits.

    Args:
        data: of the file.
        place: its name, for messages.

    Raises:
        InputError: it is of another schema, or not whole.
    """
    if data.get("schema") != SCHEMA:
        raise InputError(place, f"its schema is {data.get('schema')!r}", SCHEMA)
    try:
        contacts = tuple(_contact_from(row) for row in data["contacts"])
        return Exploration(
            contacts=contacts,
            beliefs=[
                BeliefSnapshot(
                    np.array(row["by_contact"], dtype=float),
                    float(row["anything"]),
                    float(row.get("free", row["anything"])),
                )
                for row in data["beliefs"]
            ],
            attempts=[_attempt_from(row, contacts) for row in data["attempts"]],
            found=[_found_from(row, len(contacts)) for row in data.get("parts", [])],
            notes=list(data["notes"]),
            time_s=dict(data["time_s"]),
        )
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            place, f"is not a whole exploration ({error!r})", "what explore wrote"
        ) from error


def _found(part: FoundPart, exploration: Exploration) -> dict[str, Any]:
    return {
        "name": part.name,
        "attempt": part.attempt,
        "recording": exploration.attempts[part.attempt].recording,
        "kind": exploration.attempts[part.attempt].stretches[-1].kind,
        "state": part.state,
        "explains": list(part.explains),
    }


def _found_from(row: dict[str, Any], contacts: int) -> FoundPart:
    explains = tuple(int(place) for place in row["explains"])
    if any(not 0 <= place < contacts for place in explains):
        raise ValueError(f"contacts {explains} of {contacts}")
    state = None if row["state"] is None else float(row["state"])
    return FoundPart(row["name"], int(row["attempt"]), state, explains)


def _contact(contact: Contact) -> dict[str, Any]:
    return {
        "p_world": contact.p_world.tolist(),
        "uv": contact.uv.tolist(),
        "normal_world": contact.normal_world.tolist(),
        "front": contact.front,
        "prior": contact.prior,
        "what": contact.what,
        "serves": contact.serves,
    }


def _contact_from(row: dict[str, Any]) -> Contact:
    arrays = {key: np.array(row[key], dtype=float) for key in ("p_world", "uv", "normal_world")}
    return Contact(
        **arrays,
        front=int(row["front"]),
        prior=float(row["prior"]),
        what=row["what"],
        serves=float(row.get("serves", 1.0)),
    )


def _attempt(attempt: Attempt) -> dict[str, Any]:
    grasp = attempt.T_world_grasp
    return {
        "contact": attempt.hypothesis.contact,
        "contact_uv": attempt.contact.uv.tolist(),
        "p_world": attempt.contact.p_world.tolist(),
        "way": attempt.hypothesis.way,
        "direction_world": attempt.hypothesis.direction_world.tolist(),
        "probability": attempt.probability,
        "outcome": attempt.outcome,
        "reason": attempt.reason,
        "pulled": attempt.pulled,
        "held": attempt.held,
        "rigid_before": attempt.rigid_before,
        "regrasps": attempt.regrasps,
        "unseen_m": attempt.unseen_m,
        "grasps_refused": attempt.grasps_refused,
        "T_world_grasp": None if grasp is None else grasp.matrix().tolist(),
        "stretches": [_stretch(stretch) for stretch in attempt.stretches],
        "recording": attempt.recording,
        "time_s": attempt.time_s,
    }


def _attempt_from(row: dict[str, Any], contacts: tuple[Contact, ...]) -> Attempt:
    direction = np.array(row["direction_world"], dtype=float)
    grasp = row["T_world_grasp"]
    return Attempt(
        hypothesis=Hypothesis(int(row["contact"]), row["way"], direction),
        contact=contacts[int(row["contact"])],
        probability=float(row["probability"]),
        outcome=row["outcome"],
        reason=row["reason"],
        pulled=bool(row["pulled"]),
        held=bool(row["held"]),
        rigid_before=list(row.get("rigid_before", [])),
        unseen_m=float(row.get("unseen_m", 0.0)),
        stretches=[_stretch_from(stretch) for stretch in row["stretches"]],
        T_world_grasp=None if grasp is None else gtsam.Pose3(np.array(grasp, dtype=float)),
        grasps_refused=int(row["grasps_refused"]),
        regrasps=int(row["regrasps"]),
        recording=row["recording"],
        time_s=dict(row["time_s"]),
    )


def _stretch(stretch: Stretch) -> dict[str, Any]:
    bounds, expected = stretch.bounds, stretch.expected_next
    return {
        "travel_m": stretch.travel_m,
        "frames": stretch.frames,
        "kind": stretch.kind,
        "kind_probability": stretch.kind_probability,
        "state": stretch.state,
        "state_sd": stretch.state_sd,
        "state_seen": stretch.seen,
        **_bounds(bounds),
        "expected_next": None if expected is None else _bounds(expected),
        "solve_s": stretch.solve_s,
    }


def _bounds(bounds: Bounds | None) -> dict[str, Any]:
    """Bounds hold 95 %."""
    if bounds is None:
        return {"axis_sd_deg": None, "pivot_sd_m": None, "axis_bound_deg": None,
                "pivot_bound_m": None}  # fmt: skip
    return {
        "axis_sd_deg": float(np.rad2deg(bounds.axis_sd_rad)),
        "pivot_sd_m": bounds.pivot_sd_m,
        "axis_bound_deg": float(np.rad2deg(bounds.axis_rad)),
        "pivot_bound_m": bounds.pivot_m,
    }


def _stretch_from(row: dict[str, Any]) -> Stretch:
    expected = row["expected_next"]
    return Stretch(
        travel_m=float(row["travel_m"]),
        frames=int(row["frames"]),
        kind=row["kind"],
        kind_probability=dict(row["kind_probability"]),
        state=row["state"],
        state_sd=row["state_sd"],
        seen=bool(row.get("state_seen", True)),
        bounds=_bounds_from(row),
        expected_next=None if expected is None else _bounds_from(expected),
        solve_s=float(row["solve_s"]),
    )


def _bounds_from(row: dict[str, Any]) -> Bounds | None:
    if row["axis_bound_deg"] is None:
        return None
    return Bounds(
        axis_rad=float(np.deg2rad(row["axis_bound_deg"])),
        pivot_m=row["pivot_bound_m"],
        axis_sd_rad=float(np.deg2rad(row["axis_sd_deg"])),
        pivot_sd_m=row["pivot_sd_m"],
    )
