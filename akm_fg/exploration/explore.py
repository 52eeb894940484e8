"""Exploration: look, believe, try, learn; until something is open and known, or nothing is left.

first look -> contacts -> belief -> [best hypothesis -> attempt -> belief] ... -> posterior

Where several parts are looked for, one that was opened is modelled and closed again, and what is
believed of the fronts that it does not explain goes on (`akm_fg.exploration.parts`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import gtsam
import numpy as np

from akm_fg.exploration.attempts.attempt import Trier
from akm_fg.exploration.attempts.filled import filled
from akm_fg.exploration.attempts.pull_watch import Observer, PullWatch, Stream, Tried
from akm_fg.exploration.belief import BayesBelief, Belief, ways_of
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.parts.keep import Keeper, PartModels
from akm_fg.exploration.processor_time import taking
from akm_fg.exploration.records import Attempt, Contact, Exploration, Hypothesis
from akm_fg.exploration.seen_anew import changed, followed
from akm_fg.exploration.suppression import SuppressedMap
from akm_fg.grasping.between import between
from akm_fg.interfaces import Arm, Camera
from akm_fg.records import CalibrationErrors, RgbdFrame

ALIKE_RAD = 0.3  # between two grasps that fail for the same reason
# Between two grasps that are one: the sampler finds it a little elsewhere each time, and a hand
# that felt its way closed as far from it as depth is wrong.
SAME_M, SAME_RAD = 0.02, 0.15
EVEN = 0.5  # probability that something opens, from which on nobody says that nothing does
TICK_S = 1.0  # nobody looks while the arm steps aside


class ContactFinder(Protocol):
    """Where fingers may take hold in a frame, and with which prior: see `contacts`."""

    def __call__(self, frame: RgbdFrame) -> Sequence[Contact]:
        """The contacts of what is seen; none where there is no object."""
        ...


class GraspFinder(Protocol):
    """Grasps of a contact, best first."""

    def __call__(self, frame: RgbdFrame, contact: Contact) -> Sequence[gtsam.Pose3]:
        """T_world_grasp each; none where the fingers find no hold."""
        ...


@dataclass(frozen=True, slots=True)
class Explorer:
    """Who looks, believes and models. Everything is made by its caller."""

    contacts: ContactFinder
    grasps: GraspFinder
    stream: Callable[[int], Stream]  # a new one for an attempt with this number
    config: ExploreConfig
    seed: int = 0
    calibration: CalibrationErrors | None = None  # what is not known of the camera
    models: PartModels | None = None  # of parts that are found, where several are looked for

    def feel_m(self, frame: RgbdFrame, contact: Contact) -> float:
        """How far a contact may be from where it is seen, along the way to it."""
        pull, errors = self.config.pull, self.calibration
        if errors is None:
            return pull.feel_m
        z = float(frame.T_world_cam.transformTo(contact.p_world)[2])
        place = float(np.sqrt(np.trace(errors.cov_world_cam[3:, 3:]) / 3.0))
        off = np.linalg.norm([errors.depth_scale_sd * z, errors.depth_bias_sd_m, place])
        return pull.feel_m + pull.feel_sigmas * float(off)


def explore(
    arm: Arm, camera: Camera, explorer: Explorer, exploration: Exploration, observer: Observer
) -> None:
    """Find what opens, and how.

    Args:
        arm: holds and pulls.
        camera: fixed, watches.
        explorer: perception, belief, and models.
        exploration: is filled as things happen, and stays valid when this is interrupted;
            attempts that it already holds are learned from first, and not made again.
        observer: is told of attempts, frames and stages.
    """
    config = explorer.config
    frame = look_twice(arm, camera, exploration)
    exploration.first_look = exploration.first_look or frame
    if not exploration.contacts:
        observer.stage("looking for places to take hold")
        with taking(exploration.time_s, "contacts"):
            exploration.contacts = tuple(explorer.contacts(frame))
    if not exploration.contacts:
        exploration.failure = "no place to take hold is seen: no object, or it is out of view"
        return
    belief = belief_of(exploration, explorer)
    for attempt in exploration.attempts:
        _learn(belief, attempt)
    for part in exploration.found:
        belief.leave(part.explains)
    while exploration.pulls < config.max_attempts and not _complete(exploration, config):
        with taking(exploration.time_s, "belief"):
            hypothesis = belief.next()
            exploration.beliefs.append(belief.snapshot())
        if hypothesis is None:
            break
        tried = _tried(arm, camera, explorer, exploration, observer, belief, hypothesis)
        _learn(belief, tried.attempt)
        opened = tried.attempt.outcome == "opened"
        told = tried.fit is not None and (opened or not exploration.opened)
        if told or not exploration.looks:
            exploration.fit, exploration.looks = tried.fit, tried.looks
            exploration.fitted = len(exploration.attempts) - 1
        if not config.adaptive_termination:
            break
        keeper = None
        if explorer.models is not None and config.parts != 1:
            feel_m = explorer.feel_m(tried.looks[0].frame, tried.attempt.contact)
            look = partial(look_clear, arm, camera, exploration)
            keeper = Keeper(arm, explorer.models, look, feel_m, config)
        if opened and keeper is not None:
            belief.leave(keeper.keep(exploration, tried, observer).explains)
        elif tried.attempt.pulled and not opened:
            if keeper is not None:
                keeper.put_back(exploration, tried)
            look_clear(arm, camera, exploration)
    _conclude(exploration, belief, config)


def _complete(exploration: Exploration, config: ExploreConfig) -> bool:
    """Whether as many parts are open as are looked for."""
    return config.parts > 0 and exploration.parts_opened >= config.parts


def belief_of(exploration: Exploration, explorer: Explorer) -> Belief:
    """The belief that the configuration asks for, before the first pull."""
    config, contacts = explorer.config, exploration.contacts
    if config.belief == "bayes" and config.failure_suppression:
        return BayesBelief(contacts, config.bayes)
    assert exploration.first_look is not None
    width = exploration.first_look.camera.width
    rng = None if config.failure_suppression else np.random.default_rng([explorer.seed, 11])
    return SuppressedMap(contacts, width, config.suppression, rng)


def look_clear(arm: Arm, camera: Camera, exploration: Exploration) -> RgbdFrame:
    """A frame from which the arm has stepped aside; the arm keeps clear of what it shows."""
    with taking(exploration.time_s, "step aside"):
        frame = camera.capture()
        arm.see(frame)
        for _ in arm.step_aside(frame, TICK_S):
            pass
        frame = camera.capture()
        arm.see(frame)
    return frame


def look_twice(arm: Arm, camera: Camera, exploration: Exploration) -> RgbdFrame:
    """A frame of all that is seen from behind the arm in one place or in another.

    The camera stands still, and nothing but the arm has moved: what one look does not show is
    taken from the other.
    """
    first = look_clear(arm, camera, exploration)
    with taking(exploration.time_s, "step aside"):
        for _ in arm.step_aside(first, TICK_S, unseen=True):
            pass
        second = camera.capture()
        frame = replace(filled(first, second), stamp_s=second.stamp_s)
        arm.see(frame)
    return frame


def _any_moved(exploration: Exploration) -> bool:
    return any(attempt.stretches for attempt in exploration.attempts)


def _tried(
    arm: Arm,
    camera: Camera,
    explorer: Explorer,
    exploration: Exploration,
    observer: Observer,
    belief: Belief,
    hypothesis: Hypothesis,
) -> Tried:
    frame = camera.capture()
    seen = _seen_anew(frame, explorer, exploration, belief, hypothesis.contact)
    contact = exploration.contacts[hypothesis.contact]
    attempt = Attempt(hypothesis, contact, belief.probability(hypothesis))
    number = len(exploration.attempts)
    exploration.attempts.append(attempt)
    observer.begun(number, attempt)
    with taking(exploration.time_s, "grasps"):
        grasps = list(explorer.grasps(seen, contact))
    grasps = others_first(grasps, exploration, hypothesis)
    tried, stream = Tried(attempt), explorer.stream(number)
    feel_m = explorer.feel_m(frame, contact)
    before = seen if seen is exploration.first_look else None
    watch = PullWatch(arm, camera, stream, tried, observer, explorer.config, before)
    Trier(arm, watch, tried, observer, explorer.config, feel_m, belief.while_held).run(grasps)
    observer.ended(number, attempt)
    return tried


def _seen_anew(
    frame: RgbdFrame, explorer: Explorer, exploration: Exploration, belief: Belief, place: int
) -> RgbdFrame:
    """The frame that grasps of a contact are to be found in; the contact moves with its part.

    The first look shows most, but only as long as nothing has moved.
    """
    first, config = exploration.first_look, explorer.config.anew
    if first is None or _any_moved(exploration):
        return frame
    if not changed(first, frame, exploration.contacts[place].p_world, config):
        return first
    with taking(exploration.time_s, "contacts"):
        way = followed(exploration, place, explorer.contacts(frame), config)
    if way is not None:
        belief.noticed(place, way)
    return frame


def _learn(belief: Belief, attempt: Attempt) -> None:
    contact, moved = attempt.hypothesis.contact, bool(attempt.stretches)
    ways = ways_of(attempt.contact.normal_world)
    for way in attempt.rigid_before:
        belief.learn(Hypothesis(contact, way, ways[way]), "rigid", False, True)
    belief.learn(attempt.hypothesis, attempt.outcome, moved, attempt.held)


def others_first(
    grasps: list[gtsam.Pose3], exploration: Exploration, hypothesis: Hypothesis
) -> list[gtsam.Pose3]:
    """Grasps least like those that this contact has lost come first; none lost: as they are.

    One that was lost twice is not tried again: what stops the hand on its way, or is not between
    the fingers, is so the third time.
    """
    lost = [
        attempt.T_world_grasp
        for attempt in exploration.attempts
        if attempt.hypothesis.contact == hypothesis.contact and attempt.outcome == "grasp_lost"
        if attempt.T_world_grasp is not None
    ]
    if not lost:
        return grasps

    def same(T: gtsam.Pose3, x: gtsam.Pose3) -> bool:
        apart_m, turn_rad = between(T, x)
        return apart_m < SAME_M and turn_rad < SAME_RAD

    left = [T for T in grasps if sum(same(T, x) for x in lost) < 2]
    # Stable: the better ones first among equals.
    return sorted(left, key=lambda T: min(between(T, x)[1] for x in lost) < ALIKE_RAD)


def _conclude(exploration: Exploration, belief: Belief, config: ExploreConfig) -> None:
    if _complete(exploration, config) or (exploration.opened and config.parts == 0):
        exploration.stop = config.stop
        return
    if not exploration.attempts:
        exploration.failure = "nothing here is worth a pull"
        return
    refused = sum(attempt.outcome == "refused" for attempt in exploration.attempts)
    tried = f"{exploration.pulls} pulls, {refused} places out of the arm's reach or not clear"
    if exploration.pulls >= config.max_attempts:
        exploration.stop = "attempts"
        what = "nothing was"
        if exploration.opened:
            what = f"{exploration.parts_opened} of {config.parts} parts were"
        exploration.failure = f"{what} opened in {config.max_attempts} attempts ({tried})"
        return
    free, here = belief.snapshot().free, "nothing here"
    if exploration.opened:
        here = f"{exploration.parts_opened} of {config.parts} parts were opened, and nothing else"
    if free < EVEN:
        exploration.failure = f"{here} opens (probability {1.0 - free:.2f}; {tried})"
        return
    what = "nothing" if not exploration.opened else f"{exploration.parts_opened} of {config.parts}"
    exploration.failure = (
        f"{what} was opened: what may open was not to be held "
        f"(something here opens with probability {free:.2f}; {tried})"
    )
