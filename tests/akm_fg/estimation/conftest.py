"""Openings with known joints, as fixtures."""

import pytest

from experiments.openings import make_opening, score_opening


@pytest.fixture(scope="session")
def opening():
    """Factory: opening(seed, kind, travel, ...)."""
    return make_opening


@pytest.fixture(scope="session")
def score():
    """score(posterior, opening)."""
    return score_opening


@pytest.fixture(params=["revolute", "prismatic"])
def kind(request):
    return request.param
