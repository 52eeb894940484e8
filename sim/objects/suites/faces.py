"""The face of a piece of furniture: its fronts, of which one is free and all look as if they were.

A face is a grid of rows and columns of which every front covers a rectangle, the free one first.
Cabinets get up to eight fronts around the free one, stacked and side by side as kitchens have them,
low ones as drawers have and tall ones as doors. Sizes in metres are those before the scale.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SAME_M = 0.004  # edges of fronts that are nearer than this are one


@dataclass(frozen=True, slots=True)
class Cells:
    """What a front covers of its face's grid: from the first row and column to past the last."""

    top: int
    bottom: int
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class Face:
    """Fronts that fill a grid."""

    rows: tuple[float, ...]  # shares of the height, from the top
    columns: tuple[float, ...]  # shares of the width, from the left
    fronts: tuple[Cells, ...]  # the free one first, where it is one of them

    def share(self, front: int) -> tuple[float, float]:
        """Of the whole face's width and height, what a front covers."""
        at = self.fronts[front]
        return sum(self.columns[at.left : at.right]), sum(self.rows[at.top : at.bottom])

    def from_above(self) -> tuple[int, ...]:
        """The fronts but the first, by rows from above, in a row from the left."""
        rest = range(1, len(self.fronts))
        return tuple(sorted(rest, key=lambda i: (self.fronts[i].top, self.fronts[i].left)))

    def mask(self) -> NDArray[np.int64]:
        """(rows, columns): which front covers a cell."""
        mask = np.full((len(self.rows), len(self.columns)), -1)
        for i, at in enumerate(self.fronts):
            mask[at.top : at.bottom, at.left : at.right] = i
        return mask


@dataclass(frozen=True, slots=True)
class FaceConfig:
    """How large faces and their fronts are, so that the arm can reach all of them, metres."""

    width_m: float = 1.10  # at most
    height_m: tuple[float, float] = (0.45, 0.95)
    column_m: tuple[float, float] = (0.26, 0.46)  # beside the free front's
    low_m: tuple[float, float] = (0.12, 0.28)  # height of a front as drawers have
    tall_m: tuple[float, float] = (0.28, 0.70)  # and as doors have
    tall_share: float = 0.4  # of the stretches that could be one door, those that are
    least_m: float = 0.05  # between two edges of fronts beside each other, where they differ
    tries: int = 400


@dataclass(frozen=True, slots=True)
class _Rect:
    left: float
    right: float
    top: float
    bottom: float


def sample_face(
    part_m: tuple[float, float], n: int, rng: np.random.Generator, config: FaceConfig | None = None
) -> tuple[tuple[float, float], Face]:
    """Width and height of a face, and `n` fronts on it; fewer where so many do not fit.

    Args:
        part_m: width and height of the free front.
        n: how many fronts there are to be, with the free one.
        rng: source of randomness.
        config: sizes.
    """
    config = config or FaceConfig()
    for fewer in range(n, 1, -1):
        for _ in range(config.tries):
            rects = _draw_rects(part_m, rng, config)
            if rects is not None and len(rects) == fewer:
                face = face_of(rects)
                size = max(r.right for r in rects), max(r.bottom for r in rects)
                if _sound(face, size, config):
                    return size, face
    return part_m, Face((1.0,), (1.0,), (Cells(0, 1, 0, 1),))


def sample_stack(width_m: float, height_m: float, n: int, rng: np.random.Generator) -> Face:
    """One column of at most `n` fronts that fills a width and a height."""
    config = FaceConfig()
    for fewer in range(n, 1, -1):
        for _ in range(config.tries):
            cuts = _stack(height_m, rng, config)
            if cuts is not None and len(cuts) == fewer:
                return face_of([_Rect(0.0, width_m, *cut) for cut in cuts])
    return Face((1.0,), (1.0,), (Cells(0, 1, 0, 1),))


def face_of_heights(width_m: float, heights_m: list[float], order: list[int]) -> Face:
    """One column of fronts, from the top in an order; the first height is the free one's."""
    cuts = dict(zip(order, _placed([heights_m[i] for i in order]), strict=True))
    return face_of([_Rect(0.0, width_m, *cuts[i]) for i in range(len(heights_m))])


