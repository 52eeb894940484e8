import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.claims import cramer_rao
from experiments.rows.rows import read_rows
from experiments.scores.scoring import Errors
from experiments.trials.bound_of_rows import bound_of

CELL = "door 40 deg, 3 mm, 40 points, 20 frames, clean"


@pytest.fixture
def rows_at_the_bound(a_row):
    """factor -> rows whose errors are drawn from the bound, times a factor."""

    def make(factor, runs=1000):
        rng = np.random.default_rng(0)
        rows = []
        for seed in np.arange(runs) % 20:
            bound = bound_of(CELL, seed)
            xi = factor * rng.multivariate_normal(np.zeros(4), bound.cov_line)
            state = factor * np.sqrt(bound.var_states[-1]) * rng.normal()
            axis_deg, pivot_m = np.degrees(np.hypot(*xi[:2])), float(np.hypot(*xi[2:]))
            errors = Errors(float(axis_deg), pivot_m, None, float(state), None)
            rows.append(a_row(cell=CELL, seed=seed, errors=errors))
        return rows

    return make


@pytest.mark.parametrize("quantity", cramer_rao.QUANTITIES, ids=lambda q: q.name)
def test_errors_drawn_from_the_bound_have_the_ratio_one(rows_at_the_bound, quantity):
    found = cramer_rao.ratios(rows_at_the_bound(1.0), quantity)
    assert found.trials == 1000
    assert_allclose(found.rmse.value, 1, atol=0.08)
    assert_allclose(found.median.value, 1, atol=0.12)


@pytest.mark.parametrize("quantity", cramer_rao.QUANTITIES, ids=lambda q: q.name)
def test_errors_twice_as_large_have_twice_the_ratio(rows_at_the_bound, quantity):
    once = cramer_rao.ratios(rows_at_the_bound(1.0, 10), quantity)
    twice = cramer_rao.ratios(rows_at_the_bound(2.0, 10), quantity)
    assert_allclose(twice.rmse.value, 2 * once.rmse.value)
    assert_allclose(twice.median.value, 2 * once.median.value)


def test_a_trial_without_an_error_is_left_out(a_row):
    rows = [a_row(cell=CELL, errors=Errors())]
    assert cramer_rao.ratios(rows, cramer_rao.QUANTITIES[0]) is None


def test_table_and_figure_are_made_of_rows(accuracy_rows, tmp_path):
    rows = read_rows(accuracy_rows)
    text = cramer_rao.ratio_table(rows)
    assert len(text.splitlines()) == 14 and "drawer 5 cm, drifting" in text
    cramer_rao.ratio_figure(rows, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000
