"""Posteriors as JSON. Format: docs/conventions.md."""

from __future__ import annotations

import json

from akm_fg.posterior import ArticulationPosterior
from akm_fg.posterior_views import SCHEMA, posterior_as_dict

__all__ = ["SCHEMA", "posterior_as_dict", "posterior_as_line"]


def posterior_as_line(posterior: ArticulationPosterior) -> str:
    """One line of strict JSON (no NaN), without the newline."""
    return json.dumps(posterior_as_dict(posterior), allow_nan=False)
