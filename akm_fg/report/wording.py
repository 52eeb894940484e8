"""Numbers as people read them: degrees, centimetres, per cent, two significant digits."""

from __future__ import annotations

import math
import re
import unicodedata
from typing import Literal

import numpy as np

from akm_fg.records import FloatArray

NONE = "–"
Unit = Literal["m", "rad"]
_ASCII = str.maketrans(
    {"±": "+-", "°": " deg", "−": "-", "–": "-", "×": "x", "·": " ", "…": "...", "≥": ">="}
    | {"\N{NO-BREAK SPACE}": " "}
    | dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True))
)


def ascii_text(text: str) -> str:
    """The text in characters that every terminal has, as far as this module's words go."""
    return re.sub("·10(?=[⁻⁰¹²³⁴⁵⁶⁷⁸⁹])", "e", text).translate(_ASCII)


_UNPRINTABLE = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Control characters, those that turn the direction of text, and ends of lines."""


def printable(text: str) -> str:
    """The text with control characters escaped, so that it stays one line and only text."""
    return "".join(
        c.encode("unicode_escape").decode() if unicodedata.category(c) in _UNPRINTABLE else c
        for c in text
    )


def unit_name(unit: Unit) -> str:
    """The unit in which a person reads states."""
    return "°" if unit == "rad" else "cm"


def to_person(value: FloatArray | float, unit: Unit) -> FloatArray:
    """Radians to degrees, metres to centimetres."""
    return np.asarray(value) * (180 / np.pi if unit == "rad" else 100.0)


def _spaced(number: str, unit: Unit) -> str:
    return number + ("°" if unit == "rad" else " cm")


def size(value: float | None, unit: Unit) -> str:
    """A bound or an error, without sign, to two significant digits ("0.31°", "1.2 cm")."""
    if value is None or not math.isfinite(value):
        return NONE
    shown = abs(float(to_person(value, unit)))
    if shown == 0 or shown >= 9.95:
        return _spaced(f"{shown:.{0 if shown >= 99.5 or shown == 0 else 1}f}", unit)
    if shown < 1e-3:
        return "<" + _spaced("0.001", unit)
    return _spaced(f"{shown:.{max(1 - math.floor(math.log10(shown)), 1)}f}", unit)


def signed(value: float | None, unit: Unit) -> str:
    """An error with its sign ("+0.31°")."""
    text = size(value, unit)
    if value is None or text == NONE or text.startswith("<") or value == 0:
        return text
    return ("+" if value > 0 else "−") + text


def state(value: float | None, unit: Unit) -> str:
    """A joint state, to hundredths of a degree or of a centimetre."""
    if value is None or not math.isfinite(value):
        return NONE
    shown = round(float(to_person(value, unit)), 2) + 0.0  # no negative zero
    return _spaced(f"{shown:.2f}".replace("-", "−"), unit)


def chosen(value: float, unit: Unit) -> str:
    """A number that a person gave, as short as it was given ("30 cm", "3°")."""
    return _spaced(f"{round(float(to_person(value, unit)), 2):g}".replace("-", "−"), unit)


def probability(p: float) -> str:
    """Also near zero and one: "3·10⁻⁷", "99.1 %", "1 − 2·10⁻⁹"."""
    if not math.isfinite(p):
        return NONE
    if p == 0:
        return "< 10⁻³⁰⁰"
    if p == 1:
        return "> 1 − 10⁻¹⁵"
    if p < 1e-3:
        return _power(p)
    if p > 1 - 1e-3:
        return f"1 − {_power(1 - p)}"
    return f"{100 * p:.1f} %"


def per_cent(p: float) -> str:
    """A probability in a sentence: never rounded to certainty."""
    if not math.isfinite(p):
        return NONE
    if p > 0.9995:
        return "> 99.9 %"
    return "< 0.1 %" if p < 0.0005 else f"{100 * p:.1f} %"


def log10_odds(p: float, others: float) -> str:
    """Decimal logarithm of p against the sum of the other probabilities."""
    if p <= 0:
        return "< −300"
    if others <= 0:
        return "> +15"  # double precision holds no smaller rest
    return f"{math.log10(p / others):+.1f}".replace("-", "−")


def _power(p: float) -> str:
    exponent = math.floor(math.log10(p))
    lead = p / 10.0**exponent if exponent > -300 else 1.0
    if lead >= 9.95:
        lead, exponent = 1.0, exponent + 1
    superscript = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{lead:.1f}·10{superscript}"


def vector(v: FloatArray, digits: int = 3, scale: float = 1.0) -> str:
    """A point or direction ("(0.012, −0.003, 1.000)")."""
    numbers = (f"{x:.{digits}f}" for x in np.round(np.asarray(v) * scale, digits) + 0.0)
    return "(" + ", ".join(n.replace("-", "−") for n in numbers) + ")"


def duration(seconds: float) -> str:
    """A time: milliseconds below a tenth of a second."""
    if not math.isfinite(seconds):
        return NONE
    return f"{1000 * seconds:.0f} ms" if seconds < 0.1 else f"{seconds:.1f} s"
