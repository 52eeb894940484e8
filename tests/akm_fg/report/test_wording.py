import numpy as np
import pytest

from akm_fg.report import wording as w


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0123, "m", "1.2 cm"),
        (0.00042, "m", "0.042 cm"),
        (np.radians(12.34), "rad", "12.3°"),
        (np.radians(-123.4), "rad", "123°"),
        (0.0, "m", "0 cm"),
        (1e-9, "m", "<0.001 cm"),
        (float("nan"), "m", "–"),
        (None, "rad", "–"),
        (0.0996, "m", "10.0 cm"),
    ],
)
def test_a_size_has_two_digits_that_count(value, unit, text):
    assert w.size(value, unit) == text


def test_errors_carry_their_sign():
    assert w.signed(0.01, "m") == "+1.0 cm"
    assert w.signed(-0.01, "m") == "−1.0 cm"
    assert w.signed(None, "m") == "–"


@pytest.mark.parametrize(
    ("p", "text"),
    [(0.0, "< 10⁻³⁰⁰"), (3.14e-12, "3.1·10⁻¹²"), (0.5, "50.0 %"), (1 - 2e-9, "1 − 2.0·10⁻⁹"),
     (1.0, "> 1 − 10⁻¹⁵"), (9.99e-5, "1.0·10⁻⁴"), (5e-320, "1.0·10⁻³²⁰")],
)  # fmt: skip
def test_tiny_probabilities_stay_readable(p, text):
    assert w.probability(p) == text


def test_a_probability_is_never_rounded_to_certainty():
    assert w.per_cent(0.99999) == "> 99.9 %"
    assert w.per_cent(1e-9) == "< 0.1 %"


def test_log10_odds_of_a_thousand_to_one_are_three():
    assert w.log10_odds(1000 / 1001, 1 / 1001) == "+3.0"
    assert w.log10_odds(0.0, 1.0) == "< −300"
    assert w.log10_odds(1.0, 0.0) == "> +15"


def test_what_a_person_chose_is_shown_as_short_as_it_was_given():
    assert w.chosen(0.30, "m") == "30 cm"
    assert w.chosen(np.radians(30), "rad") == "30°"


def test_vectors_do_not_show_negative_zero():
    assert w.vector(np.array([-0.0, 0.5, -1.0]), digits=1) == "(0.0, 0.5, −1.0)"
