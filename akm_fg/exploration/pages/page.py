"""The part of a report that tells of an exploration: belief, attempts, stretches."""

from __future__ import annotations

import cv2
import numpy as np
from markupsafe import Markup

from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.pages.belief_picture import belief_colours, belief_picture
from akm_fg.exploration.pages.stretch_plot import stretches_svg
from akm_fg.exploration.records import Attempt, Exploration, FoundPart
from akm_fg.report.page import template
from akm_fg.report.pictures import Picture
from akm_fg.report.wording import size, state

_COLUMNS = ("where", "pull", "thought to open", "outcome", "why", "way")
_PART_COLUMNS = ("opened in try", "recording", "joint", "where it is now")
_JPEG_QUALITY = 85
_PLOT_WORDS = (
    "What is known of the joint after each stretch of pull, what was expected of it a stretch "
    "before, and what the task needs."
)


def exploration_part(exploration: Exploration, config: ExploreConfig) -> Markup:
    """HTML that goes before the pictures of a report's page."""
    plot = None
    if exploration.attempts:
        plot = stretches_svg(exploration.attempts[-1].stretches, config.stopping.need)
    html = template("exploration.html").render(
        maps=_maps(exploration),
        scale=_scale(),
        columns=_COLUMNS,
        attempts=[(str(i + 1), _row(a)) for i, a in enumerate(exploration.attempts)],
        part_columns=_PART_COLUMNS,
        parts=[_part_row(part, exploration) for part in exploration.found],
        notes=exploration.notes,
        plot=None if plot is None else Markup(plot),
        plot_words=_PLOT_WORDS,
    )
    return Markup(html)


def _part_row(found: FoundPart, exploration: Exploration) -> tuple[str, tuple[str, ...]]:
    """Name and words of a part, where several were looked for."""
    attempt = exploration.attempts[found.attempt]
    known = () if exploration.model is None else exploration.model.parts
    part = next((each for each in known if each.name == found.name), None)
    joint, now = attempt.stretches[-1].kind, "not known"
    if part is not None:
        sd = f"axis to {size(part.joint.axis_sd_rad, 'rad')}"
        if part.joint.pivot_sd_m is not None:
            sd += f", pivot to {size(part.joint.pivot_sd_m, 'm')}"
        joint = f"{part.posterior.kind}, {sd} (one deviation)"
        if found.state is not None:
            now = state(found.state, part.joint.kind.unit)
    row = (str(found.attempt + 1), attempt.recording or "-", joint, now)
    return found.name or "no model", row


def _maps(exploration: Exploration) -> list[Picture]:
    """The belief before the first and before the last attempt."""
    if exploration.first_look is None or not exploration.beliefs:
        return []
    numbers = dict.fromkeys((0, len(exploration.beliefs) - 1))
    return [_map(exploration, number) for number in numbers]


def _map(exploration: Exploration, number: int) -> Picture:
    image = belief_picture(exploration, number)
    flag = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), flag)
    anything = exploration.beliefs[number].anything
    when = f"Before try {number + 1}" if number < len(exploration.attempts) else "At the end"
    words = f"{when}: probability {anything:.2f} that anything here opens by a pull not tried yet"
    height, width = image.shape[:2]
    return Picture(jpeg.tobytes(), words, width, height)


def _scale() -> list[tuple[str, tuple[int, ...]]]:
    levels = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    colours = belief_colours(levels)
    words = ["a pull here opens with probability 0", "0.25", "0.5", "0.75", "1"]
    return [(word, tuple(colour.tolist())) for word, colour in zip(words, colours, strict=True)]


def _row(attempt: Attempt) -> tuple[str, ...]:
    contact = attempt.contact
    travel = f"{100 * attempt.stretches[-1].travel_m:.1f} cm" if attempt.stretches else "-"
    return (
        f"{contact.what}, front {contact.front + 1}",
        ", ".join([*attempt.rigid_before, attempt.hypothesis.way]),
        f"{attempt.probability:.2f}",
        attempt.outcome.replace("_", " "),
        attempt.reason,
        travel,
    )
