"""Gaps between fronts in a plane: straight lines all the way across that are darker or lighter.

A gap shows as a thin line in colour, wherever depth is too coarse for it. The grain of wood makes
lines too, but none that keeps its sign and outdoes its neighbours all along a front. A rectangle
is cut at its clearest gap, the pieces again, and so on: fronts stand in rows and columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from akm_fg.perception.fronts.front_picture import FrontPicture
from akm_fg.records import BoolArray, FloatArray

INTERRUPTED = 100.0  # score of a line where depth shows no plane: clearer than any colour


@dataclass(frozen=True, slots=True)
class GapConfig:
    """What counts as a gap, and as a front."""

    cell_m: float = 0.0025  # of the pictures: a pixel at 1 m
    beside_m: float = 0.010  # a line is compared with what is this far to either side
    bands: int = 10  # along the line
    band_seen: float = 0.4  # of a band, at least; handles and what they hide interrupt a line
    # Times what nine tenths of the lines stay below, in the median of the bands: gaps of
    # `furniture-dev` reach 2.2 to 100, grain and grit 1.6, rarely 2.
    clear: float = 2.1
    noise: float = 0.4  # grey levels: no line of a plain face is measured by less
    least_m: float = 0.07  # narrower than this it is no front, but a strip of the carcass
    hidden: float = 0.25  # of a line's cells show the plane, at most, where it is interrupted
    hidden_share: float = 0.9  # of the bands: an upright handle hides a part of them
    ends_m: float = 0.02  # beside the plane's own end there is always a line


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Of a plane, in its frame; the sides are gaps, or the plane's ends."""

    lower_m: FloatArray  # (2,)
    upper_m: FloatArray  # (2,)


def rectangles(picture: FrontPicture, config: GapConfig) -> tuple[Rectangle, ...]:
    """The fronts of a plane; none where it is no wider than a strip."""
    h, w = picture.own.shape
    return tuple(
        Rectangle(
            picture.lower_m + picture.cell_m * np.array([columns[0], rows[0]]),
            picture.lower_m + picture.cell_m * np.array([columns[1], rows[1]]),
        )
        for rows, columns in _cut(picture, (0, h), (0, w), config)
    )


_Span = tuple[int, int]


def _cut(
    picture: FrontPicture, rows: _Span, columns: _Span, config: GapConfig
) -> list[tuple[_Span, _Span]]:
    """Rows and columns of the pieces of a rectangle; strips of the carcass are left out."""
    rows, columns = _trimmed(picture.own[slice(*rows), slice(*columns)], rows, columns, config)
    if min(rows[1] - rows[0], columns[1] - columns[0]) < config.least_m / config.cell_m:
        return []
    grey = picture.grey[slice(*rows), slice(*columns)]
    own = picture.own[slice(*rows), slice(*columns)]
    elsewhere = ~own & ~picture.unknown[slice(*rows), slice(*columns)]
    across = _clearest(grey, own, elsewhere, config)
    along = _clearest(grey.T, own.T, elsewhere.T, config)
    if across is None and along is None:
        return [(rows, columns)]
    if along is None or (across is not None and across[1] >= along[1]):
        assert across is not None
        at = columns[0] + across[0]
        halves = [(rows, (columns[0], at)), (rows, (at, columns[1]))]
    else:
        at = rows[0] + along[0]
        halves = [((rows[0], at), columns), ((at, rows[1]), columns)]
    return [piece for half in halves for piece in _cut(picture, *half, config)]


def _trimmed(own: BoolArray, rows: _Span, columns: _Span, config: GapConfig) -> tuple[_Span, _Span]:
    """Rows and columns without those at the ends that hardly show the plane."""
    spans = []
    for span, seen in ((rows, own.mean(axis=1)), (columns, own.mean(axis=0))):
        good = np.flatnonzero(seen > config.hidden)
        low, high = (good[0], good[-1] + 1) if good.size else (0, 0)
        spans.append((span[0] + int(low), span[0] + int(high)))
    return spans[0], spans[1]


def _clearest(
    grey: FloatArray, own: BoolArray, elsewhere: BoolArray, config: GapConfig
) -> tuple[int, float] | None:
    """Column of the clearest line across all rows of a picture, and how clear it is; or None."""
    beside = max(2, round(config.beside_m / config.cell_m))
    ends = round(config.ends_m / config.cell_m)
    w = grey.shape[1]
    if w <= 2 * ends + 2 or min(grey.shape) < config.bands:
        return None
    score = _clearness(*_against_both_sides(grey, own, beside), config)
    score = np.where(score > config.clear, score, 0.0)
    score += INTERRUPTED * _interrupted(own, elsewhere, config)
    score[:ends], score[w - ends :] = 0.0, 0.0
    best = int(score.argmax())
    return (best, float(score[best])) if score[best] > 0.0 else None


def _clearness(stands_out: FloatArray, seen: BoolArray, config: GapConfig) -> FloatArray:
    """(w,) how far columns stand out from the others, all along and with one sign.

    In each band a column is measured by what nine tenths of the columns stay below; the median of
    the bands counts. A line that is not quite upright may be in the next column.
    """
    h, w = stands_out.shape
    values = np.full((config.bands, w), np.nan)
    for i, band in enumerate(np.array_split(np.arange(h), config.bands)):
        weight = seen[band].sum(axis=0)
        enough = weight >= config.band_seen * len(band)
        mean = (stands_out[band] * seen[band]).sum(axis=0)[enough] / weight[enough]
        if enough.any():
            usual = max(float(np.quantile(np.abs(mean), 0.9)), config.noise)
            values[i, enough] = mean / usual
    known = np.isfinite(values).sum(axis=0)
    light = maximum_filter1d(np.nan_to_num(values, nan=-np.inf), 3, axis=1)
    dark = maximum_filter1d(np.nan_to_num(-values, nan=-np.inf), 3, axis=1)
    clear = np.maximum(np.median(light, axis=0), np.median(dark, axis=0))
    return np.where(known >= config.bands / 2, np.maximum(clear, 0.0), 0.0)


def _interrupted(own: BoolArray, elsewhere: BoolArray, config: GapConfig) -> BoolArray:
    """(w,) columns in which depth shows anything but the plane, in nearly all of the bands."""
    gone, known = np.zeros(own.shape[1]), np.zeros(own.shape[1])
    for band in np.array_split(np.arange(len(own)), config.bands):
        here, away = own[band].sum(axis=0), elsewhere[band].sum(axis=0)
        seen = here + away > len(band) / 2.0
        known += seen
        gone += seen & (here < config.hidden * (here + away))
    return np.asarray((gone >= config.hidden_share * known) & (known >= config.bands / 2))


def _against_both_sides(
    grey: FloatArray, own: BoolArray, beside: int
) -> tuple[FloatArray, BoolArray]:
    """How much each cell is darker or lighter than what is beside it, the less of both sides.

    Returns:
        (h, w) grey levels, 0 where it lies between; (h, w) where both sides show the plane.
    """
    h, w = grey.shape
    result, seen = np.zeros((h, w)), np.zeros((h, w), dtype=bool)
    here = slice(beside, w - beside)
    left, right = grey[:, here] - grey[:, : w - 2 * beside], grey[:, here] - grey[:, 2 * beside :]
    same = np.sign(left) == np.sign(right)
    result[:, here] = np.where(same, np.sign(left) * np.minimum(np.abs(left), np.abs(right)), 0.0)
    seen[:, here] = own[:, : w - 2 * beside] & own[:, 2 * beside :]
    return result, seen
