"""The part of a report that tells of a manipulation: what was decided, from which numbers."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from akm_fg.manipulation.records import Decision, Manipulation
from akm_fg.report.page import template
from akm_fg.report.wording import state
from factors.joint import Unit

_COLUMNS = ("what", "why", "state believed", "P(within)", "to", "95 % foreseen there")
_NONE = "-"


def manipulation_part(run: Manipulation, unit: Unit, notes: Sequence[str]) -> Markup:
    """HTML that goes before the pictures of a report's page.

    Args:
        run: what happened.
        unit: of the part's states.
        notes: lines beneath the table.
    """
    rows = [(str(k + 1), _row(decision, unit)) for k, decision in enumerate(run.decisions)]
    html = template("manipulation.html").render(columns=_COLUMNS, rows=rows, notes=list(notes))
    return Markup(html)


def _row(decision: Decision, unit: Unit) -> tuple[str, ...]:
    belief = "unknown"
    if decision.state is not None and decision.state_sd is not None:
        belief = f"{state(decision.state, unit)} ± {state(1.96 * decision.state_sd, unit)}"
    goes = _NONE if decision.commanded is None else state(decision.commanded, unit)
    return (
        decision.action,
        decision.why,
        belief,
        f"{decision.probability:.2f}",
        goes,
        _foreseen(decision, unit),
    )


def _foreseen(decision: Decision, unit: Unit) -> str:
    if not decision.foreseen:
        return _NONE if decision.reach is None else f"{100 * decision.reach:.0f} % within reach"
    across, turn = 1e3 * decision.foreseen["across_m"], decision.foreseen["turn_rad"]
    unseen = state(decision.foreseen["state"], unit)
    return f"hand {across:.1f} mm, {57.3 * turn:.1f}° off the way; state ± {unseen} unseen"