def face_of(rects: list[_Rect]) -> Face:
    """The grid of some fronts that fill a rectangle, metres from its upper left corner."""
    x = _edges([r.left for r in rects] + [r.right for r in rects])
    z = _edges([r.top for r in rects] + [r.bottom for r in rects])

    def at(edges: list[float], value: float) -> int:
        return int(np.abs(np.array(edges) - value).argmin())

    cells = tuple(
        Cells(at(z, r.top), at(z, r.bottom), at(x, r.left), at(x, r.right)) for r in rects
    )
    rows, columns = np.diff(z) / (z[-1] - z[0]), np.diff(x) / (x[-1] - x[0])
    return Face(tuple(rows.tolist()), tuple(columns.tolist()), cells)


def _edges(values: list[float]) -> list[float]:
    edges: list[float] = []
    for value in sorted(values):
        if not edges or value - edges[-1] > SAME_M:
            edges.append(value)
    return edges


def _sound(face: Face, size_m: tuple[float, float], config: FaceConfig) -> bool:
    """Whether the library's walls fit between all edges."""
    least = min(min(face.columns) * size_m[0], min(face.rows) * size_m[1])
    return least >= config.least_m


def _draw_rects(
    part_m: tuple[float, float], rng: np.random.Generator, config: FaceConfig
) -> list[_Rect] | None:
    """The free front among columns of others; None where it did not come out."""
    width, height = part_m
    widths = [width]
    for _ in range(int(rng.integers(0, 3))):
        widths.append(float(rng.uniform(*config.column_m)))
    if sum(widths) > config.width_m:
        return None
    low, high = config.height_m
    whole = (
        height if rng.random() < 0.3 else float(rng.uniform(max(low, height), max(high, height)))
    )
    order = rng.permutation(len(widths)).tolist()
    rects: list[_Rect] = []
    left = 0.0
    for column in order:
        right = left + widths[column]
        fixed = height if column == 0 else None
        cuts = _stack(whole, rng, config, fixed)
        if cuts is None:
            return None
        free = [_Rect(left, right, *cuts[0])] if column == 0 else []
        others = [_Rect(left, right, *cut) for cut in (cuts[1:] if column == 0 else cuts)]
        rects = [*free, *rects, *others]
        left = right
    return rects


def _stack(
    height_m: float, rng: np.random.Generator, config: FaceConfig, fixed_m: float | None = None
) -> list[tuple[float, float]] | None:
    """Fronts one below the other, top and bottom of each; the one of a fixed height comes first."""
    if fixed_m is None:
        pieces = _pieces(height_m, rng, config)
        return None if pieces is None else _placed(pieces)
    rest = height_m - fixed_m
    if rest < SAME_M:
        return [(0.0, height_m)]
    above_m = float(rng.choice([0.0, 0.5, 1.0])) * rest
    above, below = _pieces(above_m, rng, config), _pieces(rest - above_m, rng, config)
    if above is None or below is None:
        return None
    cuts = _placed([*above, fixed_m, *below])
    return [cuts[len(above)], *cuts[: len(above)], *cuts[len(above) + 1 :]]


def _pieces(height_m: float, rng: np.random.Generator, config: FaceConfig) -> list[float] | None:
    """Heights of fronts that fill a height; None where it is too little for one."""
    pieces: list[float] = []
    left = height_m
    while left > SAME_M:
        low, high = config.tall_m if rng.random() < config.tall_share else config.low_m
        piece = float(rng.uniform(low, high))
        if left - piece < config.low_m[0]:  # the last one takes the rest
            piece = left
        if not config.low_m[0] <= piece <= config.tall_m[1]:
            return None
        pieces.append(piece)
        left -= piece
    return pieces


def _placed(pieces: list[float]) -> list[tuple[float, float]]:
    edges = np.concatenate([[0.0], np.cumsum(pieces)])
    return [(float(a), float(b)) for a, b in itertools.pairwise(edges)]
