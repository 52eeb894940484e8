"""What an exploration leaves in its folder: the report, and the object's model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from akm_fg import __version__
from akm_fg.cli.exploring.kept import Explored
from akm_fg.cli.exploring.recorder import attempt_name
from akm_fg.config import AkmConfig
from akm_fg.errors import InsufficientData
from akm_fg.estimation.config import GraspConfig
from akm_fg.exploration.pages.page import exploration_part
from akm_fg.exploration.records import Attempt, Exploration
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.model.read import FILE, read_model
from akm_fg.model.records import Contact, ModelPart, ObjectModel
from akm_fg.model.write import write_model
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import JointTruth, Look, Recording, RgbdFrame, first_hold
from akm_fg.relocalization.likelihood import StateLikelihood
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.report.summary import PartTracks, RunSummary
from akm_fg.report.write import write_report
from akm_fg.stages import RecordingFit
from akm_fg.stream.gripper_state import with_gripper_states
from akm_fg.view.embedded import embedded_view

REPORT = "report.html"


def last_recording(exploration: Exploration) -> Recording | None:
    """The frames that the exploration's fit is of; without one, its last attempt's, or the first.

    Looks that were taken after the last solution, as when a grip was lost, have no states.
    """
    last, first = max(len(exploration.attempts) - 1, 0), exploration.first_look
    name = attempt_name(last if exploration.fitted is None else exploration.fitted)
    if not exploration.looks:
        return None if first is None else Recording(name, (first,))
    return fitted_recording(name, exploration.looks, exploration.fit)


def fitted_recording(name: str, looks: Sequence[Look], fit: RecordingFit | None) -> Recording:
    """The frames of an attempt's looks that its fit has states of; all where it has none."""
    looks = looks[: solved_frames(fit)]
    frames, grips = zip(*((look.frame, look.T_world_gripper) for look in looks), strict=True)
    return Recording(name, frames, None, grips, first_hold(looks))


def solved_frames(fit: RecordingFit | None) -> int | None:
    """How many frames a fit has states of; None where it has none."""
    if fit is None or fit.posterior.best.states is None:
        return None
    return len(fit.posterior.best.states.mean)


def write_outcome(
    title: str, command: str, seed: int, explored: Explored, config: AkmConfig
) -> None:
    """Write report.html.

    Raises:
        OutputError: the disk refuses.
    """
    exploration, truth = explored.exploration, explored.truth
    recording, fit = last_recording(exploration), exploration.fit
    if recording is None:
        return
    tracks = None
    if fit is not None:
        parts = fit.observed.segmentation
        tracks = PartTracks(fit.observed.pixels, parts.moving, parts.static)
    summary = RunSummary(
        title=title,
        command=command,
        seed=seed,
        version=__version__,
        recording=recording,
        tracks=tracks,
        posterior=None if fit is None else fit.posterior,
        truth=None if truth is None else _of_frames(truth, len(recording.frames)),
        time_s=dict(exploration.time_s),
        failure=exploration.failure,
    )
    part = exploration_part(exploration, config.explore)
    model = None if explored.model is None else read_model(explored.model)
    view = None if model is None else embedded_view(model, title)
    write_report(explored.folder / REPORT, summary, config.overlay, introduction=part, view=view)


def _of_frames(truth: JointTruth, frames: int) -> JointTruth | None:
    """The truth of the first frames; None where it is of another attempt."""
    if len(truth.states) < frames:
        return None
    return replace(truth, states=truth.states[:frames])


def write_part_model(folder: Path, exploration: Exploration, config: AkmConfig) -> Path | None:
    """Write model.json of what was opened; None where nothing was, or too little is known of it.

    Raises:
        OutputError: the disk refuses.
    """
    if exploration.model is not None:  # of several parts: written as they were found
        return folder / FILE
    recording, fit = last_recording(exploration), exploration.fit
    if not exploration.opened or fit is None or recording is None:
        return None
    fitted = FittedRecording.of(recording, fit)
    try:
        model = _built(fitted, exploration, config)
        gone_m = carried_before(exploration)
        _require_closed_known(model, gone_m, config)
        closed = closed_at(model, exploration.first_look, config, gone_m)
        why = "the part had crept open before the pull that opened it"
        if closed is None:
            closed = began_at(fit.posterior, recording)
            why = "states count from a later frame: where the pull began, the hand tells"
        if closed is not None:
            exploration.notes.append(why)
            fitted = FittedRecording.of(recording, fit, closed)
            model = _built(fitted, exploration, config)
    except InsufficientData as error:
        exploration.notes.append(f"no model.json: {error}")
        return None
    return write_model(folder, model)


