"""Models of the parts that an exploration opens, one joined to the other in its folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from akm_fg.cli.exploring.outcome import fitted_recording
from akm_fg.cli.exploring.recorder import attempt_name
from akm_fg.config import AkmConfig
from akm_fg.errors import InsufficientData
from akm_fg.exploration.attempts.pull_watch import Tried
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.model.records import Contact, ObjectModel
from akm_fg.model.write import write_model
from akm_fg.records import RgbdFrame
from akm_fg.relocalization.several import PartsRelocalizer


class FolderModels:
    """Makes them as the settings say, and keeps them as the folder's model.json.

    Args:
        folder: of the run.
        config: its settings.
        result: writes down what was found so far, after the model.
    """

    def __init__(self, folder: Path, config: AkmConfig, result: Callable[[], None]) -> None:
        self._folder, self._config, self._result = folder, config, result

    def of(self, number: int, tried: Tried) -> ObjectModel | None:
        """Of the part that an attempt opened; None where too little of it was seen."""
        if tried.fit is None:
            return None
        recording = fitted_recording(attempt_name(number), tried.looks, tried.fit)
        grasp = tried.attempt.T_world_grasp
        contacts = None if grasp is None else [Contact(grasp, 0.0, succeeded=1)]
        try:
            return build_model(
                FittedRecording.of(recording, tried.fit),
                contacts=contacts,
                perception=self._config.perception,
                config=self._config.model,
            )
        except InsufficientData:
            return None

    def states(self, model: ObjectModel, frame: RgbdFrame) -> Sequence[float | None]:
        """Where the parts are in a frame; None where that is not to be seen."""
        config = self._config
        noise = config.perception.observe.noise
        beliefs = PartsRelocalizer(model, noise, config.relocalization).update(frame)
        return [belief.mean if belief.mode == "tracking" else None for belief in beliefs]

    def keep(self, model: ObjectModel) -> None:
        """Write it; one of fewer parts that is there stays beside it."""
        write_model(self._folder, model)
        self._result()
