"""Plots as inline SVG without references: states over time, and the joint kind."""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from akm_fg.posterior import ArticulationPosterior, StatePosterior, normal_bound
from akm_fg.records import FloatArray
from akm_fg.report.score import aligned_truth
from akm_fg.report.summary import RunSummary
from akm_fg.report.wording import log10_odds, probability, to_person, unit_name

ESTIMATE = "#c2006f"
_TRUTH = "#111111"
_TARGET = "#1a7f37"
_PHASES = {"pull": "#fff3e0", "closed loop": "#e3f2fd"}
STYLE: dict[Any, Any] = {"font.size": 10, "svg.fonttype": "path", "axes.spines.top": False,
          "axes.spines.right": False, "figure.constrained_layout.use": True}  # fmt: skip


def states_svg(summary: RunSummary) -> str | None:
    """States over time with the 95 % band, truth and target; below, the error inside its bound.

    Returns:
        An <svg> element, or None where the run has no states.
    """
    states = summary.frame_states
    if states is None or not np.isfinite(states.mean).any():
        return None
    numbers = np.arange(summary.frame_count, dtype=np.float64)
    time_s = numbers if summary.times_s is None else summary.times_s
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 4.6))
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(5, 3))
        true = _true_states(summary, states)
        _shade_phases(top, bottom, summary, time_s)
        time_s = time_s[: len(states.mean)]
        _draw_states(top, time_s, states, true)
        _draw_goal(top, summary, states)
        _draw_errors(bottom, time_s, states, true)
        bottom.set_xlabel("frame" if summary.times_s is None else "time [s]")
        _finish(top, states)
        return as_svg(figure, "states")


def _true_states(summary: RunSummary, states: StatePosterior) -> FloatArray | None:
    """Aligned to the estimate; None without truth or for joints of another kind."""
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if summary.truth is None or joint is None or joint.kind != summary.truth.kind:
        return None
    return aligned_truth(states, joint.axis, summary.truth)


def _shade_phases(top: Axes, bottom: Axes, summary: RunSummary, time_s: FloatArray) -> None:
    end = float(time_s[-1])
    turn = summary.closed_loop_frame
    if turn is None:
        return
    spans = {"pull": (0.0, float(time_s[turn])), "closed loop": (float(time_s[turn]), end)}
    for name, (start, stop) in spans.items():
        if stop <= start:
            continue
        for axes in (top, bottom):
            axes.axvspan(start, stop, color=_PHASES[name], lw=0, zorder=0)
        top.text(
            (start + stop) / 2, 1.01, name, transform=top.get_xaxis_transform(),
            ha="center", va="bottom", color="#555555", fontsize=9,
        )  # fmt: skip


def _draw_states(
    axes: Axes, time_s: FloatArray, states: StatePosterior, true: FloatArray | None
) -> None:
    mean = to_person(states.mean, states.unit)
    half = normal_bound() * to_person(states.sd, states.unit)
    axes.fill_between(
        time_s, mean - half, mean + half, color=ESTIMATE, alpha=0.25, lw=0,
        label="95 % band",
    )  # fmt: skip
    axes.plot(time_s, mean, ".-", color=ESTIMATE, lw=1.2, ms=3, label="estimate")
    if true is not None:
        axes.plot(time_s, to_person(true, states.unit), "--", color=_TRUTH, lw=1.2, label="truth")


def _draw_goal(axes: Axes, summary: RunSummary, states: StatePosterior) -> None:
    if summary.goal is None or summary.goal.unit != states.unit:  # the wrong kind has another unit
        return
    target = float(to_person(summary.goal.target, summary.goal.unit))
    tolerance = float(to_person(summary.goal.tolerance, summary.goal.unit))
    axes.axhspan(target - tolerance, target + tolerance, color=_TARGET, alpha=0.15, lw=0)
    axes.axhline(target, color=_TARGET, lw=1, label="target ± tolerance")


def _draw_errors(
    axes: Axes, time_s: FloatArray, states: StatePosterior, true: FloatArray | None
) -> None:
    """The band alone, on its own scale: on the scale of the motion it is thinner than a line."""
    half = normal_bound() * to_person(states.sd, states.unit)
    half = np.where(np.isfinite(states.mean), half, np.nan)
    axes.fill_between(time_s, -half, half, color=ESTIMATE, alpha=0.25, lw=0)
    axes.plot(time_s, half, ".", time_s, -half, ".", color=ESTIMATE, ms=2, alpha=0.6)
    axes.axhline(0, color=ESTIMATE, lw=0.8)
    label = "95 % band"
    if true is not None:
        error = to_person(states.mean - true, states.unit)
        axes.plot(time_s, error, ".--", color=_TRUTH, lw=0.8, ms=3)
        label = "estimate − truth"
    axes.set_ylabel(f"{label} [{unit_name(states.unit)}]")


def _finish(axes: Axes, states: StatePosterior) -> None:
    name = "opening angle" if states.unit == "rad" else "opening"
    axes.set_ylabel(f"{name} [{unit_name(states.unit)}]")
    axes.legend(loc="best", fontsize=9, framealpha=0.85, edgecolor="none")


def kinds_svg(posterior: ArticulationPosterior, decided_from: float) -> str:
    """One bar a kind, with its probability and log10 odds in numbers.

    Args:
        posterior: kinds that it has a probability for but no fit are said to be not fitted.
        decided_from: probability from which a kind is named, marked by a line.
    """
    probabilities = posterior.kind_probability
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 0.8 + 0.6 * len(probabilities)))
        axes = figure.subplots()
        for i, (kind, p) in enumerate(probabilities.items()):
            others = sum(q for k, q in probabilities.items() if k != kind)
            axes.barh(i, p, color=ESTIMATE if p >= decided_from else "#9a9a9a", height=0.55)
            text = f"{probability(p)}\nlog₁₀ odds {log10_odds(p, others)}"
            if kind not in posterior.alternatives:
                text = "not fitted"
            axes.text(1.06, i, text, va="center", linespacing=1.3)
        axes.axvline(decided_from, color="#555555", lw=0.8, ls=":")
        axes.set_yticks(range(len(probabilities)), list(probabilities))
        axes.set_xlim(0, 1.04)
        axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
        axes.set_xlabel("probability")
        axes.set_ylim(len(probabilities) - 0.5, -0.5)
        return as_svg(figure, "kinds")


def as_svg(figure: Figure, name: str) -> str:
    """The figure as an element of the page: no prolog, no metadata, no references."""
    buffer = io.BytesIO()
    metadata: dict[str, Any] = {"Date": None}
    salt: dict[Any, Any] = {"svg.hashsalt": name}  # same run, same page
    with matplotlib.rc_context(salt):
        figure.savefig(buffer, format="svg", metadata=metadata)
    svg = buffer.getvalue().decode()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    # Two plots share a page: names inside them must differ.
    svg = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{name}-", svg)
    return svg
