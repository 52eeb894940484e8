"""Settings of explorations of several parts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PartsConfig:
    """What happens with a part that was opened, before the next one is looked for."""

    beyond_m: float = 0.005  # past the closed state that the hand pushes: joints err
    closed_m: float = 0.01  # of the way of its points, within which a part counts as closed
    most_closings: int = 2  # tries to close one part
    # Of a contact from a part's surface: on it; and of its own front's, whose handle may be bare.
    on_part_m: float = 0.015
    own_front_m: float = 0.06
    # Of the points of a part that was opened, that lie so near a known part: it is that one again.
    same_share: float = 0.5
    same_m: float = 0.01
