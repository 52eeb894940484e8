"""Puts a run on one self-contained page: no network, no other files, scripts at most in a view.

The page is `templates/page.html` with its `style.css`; Jinja2 escapes all that is put in but the
plots, which are made here. This module says what is put in, as plain text.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from akm_fg.posterior import normal_bound
from akm_fg.records import Recording
from akm_fg.report.overlay import Colour, OverlayConfig, region_name
from akm_fg.report.path_plot import paths_svg
from akm_fg.report.pictures import Picture, axis_note, band_magnification, pictures
from akm_fg.report.plots import kinds_svg, states_svg
from akm_fg.report.rows import score_rows, target_words
from akm_fg.report.sentences import reading, verdict, what_was_done
from akm_fg.report.summary import CONFIDENCE, ArmRecord, RunSummary
from akm_fg.report.wording import NONE, duration, per_cent, size, state

_VERDICT_CLASS = {
    "reached": "good",
    "modelled": "good",
    "not reached": "bad",
    "failed": "bad",
    "wrong": "bad",
}
_ROUND_COLUMNS = ("sent to", "believed state", "95 % bound", "probability within tolerance")


@dataclass(frozen=True, slots=True)
class _Legend:
    """One entry below a picture."""

    words: str
    shape: str | None = None  # "": a dot, "line", "dash"; None: no mark
    colour: Colour | None = None


def render_page(
    summary: RunSummary,
    config: OverlayConfig | None = None,
    drawn: Sequence[Picture] | None = None,
    introduction: Markup | None = None,
    view: Markup | None = None,
) -> str:
    """The report as HTML.

    Args:
        summary: of the run.
        config: of what is drawn into the pictures.
        drawn: the pictures, where they were drawn already.
        introduction: HTML that goes before them.
        view: HTML that shows the object in three dimensions.
    """
    config = config or OverlayConfig()
    if drawn is None:
        drawn = () if summary.recording is None else pictures(summary, config)
    posterior, goal = summary.posterior, summary.goal
    return template("page.html").render(
        title=summary.title,
        sentence=what_was_done(summary),
        verdict_class=_VERDICT_CLASS.get(summary.verdict, ""),
        verdict=verdict(summary),
        introduction=introduction,
        view=view,
        warnings=() if posterior is None else posterior.fit.warnings,
        legend=_legend(summary, config),
        pictures=drawn,
        axis_note=None if summary.recording is None else axis_note(summary, config),
        rows=score_rows(summary),
        plots=_plots(summary),
        target="" if goal is None else target_words(goal),
        round_columns=_ROUND_COLUMNS,
        rounds=_rounds(summary),
        reading=reading(summary),
        command=summary.command,
        facts=_facts(summary),
    )


@cache
def template(name: str) -> Template:
    """A template of the reports; all that is put in is escaped, but what is Markup."""
    environment = Environment(
        loader=PackageLoader("akm_fg.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_with_its_unit,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    return environment.get_template(name)


def _with_its_unit(value: object) -> object:
    """A plain text whose numbers stay on one line with their units."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return re.sub(r"(?<=\d) (?=(?:%|cm|px|ms|s)\b|%)", "\N{NO-BREAK SPACE}", value)


def _legend(summary: RunSummary, config: OverlayConfig) -> list[_Legend]:
    if summary.recording is None:
        return []
    items = []
    tracks = summary.tracks
    if tracks is not None:
        moving, static = int(tracks.moving.sum()), int(tracks.static.sum())
        other = int((~(tracks.moving | tracks.static)).sum())
        items += [
            _Legend(f"moving part ({moving} points)", "", config.moving),
            _Legend(f"at rest ({static})", "", config.static),
            _Legend(f"rejected or undecided ({other})", "", config.rejected),
            _Legend(f"tails: the last {config.tail_frames} frames"),
        ]
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is not None:
        words = f"axis with its 95 % {region_name(joint.kind)}"
        factor = band_magnification(summary, config)
        if factor != 1:
            words += f", drawn {factor} × as wide"
        items.append(_Legend(words, "line", config.axis))
        if summary.truth is not None and summary.truth.kind == joint.kind:
            items.append(_Legend("true axis", "dash"))
    return items


def _plots(summary: RunSummary) -> list[tuple[Markup, str]]:
    """Each plot and its caption."""
    plots = []
    paths = paths_svg(summary)
    if paths is not None:
        words = "Where the points went, seen along the axis and from its side; the axis in colour."
        plots.append((Markup(paths), words))
    states = states_svg(summary)
    if states is not None:
        plots.append((Markup(states), "State over time, and the size of its uncertainty."))
    if summary.posterior is not None:
        kinds = kinds_svg(summary.posterior, CONFIDENCE)
        plots.append((Markup(kinds), "Probability of each joint kind."))
    return plots


def _rounds(summary: RunSummary) -> list[tuple[str, tuple[str, ...]]]:
    """The closed loop, round by round: when, and what `_ROUND_COLUMNS` names."""
    goal = summary.goal
    if goal is None:
        return []
    rows: list[tuple[str, tuple[str, ...]]] = []
    moves = 0
    for r in summary.rounds:
        moves += r.commanded is not None
        texts = (
            NONE if r.commanded is None else state(r.commanded, goal.unit),
            state(r.state_mean, goal.unit),
            size(normal_bound() * r.state_sd, goal.unit),
            per_cent(r.p_within_tolerance),
        )
        rows.append(("first look" if r.commanded is None else f"move {moves}", texts))
    return rows


def _facts(summary: RunSummary) -> list[tuple[str, str]]:
    rows = [("version", summary.version), ("seed", str(summary.seed))]
    if summary.recording is not None:
        rows.append(("recording", f"{summary.recording.name}, {_clip(summary.recording)}"))
    elif summary.paths is not None:
        frames, points = summary.paths.p_world.shape[:2]
        rows.append(("input", f"{points} point{'s' * (points != 1)} in {frames} frames"))
    if summary.posterior is not None:
        fit = summary.posterior.fit
        rows.append(
            ("tracks in the fit", f"{fit.tracks_used} used, {fit.tracks_rejected} rejected")
        )
        rows.append(("residual of the tracks", f"{size(fit.rms_m, 'm')} rms"))
        if fit.patches_used and fit.patches_rms_m is not None:
            surface = f"{fit.patches_used} patches of {len(fit.keyframes_registered)} frames"
            rows.append(("surface in the fit", f"{surface}, {size(fit.patches_rms_m, 'm')} rms"))
    rows += _arm_facts(summary.arm)
    times = ", ".join(f"{name} {duration(t)}" for name, t in summary.time_s.items())
    rows.append(("time per stage", times or NONE))
    return rows


def _arm_facts(arm: ArmRecord | None) -> list[tuple[str, str]]:
    if arm is None:
        return []
    rows = []
    if arm.slip_m is not None and arm.slip_rad is not None:
        slip = f"{size(arm.slip_m, 'm')} and {size(arm.slip_rad, 'rad')} at the end, as simulated"
        rows.append(("slip of the grasp", slip))
    if arm.limit_shares:
        shares = ", ".join(f"{what} {100 * s:.0f} %" for what, s in arm.limit_shares.items())
        rows.append(("most of the arm's limits", shares))
    return rows


def _clip(recording: Recording) -> str:
    stamps = np.array([frame.stamp_s for frame in recording.frames])
    camera = recording.frames[0].camera
    return f"{len(stamps)} frames of {camera.width}×{camera.height}, {np.ptp(stamps):.1f} s"
