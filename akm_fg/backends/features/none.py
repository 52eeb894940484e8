"""No features: exploration goes by geometry alone. Needs no torch."""

from __future__ import annotations

from akm_fg.backends.registry import BackendSettings


def make(settings: BackendSettings) -> None:
    """Nothing; the caller says that it goes without."""
    return None