def carried_before(exploration: Exploration) -> float:
    """How far a hand had gone, at most, with the front that opened at last; 0: as pads give.

    Whether it was seen to move then or not, where it is left nobody sees.
    """
    last, others = exploration.attempts[-1], exploration.attempts[:-1]
    gone = [_gone_m(a) for a in others if a.contact.front == last.contact.front]
    most = max(gone, default=0.0)
    return most if most > CARRIED_M else 0.0


def _gone_m(attempt: Attempt) -> float:
    return attempt.stretches[-1].travel_m if attempt.stretches else attempt.unseen_m


def _require_closed_known(model: ObjectModel, gone_m: float, config: AkmConfig) -> None:
    """Refuse a part that slides along its own surface and may have been moved before.

    Its outline alone tells where it was in the first look, which on plain sliding doors was 2 and
    24 cm off and sure of it.

    Raises:
        InsufficientData: it is one.
    """
    if gone_m <= 0.0:
        return
    settings = config.relocalization
    likelihood = StateLikelihood(model.parts[0], model.static, settings.likelihood)
    if likelihood.slides_along_itself < settings.outline_along:
        raise _closed_unknown(gone_m, "a plain front does not show how far it slid along itself")


def _closed_unknown(gone_m: float, why: str) -> InsufficientData:
    told = f"the hand had gone {100 * gone_m:.0f} cm with it before, and {why}"
    return InsufficientData(f"where it is closed is not known: {told}")


def _built(fitted: FittedRecording, exploration: Exploration, config: AkmConfig) -> ObjectModel:
    """The model of a fitted recording, with the grasp that opened."""
    model = build_model(fitted, contacts=[], perception=config.perception, config=config.model)
    grasp, part = exploration.attempts[-1].T_world_grasp, model.parts[0]
    if grasp is None:
        return model
    contact = Contact(part.T_world_part(0.0).inverse() * grasp, 0.0, succeeded=1)
    return replace(model, parts=(replace(part, contacts=(contact,)),))


def closed_at(
    model: ObjectModel, first: RgbdFrame | None, config: AkmConfig, gone_m: float = 0.0
) -> float | None:
    """Where the part was in the first look, in the states of its recording; None: where it began.

    Pulls that were in vain may have moved what opens: the recording does not begin at closed then.

    Args:
        model: of the part.
        first: look of the exploration.
        config: of the search.
        gone_m: that a hand went with the part before, at most.

    Raises:
        InsufficientData: a hand went with it, and the first look shows it nowhere.
    """
    if first is None:
        return None
    noise, part = config.perception.observe.noise, model.parts[0]
    search = config.relocalization.search
    most_m = search.most_rad * _lever_m(part) if part.joint.turns else search.most_m
    wide = replace(search, below=search.below + 1.1 * gone_m / most_m)
    settings = replace(config.relocalization, search=wide)
    belief = Relocalizer(model, 0, noise, settings).update(first)
    if belief.mode != "tracking" or belief.mean is None or belief.sd is None:
        if gone_m > 0.0:
            raise _closed_unknown(gone_m, "the first look shows it at no state")
        return None
    turns = part.joint.turns
    crept = abs(belief.mean) > max(CREPT_SIGMAS * belief.sd, CREPT_RAD if turns else CREPT_M)
    return belief.mean if crept else None


def _lever_m(part: ModelPart) -> float:
    """Metres that the part's middle goes for a unit of state."""
    middle = part.surface.p_world.mean(axis=0)
    return max(float(np.linalg.norm(part.joint.joint.velocity(middle))), 1e-3)


def began_at(posterior: ArticulationPosterior, recording: Recording) -> float | None:
    """State of the part when the hand took hold, by the hand; None where frames show it.

    A part that the hand hides at first is seen from a later frame on, and states count from there.
    """
    states, joint, held = posterior.best.states, posterior.best.joint, recording.grasp_frames
    poses = recording.T_world_gripper
    if states is None or joint is None or held is None or poses is None:
        return None
    first, last = held
    if np.isfinite(states.mean[: first + 1]).any():
        return None
    hands = {k: poses[k].translation() for k in range(first, last + 1)}
    told = with_gripper_states(posterior, hands, GraspConfig()).best.states
    if told is None or not np.isfinite(told.mean[first]):
        return None
    began = float(told.mean[first])
    return began if abs(began) > (CREPT_RAD if joint.turns else CREPT_M) else None


CARRIED_M = 0.03  # that a hand went with a part: less is the give of grips and catches
CREPT_SIGMAS = 3.0  # of the state in the first look: less is no sign of it
CREPT_M, CREPT_RAD = 0.003, 0.01  # nor is this: catches and pads give as much
