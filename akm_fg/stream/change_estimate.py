"""From the motion that depth alone shows to all kinds: surfaces registered from there.

The association of surfaces serves all kinds, but it starts from the joint of one: on a curved lid
a slide finds the same patches as a hinge. Where next to no point could be followed, and the planes
of a flat face do not settle it, the rival of the kind that was found therefore gets a start of its
own, from where the first fit left it; two kinds that explain what changed about as well name none.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InsufficientData
from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds, silenced
from akm_fg.estimation.fit import surface_in_steps
from akm_fg.estimation.sources.source import Given
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.perception.change.depth_change import explained_share
from akm_fg.perception.change.depth_motion import DepthMotion
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.moving_part.following import following
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.surface.changed_surface import ChangedSurface
from akm_fg.perception.surface.remembered_planes import RememberedPlanes
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, FloatArray, Recording
from akm_fg.stages import ModelSettings
from akm_fg.steps import Steps
from akm_fg.stream.surface_state import with_surface_states
from factors.joint import Joint, JointKind

log = logging.getLogger(__name__)

EITHER = 1e-3  # by which what fitted best stays ahead of a rival that explains as much


@dataclass(frozen=True, slots=True)
class _Answer:
    """All kinds from one start, and of what changed the share that the best explains."""

    fitted: FittedKinds
    share: float

    @property
    def turns(self) -> bool | None:
        """Whether the best kind does; None where nothing moved."""
        joint = self.fitted.posterior.best.joint
        return None if joint is None else joint.turns


@dataclass(frozen=True, slots=True)
class _Start:
    """What the fits of one recording share."""

    recording: Recording
    observed: ObservedMotion
    used: NDArray[np.int_]  # tracks that follow
    change: DepthMotion
    settings: ModelSettings
    knowledge: list[Given]
    planes: RememberedPlanes


def by_change_in_steps(
    recording: Recording,
    observed: ObservedMotion,
    change: DepthMotion,
    settings: ModelSettings,
    knowledge: list[Given],
    planes: RememberedPlanes | None = None,
) -> Steps[tuple[ObservedMotion, FittedKinds, NDArray[np.int_]]]:
    """Start from the motion that depth shows; the tracks that follow it take part.

    Args:
        recording: what was seen.
        observed: in it.
        change: the motion that depth shows.
        settings: of the fit.
        knowledge: what else is known.
        planes: of its frames, as far as they were fitted before.

    Returns:
        What was seen with those tracks as the moving ones, all kinds, and which tracks took part.
    """
    perception, guess = settings.perception, change.guesses[0]
    moving = following(observed.tracks, *guess.motion(), change.known[0], perception.following)
    segmentation = observed.segmentation
    observed = replace(
        observed,
        segmentation=replace(
            segmentation,
            moving=moving,
            static=segmentation.static & ~moving,
            rejected=(segmentation.rejected | segmentation.moving) & ~moving,
        ),
    )
    enough = moving.sum() >= MIN_POINTS and settings.sources != "surface"
    used = np.flatnonzero(moving) if enough else np.zeros(0, dtype=int)
    remembered = planes or RememberedPlanes()
    start = _Start(recording, observed, used, change, settings, knowledge, remembered)
    answer = yield from _answer_from(start, guess, change.known[0])
    if used.size < perception.rig.least_tracks and not _faces_agree(answer, change, perception):
        answer = yield from _against_its_rival(start, answer)
    answer = yield from _in_more_frames(start, answer)
    log.info("%s: the answer explains %.2f of the change", recording.name, answer.share)
    fitted = _silenced_where_little_is_told(answer, change, perception)
    return observed, fitted, used[fitted.problem.members]


def _silenced_where_little_is_told(
    answer: _Answer, change: DepthMotion, perception: PerceptionConfig
) -> FittedKinds:
    """The kinds; none is named where the best explains little, or has few states."""
    fitted, reason = answer.fitted, None
    if not answer.share >= perception.least_explained:
        share = 0.0 if np.isnan(answer.share) else 100 * answer.share
        reason = (
            f"only {share:.0f} % of what changed in depth is "
            "where this joint puts the part; expected most of it"
        )
    else:
        told, changed = _told(answer, change)
        if told < perception.least_told * changed:
            reason = (
                f"the part could be found in {told} of the {changed} frames in which "
                "depth changed; expected more of them"
            )
    if reason is None:
        return fitted
    return replace(fitted, posterior=silenced(fitted.posterior, reason))


def _told(answer: _Answer, change: DepthMotion) -> tuple[int, int]:
    """In how many of the frames in which depth changed there is a state; how many these are."""
    changed = change.change.nearer.any(axis=(1, 2))
    states = answer.fitted.posterior.best.states
    told = changed if states is None else changed & np.isfinite(states.mean)
    return int(told.sum()), int(changed.sum())


def _in_more_frames(start: _Start, answer: _Answer) -> Steps[_Answer]:
    """The answer, or the one that it leads to in frames in which depth's first guess was astray.

    A face tells where the part is as long as it is seen; the joint of a few frames tells where to
    look in the next one, and that where in the one after.
    """
    perception, fitted = start.settings.perception, answer.fitted
    told, changed = _told(answer, start.change)
    before = fitted.posterior.best.states
    if before is None or answer.turns is None or told >= perception.tell_most * changed:
        return answer
    frames = dict(enumerate(start.recording.frames))
    config = start.settings.stream.surface_state
    sought = with_surface_states(fitted.posterior, fitted, frames, perception.observe.noise, config)
    best = sought.best
    if best.joint is None or best.states is None:
        return answer
    if np.isfinite(best.states.mean).sum() <= np.isfinite(before.mean).sum():
        return answer
    yield
    try:
        other = yield from _answer_from(start, *_guess(best.joint.joint, best.states.mean))
    except InsufficientData:
        return answer
    log.info("%s: states in %d of %d frames", start.recording.name, *_told(other, start.change))
    alike = other.turns == answer.turns and _told(other, start.change)[0] > told
    worse = answer.share - other.share > perception.change.clearly_more
    return other if alike and not worse else answer


def _answer_from(start: _Start, guess: JointGuess, known: BoolArray) -> Steps[_Answer]:
    """All kinds, the surface registered from one joint.

    Args:
        start: what is fitted.
        guess: the joint, over the T frames.
        known: (T,) where its states are.
    """
    settings, change = start.settings, start.change
    config = settings.perception.surface
    surface = ChangedSurface(change.change, settings.seed, config, start.planes)
    fitted = yield from surface_in_steps(
        surface,
        guess,
        surface.middle(*guess.motion(), known),
        start.observed.tracks.select(start.used),
        start.recording.name,
        settings.fit,
        settings.fit.camera_systematic_m,
        start.knowledge,
    )
    return _Answer(fitted, share_of_answer(change, fitted, settings.perception))


def _faces_agree(answer: _Answer, change: DepthMotion, perception: PerceptionConfig) -> bool:
    """Whether the planes of the part's face, which no patch has part in, are of the same kind."""
    alike = change.guesses[0].joint.kind.turns == answer.turns
    return bool(alike and change.explained[0] >= perception.faces_suffice)


