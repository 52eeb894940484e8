"""The stages of the way from a recording to a posterior, for who wants others than the defaults.

Each default needs no weights and no network. Files in `akm_fg.backends` make the stages that the
command line knows by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.state_knowledge import StateKnowledge
from akm_fg.interfaces import ObjectSegmenter, PointTracker
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.observed import ObservedMotion
from akm_fg.posterior import ArticulationPosterior, StatePosterior
from akm_fg.records import CameraCorrection, Recording
from akm_fg.stream.config import StreamConfig

Sources = Literal["tracks", "surface", "both"]


@dataclass(frozen=True, slots=True)
class RecordingFit:
    """What was seen in a recording, and what it means."""

    observed: ObservedMotion
    posterior: ArticulationPosterior
    # Of the camera's world, if the posterior is not in it: by a calibration that errs, and a hand.
    correction: CameraCorrection | None = None
    # The best kind's states, those of frames in which the part is hidden by the hand that holds it.
    carried: StatePosterior | None = None


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """How a recording is modelled."""

    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    sources: Sources = "both"  # what enters the graph: tracks, the surfaces of keyframes, or both
    states: StateKnowledge | None = None  # what is known of the joint's motion and limits
    seed: int = 0  # of whatever is sampled
    stream: StreamConfig = field(default_factory=StreamConfig)


class JointEstimator(Protocol):
    """From what was seen of an object's motion to the posterior of its joint."""

    def __call__(
        self, recording: Recording, observed: ObservedMotion, settings: ModelSettings
    ) -> RecordingFit:
        """The posterior, and what was seen in the light of it.

        Raises:
            InsufficientData: the data are sound but do not suffice.
        """
        ...


@dataclass(frozen=True, slots=True)
class Stages:
    """Who does what; None is the default."""

    tracker: PointTracker | None = None
    segmenter: ObjectSegmenter | None = None
    estimator: JointEstimator | None = None
