"""All tuning of the program in one tree; every leaf has a dotted path, as in a `--config` file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from akm_fg.calibration.records import CalibrationConfig
from akm_fg.closed_loop import EpisodeConfig
from akm_fg.estimation.config import FitConfig
from akm_fg.exploration.config import ExploreConfig
from akm_fg.manipulation.config import ManipulateConfig
from akm_fg.model.config import ModelConfig
from akm_fg.perception.config import PerceptionConfig
from akm_fg.relocalization.config import RelocalizationConfig
from akm_fg.report.overlay import OverlayConfig
from akm_fg.stages import ModelSettings
from akm_fg.stream.config import StreamConfig


@dataclass(frozen=True, slots=True)
class StageNames:
    """Which backends are used: names of files in `akm_fg.backends`."""

    tracker: str = "flow"
    segmenter: str = "depth"
    grasps: str = "antipodal"
    features: str = "efficientnet"  # of exploration alone; "none" needs no torch
    own: dict[str, dict[str, Any]] = field(default_factory=dict)  # a backend's name -> its settings


@dataclass(frozen=True, slots=True)
class AkmConfig:
    """What works on recordings and with an arm. The simulator's part is the command line's."""

    stages: StageNames = field(default_factory=StageNames)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    stream: StreamConfig = field(default_factory=StreamConfig)
    explore: ExploreConfig = field(default_factory=ExploreConfig)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    manipulate: ManipulateConfig = field(default_factory=ManipulateConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    relocalization: RelocalizationConfig = field(default_factory=RelocalizationConfig)
    overlay: OverlayConfig = field(default_factory=OverlayConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)

    @property
    def model_settings(self) -> ModelSettings:
        """How frames are modelled, with these settings."""
        return ModelSettings(self.perception, self.fit, stream=self.stream)