def _against_its_rival(start: _Start, answer: _Answer) -> Steps[_Answer]:
    """The answer, or the one that its rival leads to; silenced where they explain as much."""
    rival = _rival(answer.fitted)
    if rival is None:
        return answer
    try:
        other = yield from _answer_from(start, *rival)
    except InsufficientData:
        return answer
    clearly = start.settings.perception.change.clearly_more
    more = np.nan_to_num(other.share) - np.nan_to_num(answer.share)
    log.info("%s: the rival's start explains %.2f", start.recording.name, other.share)
    if more > clearly:
        return other
    if other.turns == answer.turns or -more > clearly:
        return answer
    reason = "by depth alone the part may turn or slide; expected texture on it, or a longer way"
    either = _either(answer.fitted.posterior, reason)
    return replace(answer, fitted=replace(answer.fitted, posterior=either))


def _either(posterior: ArticulationPosterior, reason: str) -> ArticulationPosterior:
    """The answer, turning and sliding as probable as each other; what is best stays best."""
    best = posterior.best.joint
    assert best is not None
    moving = {k: a.joint for k, a in posterior.alternatives.items() if a.joint is not None}
    alike = [k for k, joint in moving.items() if joint.turns == best.turns]
    others = [k for k in moving if k not in alike]
    probability = dict(posterior.kind_probability)
    total = sum(probability[k] for k in moving)
    for some, half in ((alike, 0.5 + EITHER), (others, 0.5 - EITHER)):
        own = sum(probability[k] for k in some)
        for k in some:
            share = probability[k] / own if own > 0.0 else 1.0 / len(some)
            probability[k] = total * half * share
    return silenced(replace(posterior, kind_probability=probability), reason)


def _rival(fitted: FittedKinds) -> tuple[JointGuess, BoolArray] | None:
    """The other of hinge and slide where the fit left it, and where its states are."""
    best = fitted.posterior.best.joint
    if best is None:
        return None
    kind = JointKind.PRISMATIC if best.turns else JointKind.REVOLUTE
    rival = fitted.posterior.alternatives.get(str(kind))
    if rival is None or rival.joint is None or rival.states is None:
        return None
    return _guess(rival.joint.joint, rival.states.mean)


def _guess(joint: Joint, states: FloatArray) -> tuple[JointGuess, BoolArray]:
    """A joint with states (T,) interpolated, zero in frame 0; and where they are known."""
    known = np.isfinite(states)
    frames = np.arange(known.size)
    q = np.interp(frames, frames[known], states[known])
    return JointGuess(joint, q - q[0]), known


def share_of_answer(change: DepthMotion, fitted: FittedKinds, config: PerceptionConfig) -> float:
    """Of what changed, how much the most probable kind explains in the frames it has states of.

    Where frame 0 has none, since it shows another side of the part than the others, its state is
    near the one of depth's first guess, if that explains the change: the one that explains most.

    Args:
        change: the motion that depth shows.
        fitted: all kinds.
        config: tuning.

    Returns:
        NaN where nothing can be judged.
    """
    best = fitted.posterior.best
    if best.joint is None or best.states is None:
        return float("nan")
    joint, known, guess = best.joint.joint, np.isfinite(best.states.mean), change.guesses[0]
    q, ways = np.where(known, best.states.mean, 0.0), np.zeros(1)
    if not known[0] and not change.explained[0] >= config.least_explained:
        return float("nan")
    if not known[0]:
        forward = float(np.sign(joint.axis @ guess.joint.axis))
        between = float(np.median(forward * guess.q[known] - q[known]))
        metres = fitted.problem.part.metres_per_unit(JointGuess(joint, q))
        ways = between + np.array(config.change.first_off_m) / metres
    shares = [explained_share(change.change, *joint.motion(q + way), known) for way in ways]
    return max(shares)
