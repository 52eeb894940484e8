"""Dense optical flow, re-anchored on the points' first patches: no weights."""

from __future__ import annotations

from akm_fg.backends.registry import BackendSettings
from akm_fg.interfaces import PointTracker
from akm_fg.perception.tracking.flow_tracker import FlowTracker


def make(settings: BackendSettings) -> PointTracker:
    """The tracker, tuned by `perception.observe.tracker`."""
    return FlowTracker(settings.perception.observe.tracker)
