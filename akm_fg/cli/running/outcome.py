"""What a run leaves in its folder and as JSON."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from akm_fg import __version__
from akm_fg.cli.running.recorder import RECORDING
from akm_fg.cli.running.simulated import ManipulateRequest, Ran
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.manipulation.page import manipulation_part
from akm_fg.model.records import ModelPart
from akm_fg.planning.move_length import LEVEL
from akm_fg.posterior import ArticulationPosterior, StatePosterior
from akm_fg.records import Recording, RoundSummary, first_hold
from akm_fg.report.summary import ArmRecord, Goal, RunSummary
from akm_fg.report.wording import state
from akm_fg.report.write import write_report
from akm_fg.view.embedded import embedded_view

REPORT = "report.html"


def write_run_report(request: ManipulateRequest, ran: Ran, title: str) -> Path | None:
    """Write report.html of the manipulation; None where no frame of one was taken.

    That of the exploration before it, if there was one, keeps its own name.

    Raises:
        OutputError: the disk refuses.
    """
    model, part, run, goal = ran.model, ran.part, ran.manipulation, ran.goal
    if model is None or part is None or goal is None or not run.looks:
        return None
    frames = tuple(look.frame for look in run.looks)
    grips = tuple(look.T_world_gripper for look in run.looks)
    recording = Recording(RECORDING, frames, None, grips, first_hold(run.looks))
    summary = RunSummary(
        title=title,
        command=request.explore.command,
        seed=request.explore.seed,
        version=__version__,
        recording=recording,
        tracks=None,
        posterior=_posterior(ran),
        truth=ran.truth,
        goal=Goal(goal.state - part.closed_state, goal.tolerance, part.joint.kind.unit),
        rounds=_rounds(ran),
        final_state_true=ran.final_state,
        arm=ArmRecord(None, None, ran.limit_shares),
        time_s=dict(run.time_s),
        failure=ran.failure,
    )
    notes = [f"Learned: {ran.learned}."] if ran.learned else []
    notes += [f"{line}." for line in beside_lines(ran)]
    words = manipulation_part(run, part.joint.kind.unit, notes)
    assert summary.posterior is not None
    moved = model.with_part(replace(part, posterior=summary.posterior))
    view = embedded_view(moved, title)
    folder = request.explore.folder
    path = folder / REPORT
    if path.exists():  # the exploration's
        path.rename(folder / "exploration.html")
    write_report(path, summary, request.explore.config.overlay, introduction=words, view=view)
    return path


def beside_lines(ran: Ran) -> list[str]:
    """A line for each of the other parts: where it is, and whether it moved meanwhile."""
    lines = []
    for part in () if ran.model is None else ran.model.parts:
        if part.name not in ran.beside:
            continue
        seen = ran.beside[part.name]
        if seen is None:
            lines.append(f"{part.name}: its state is unknown, it was not found")
            continue
        moved = "; it has moved meanwhile" if seen.moved else ""
        lines.append(f"{believed_line(part, *seen.state)}{moved}")
    return lines


def believed_line(part: ModelPart, q: float, sd: float) -> str:
    """What a part is and where it is believed to be, from closed."""
    unit = part.joint.kind.unit
    at, bound = state(q - part.closed_state, unit), state(LEVEL * sd, unit)
    return f"{part.name}: {part.posterior.kind}, state {at} ± {bound} (95 %)"


def _state_as_dict(part: ModelPart, q: float, sd: float | None) -> dict[str, Any]:
    """From closed."""
    return {"mean": q - part.closed_state, "sd": sd}


def _beside_as_dict(ran: Ran) -> dict[str, dict[str, Any] | None]:
    """States of the other parts."""
    parts = {} if ran.model is None else {part.name: part for part in ran.model.parts}
    return {
        name: None
        if seen is None
        else {**_state_as_dict(parts[name], *seen.state), "moved": seen.moved}
        for name, seen in ran.beside.items()
    }


def _rounds(ran: Ran) -> tuple[RoundSummary, ...]:
    """What was believed at first, and after each move, from closed."""
    rounds: list[RoundSummary] = []
    commanded = None
    part = ran.part
    closed = 0.0 if part is None else part.closed_state
    for decision in ran.manipulation.decisions:
        known = decision.state is not None and decision.state_sd is not None
        if known and (commanded is not None or not rounds):
            there = None if commanded is None else commanded - closed
            mean = (decision.state or 0.0) - closed
            rounds.append(RoundSummary(there, mean, decision.state_sd or 0.0, decision.probability))
            commanded = None
        if decision.action in ("move", "pull", "push"):
            commanded = decision.commanded
    return tuple(rounds)


def _posterior(ran: Ran) -> ArticulationPosterior:
    """The part's, with the states that were believed while it was moved."""
    part = ran.part
    assert part is not None
    unit = part.joint.kind.unit
    tracked = [belief.mode == "tracking" for belief in ran.manipulation.beliefs]
    means = [b.mean if t else None for b, t in zip(ran.manipulation.beliefs, tracked, strict=True)]
    sds = [b.sd if t else None for b, t in zip(ran.manipulation.beliefs, tracked, strict=True)]
    states = StatePosterior(unit, _numbers(means), _numbers(sds), from_closed=True)
    best = replace(part.posterior.best, states=states)
    alternatives = {**part.posterior.alternatives, str(part.joint.kind): best}
    return replace(part.posterior, alternatives=alternatives)


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values])


def run_as_dict(request: ManipulateRequest, ran: Ran, total_s: float) -> dict[str, Any]:
    """The run as JSON (`akm-fg/run/1`, docs/conventions.md)."""
    part, run, truth = ran.part, ran.manipulation, ran.truth
    belief = run.belief
    known = None
    if part and belief and belief.mode == "tracking" and belief.mean is not None:
        known = _state_as_dict(part, belief.mean, belief.sd)
    attempts = 0 if ran.explored is None else ran.explored.exploration.pulls
    return {
        "schema": "akm-fg/run/1",
        "object": request.explore.name,
        "seed": request.explore.seed,
        "explored": ran.explored is not None,
        "attempts": attempts,
        "posterior": None if part is None else posterior_as_dict(part.posterior),
        "part": None if part is None else part.name,
        "target": None if ran.goal is None or part is None else ran.goal.state - part.closed_state,
        "tolerance": None if ran.goal is None else ran.goal.tolerance,
        "rounds": run.rounds,
        "looks": run.clear_looks,
        "regrasps": run.regrasps,
        # A state that nobody knows is null.
        "state": known,
        "others": _beside_as_dict(ran),
        "p_within_tolerance": run.probability,
        "decisions": [asdict(decision) for decision in run.decisions],
        "stop": None if run.stop is None else asdict(run.stop),
        "learned": ran.learned,
        "model": None if ran.model_path is None else str(ran.model_path),
        "truth": None
        if truth is None
        else {
            "kind": truth.kind,
            "axis": truth.axis.tolist(),
            "pivot": None if truth.pivot is None else truth.pivot.tolist(),
            "start_state": ran.start_state,
            "final_state": ran.final_state,
            "pressed_n": ran.pressed_n,
            "limit_shares": ran.limit_shares,
        },
        "time_s": {**run.time_s, "manipulation_cpu": ran.cpu_s, "total": total_s},
        "failure": ran.failure,
    }
