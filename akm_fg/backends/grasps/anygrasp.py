"""Grasps by an external process, such as AnyGrasp; `stages.own.anygrasp.command` says which."""

from __future__ import annotations

from akm_fg.backends.registry import BackendSettings
from akm_fg.grasping.external import ExternalGraspsConfig, ExternalSampler
from akm_fg.interfaces import GraspSampler


def make(settings: BackendSettings) -> GraspSampler:
    """The sampler, set up by its own table (`stages.own.anygrasp`)."""
    return ExternalSampler(settings.own(ExternalGraspsConfig()))
