"""Antipodal grasps on the cloud around a contact: no weights."""

from __future__ import annotations

from akm_fg.backends.registry import BackendSettings
from akm_fg.grasping.antipodal import AntipodalConfig, AntipodalSampler
from akm_fg.interfaces import GraspSampler


def make(settings: BackendSettings) -> GraspSampler:
    """The sampler, tuned by its own table (`stages.own.antipodal`)."""
    return AntipodalSampler(settings.own(AntipodalConfig()))
