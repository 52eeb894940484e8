"""Who looks in an exploration: made from the settings, with what is missing said in plain words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from akm_fg.backends import grasps
from akm_fg.backends.registry import features_of, make
from akm_fg.cli.exploring.part_models import FolderModels
from akm_fg.cli.exploring.recorder import attempt_name
from akm_fg.config import AkmConfig
from akm_fg.errors import MissingDependency
from akm_fg.exploration.analogy.contacts import ContactMemory
from akm_fg.exploration.analogy.shipped import SHIPPED
from akm_fg.exploration.explore import Explorer
from akm_fg.exploration.perceive import Analogy, Perceiver
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.records import CalibrationErrors
from akm_fg.stages import Stages
from akm_fg.stream.answering_stream import AnsweringStream


def perceiver_of(
    config: AkmConfig, stages: Stages, family: str | None, notes: list[str]
) -> Perceiver:
    """Who finds contacts and grasps.

    Args:
        config: names the backends, and the memory.
        stages: the segmenter among them.
        family: of the object, which is left out of the memory when it is to be new.
        notes: takes in what is done without, and why.

    Raises:
        InputError: a backend or memory that cannot be used.
    """
    segmenter = stages.segmenter or DepthObjectSegmenter(config.perception.observe.mask)
    sampler = make(grasps, config.stages.grasps, config)
    analogy = _analogy(config, family, notes) if config.explore.contact_analogy else None
    return Perceiver(segmenter, sampler, analogy, config.explore)


def explorer_of(
    config: AkmConfig,
    stages: Stages,
    perceived: Perceiver,
    calibration: CalibrationErrors | None,
    folder: Path,
    seed: int,
    keep: Callable[[], None],
) -> Explorer:
    """Who looks, believes and models in a run.

    Args:
        config: of everything.
        stages: who follows points and finds the object.
        perceived: finds contacts and grasps; see `perceiver_of`.
        calibration: what is not known of the camera.
        folder: of the run.
        seed: of what is drawn.
        keep: writes down what was found so far.
    """

    def stream(number: int) -> AnsweringStream:
        name = str(folder / attempt_name(number))
        return AnsweringStream(name, config.model_settings, stages, calibration=calibration)

    return Explorer(
        perceived.contacts,
        perceived.grasps,
        stream,
        config.explore,
        seed,
        calibration,
        FolderModels(folder, config, keep),
    )


def _analogy(config: AkmConfig, family: str | None, notes: list[str]) -> Analogy | None:
    place = Path(config.explore.memory) if config.explore.memory else SHIPPED
    if not config.explore.memory and not place.exists():
        notes.append("no memory of contacts: places are judged by their shape alone")
        return None
    memory = ContactMemory.read(place)
    try:
        features = features_of(config)
    except MissingDependency as error:
        notes.append(f"places are judged by their shape alone: {error}")
        return None
    if features is None:
        notes.append("places are judged by their shape alone: stages.features is none")
        return None
    if config.explore.zero_shot and family is not None:
        memory = memory.without_family(family)
    return Analogy(memory.in_terms_of(features), features)
