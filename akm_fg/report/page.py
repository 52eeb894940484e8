"""Puts a run on one self-contained page: no scripts, no network, no other files."""

from __future__ import annotations

import base64
import re
from html import escape as escape_html

import numpy as np

from akm_fg.posterior import normal_bound
from akm_fg.report.overlay import Colour, OverlayConfig, region_name
from akm_fg.report.pictures import Picture, axis_note, band_magnification, pictures
from akm_fg.report.plots import kinds_svg, states_svg
from akm_fg.report.rows import Row, score_rows
from akm_fg.report.sentences import reading, verdict, what_was_done
from akm_fg.report.summary import CONFIDENCE, ArmRecord, RunSummary
from akm_fg.report.template import PAGE
from akm_fg.report.wording import NONE, chosen, duration, per_cent, size, state

_VERDICT_CLASS = {
    "reached": "good",
    "modelled": "good",
    "not reached": "bad",
    "failed": "bad",
    "wrong": "bad",
}


def escape(text: str) -> str:
    """HTML of a plain text; numbers stay on one line with their units."""
    return re.sub(r"(?<=\d) (?=(?:%|cm|px|ms|s)\b|%)", "\N{NO-BREAK SPACE}", escape_html(text))


def render_page(summary: RunSummary) -> str:
    """The report as HTML."""
    config = OverlayConfig()
    head, rest = verdict(summary)
    return PAGE.substitute(
        title=escape(summary.title),
        sentence=escape(what_was_done(summary)),
        verdict_class=_VERDICT_CLASS.get(summary.verdict, ""),
        verdict=f"<b>{escape(head)}</b> {escape(rest)}",
        notes=_notes(summary),
        pictures=_pictures(summary, config),
        results=_results(score_rows(summary)),
        plots=_plots(summary),
        rounds=_rounds(summary),
        reading=_definitions(reading(summary)),
        command=escape(summary.command),
        facts=_facts(summary),
    )


def _notes(summary: RunSummary) -> str:
    warnings = summary.posterior.fit.warnings if summary.posterior is not None else ()
    return "".join(f'<p class="soft">Note: {escape(w)}</p>' for w in warnings)


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.jpeg).decode()
    caption = escape(picture.caption)
    return (
        f'<figure><img width="{picture.width}" height="{picture.height}" alt="{caption}" '
        f'src="data:image/jpeg;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _pictures(summary: RunSummary, config: OverlayConfig) -> str:
    main, *others = (_picture(p) for p in pictures(summary, config))
    note = axis_note(summary, config)
    words = "" if note is None else f"<p>{escape(note)}</p>"
    small = f'<div class="small">{"".join(others)}</div>' if others else ""
    return _legend(summary, config) + main + words + small


def _legend(summary: RunSummary, config: OverlayConfig) -> str:
    def mark(colour: Colour, shape: str = "") -> str:
        return f'<i class="{shape}" style="background:rgb{colour}"></i>'

    items = []
    tracks = summary.tracks
    if tracks is not None:
        other = ~(tracks.moving | tracks.static)
        items += [
            f"{mark(config.moving)}moving part ({int(tracks.moving.sum())} points)",
            f"{mark(config.static)}at rest ({int(tracks.static.sum())})",
            f"{mark(config.rejected)}rejected or undecided ({int(other.sum())})",
            f"tails: the last {config.tail_frames} frames",
        ]
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is not None:
        words = f"axis with its 95 % {region_name(joint.kind)}"
        factor = band_magnification(summary, config)
        if factor != 1:
            words += f", drawn {factor} × as wide"
        items.append(mark(config.axis, "line") + words)
        if summary.truth is not None and summary.truth.kind == joint.kind:
            items.append('<i class="dash"></i>true axis')
    return '<ul class="legend">' + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _cell(label: str, text: str, colour: str = "") -> str:
    return f'<td data-label="{label}" class="{colour}">{escape(text)}</td>'


def _results(rows: tuple[Row, ...]) -> str:
    if not rows:
        return "<p>No joint could be estimated, so there is nothing to list.</p>"
    colours = {True: "good", False: "bad", None: ""}
    body = "".join(
        f'<tr><th scope="row">{escape(row.quantity)}</th>'
        + _cell("estimate", row.estimate)
        + _cell("95 % bound", row.bound)
        + _cell("true error", row.error, colours[row.good])
        + "</tr>"
        for row in rows
    )
    heads = ("quantity", "estimate", "95 % bound", "true error")
    head = "".join(f'<th scope="col">{name}</th>' for name in heads)
    note = ""
    if any(row.good is not None for row in rows):
        note = '<p class="soft">Green: right, or within its bound. Red: not.</p>'
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{note}"


def _plots(summary: RunSummary) -> str:
    plots = []
    states = states_svg(summary)
    if states is not None:
        plots.append((states, "State over time, and the size of its uncertainty."))
    if summary.posterior is not None:
        kinds = kinds_svg(summary.posterior, CONFIDENCE)
        plots.append((kinds, "Probability of each joint kind."))
    figures = "".join(
        f'<figure role="img" aria-label="{words}"><div class="plot">{svg}</div>'
        f"<figcaption>{words}</figcaption></figure>"
        for svg, words in plots
    )
    return f'<div class="plots">{figures}</div>' if figures else ""


def _rounds(summary: RunSummary) -> str:
    """The closed loop, round by round."""
    goal = summary.goal
    if goal is None or not summary.rounds:
        return ""
    names = ("when", "sent to", "believed state", "95 % bound", "probability within tolerance")
    head = "".join(f'<th scope="col">{name}</th>' for name in names)
    body, moves = [], 0
    for r in summary.rounds:
        moves += r.commanded is not None
        texts = (
            NONE if r.commanded is None else state(r.commanded, goal.unit),
            state(r.state_mean, goal.unit),
            size(normal_bound() * r.state_sd, goal.unit),
            per_cent(r.p_within_tolerance),
        )
        cells = "".join(_cell(n, t) for n, t in zip(names[1:], texts, strict=True))
        when = "first look" if r.commanded is None else f"move {moves}"
        body.append(f'<tr><th scope="row">{when}</th>{cells}</tr>')
    target = f"{chosen(goal.target, goal.unit)} ± {chosen(goal.tolerance, goal.unit)}"
    return (
        f"<h2>Closed loop: target {target}</h2>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    )


def _definitions(rows: list[tuple[str, str]]) -> str:
    pairs = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in rows)
    return f"<dl>{pairs}</dl>"


def _facts(summary: RunSummary) -> str:
    rows = [("version", summary.version), ("seed", str(summary.seed))]
    rows.append(("recording", f"{summary.recording.name}, {_clip(summary)}"))
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
    return "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in rows)


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


def _clip(summary: RunSummary) -> str:
    stamps = np.array([frame.stamp_s for frame in summary.recording.frames])
    camera = summary.recording.frames[0].camera
    return f"{len(stamps)} frames of {camera.width}×{camera.height}, {np.ptp(stamps):.1f} s"
