"""A part was opened: model it, close it, see where it stands, and leave its contacts alone.

It is closed, so that every part is met as the first look showed the object: nothing hides, nothing
stands in the hand's way, and state zero is closed for all. Where it cannot be closed it is left as
it is, and where it stands is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from akm_fg.exploration.attempts.pull_watch import Observer, Tried
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.parts.closing import push_shut, state_of_hand, take_and_push_shut
from akm_fg.exploration.processor_time import taking
from akm_fg.exploration.records import Contact, Exploration, FoundPart
from akm_fg.interfaces import Arm
from akm_fg.model.merge import with_found
from akm_fg.model.records import ModelPart, ObjectModel
from akm_fg.records import RgbdFrame


class PartModels(Protocol):
    """Makes models of parts, and finds parts again by them."""

    def of(self, number: int, tried: Tried) -> ObjectModel | None:
        """Of the part that an attempt opened; None where too little of it was seen."""
        ...

    def states(self, model: ObjectModel, frame: RgbdFrame) -> Sequence[float | None]:
        """Where the parts are in a frame; None where that is not to be seen."""
        ...

    def keep(self, model: ObjectModel) -> None:
        """Write it where it is safe."""
        ...


@dataclass(frozen=True, slots=True)
class Keeper:
    """Who does what is done with an opened part."""

    arm: Arm
    models: PartModels
    look: Callable[[], RgbdFrame]  # lets go and steps aside first
    feel_m: float  # how far the part's contact may be from where it was seen
    config: ExploreConfig

    def put_back(self, exploration: Exploration, tried: Tried) -> None:
        """Push shut what the hand holds, if it has moved."""
        fit, grasp = tried.fit, tried.attempt.T_world_grasp
        joint = None if fit is None else fit.posterior.best.joint
        if joint is None or grasp is None or not self.arm.holding():
            return
        state = tried.attempt.stretches[-1].state
        if state is None:
            state = state_of_hand(joint, grasp, self.arm.T_world_gripper())
        with taking(exploration.time_s, "close"):
            push_shut(self.arm, joint, state, self.config.several, self.config.pull)

    def keep(self, exploration: Exploration, tried: Tried, observer: Observer) -> FoundPart:
        """What was opened, with its place in the exploration's model.

        Args:
            exploration: gets the part, and the model with it.
            tried: the attempt, its last, which has opened it; the hand may still hold it.
            observer: is told.
        """
        observer.stage("  closing it again")
        self.put_back(exploration, tried)
        frame = self.look()
        with taking(exploration.time_s, "model"):
            found = self._found(exploration, tried)
        if found.name is None:
            return found
        assert exploration.model is not None
        part = next(each for each in exploration.model.parts if each.name == found.name)
        self._see(exploration, frame)
        for _ in range(self.config.several.most_closings - 1):
            if found.state is None or self._closed(part, found.state):
                break
            frame = self._closed_anew(exploration, tried, part, found.state, observer)
            self._see(exploration, frame)
        self.models.keep(exploration.model)
        observer.stage(f"  {part.name} {self._told(part, found.state)}")
        return found

    def _found(self, exploration: Exploration, tried: Tried) -> FoundPart:
        """The part that an attempt opened, with what it explains; the model gets it if it is new.

        What is left alone grows where a known part was opened once more.
        """
        number, known = len(exploration.attempts) - 1, exploration.model
        model = self.models.of(number, tried)
        if model is None:
            exploration.notes.append(f"no model of what attempt {number + 1} opened")
            places = on_front(exploration.contacts, tried.attempt.contact.front)
            exploration.found.append(FoundPart(None, number, None, places))
            return exploration.found[-1]
        (part,) = model.parts
        explains = self._explained(exploration, part, tried)
        again = None if known is None else self._known(part, known)
        if again is not None:
            exploration.notes.append(f"attempt {number + 1} opened {again} once more")
            found = next(each for each in exploration.found if each.name == again)
            found.explains = tuple(sorted({*found.explains, *explains}))
            return found
        exploration.model = model if known is None else self._joined(exploration, known, model)
        name = exploration.model.parts[-1].name
        exploration.found.append(FoundPart(name, number, None, explains))
        return exploration.found[-1]

    def _known(self, part: ModelPart, model: ObjectModel) -> str | None:
        """Name of the part of a model that a part is; None where it is new."""
        c = self.config.several
        for known in model.parts:
            tree = cKDTree(known.surface.p_world)
            off_m = tree.query(part.surface.p_world, distance_upper_bound=c.same_m)[0]
            if np.isfinite(off_m).mean() > c.same_share:
                return known.name
        return None

    def _joined(
        self, exploration: Exploration, known: ObjectModel, new: ObjectModel
    ) -> ObjectModel:
        """The model with a new part, which was opened while the others stood where they were."""
        seen = {part.name: part.state for part in exploration.found}
        states = [
            part.closed_state if (q := seen.get(part.name)) is None else q for part in known.parts
        ]
        return with_found(known, new, states)

    def _see(self, exploration: Exploration, frame: RgbdFrame) -> None:
        """Where all parts are in a frame."""
        assert exploration.model is not None
        with taking(exploration.time_s, "model"):
            states = self.models.states(exploration.model, frame)
        by_name = dict(zip((part.name for part in exploration.model.parts), states, strict=True))
        for found in exploration.found:
            if found.name is not None and by_name[found.name] is not None:
                found.state = by_name[found.name]

    def _closed_anew(
        self,
        exploration: Exploration,
        tried: Tried,
        part: ModelPart,
        state: float,
        observer: Observer,
    ) -> RgbdFrame:
        grasp = tried.attempt.T_world_grasp
        observer.stage(f"  {part.name} {self._told(part, state)}; taking hold to close it")
        if grasp is not None:
            c = self.config
            with taking(exploration.time_s, "close"):
                take_and_push_shut(
                    self.arm, part.joint, grasp, state, self.feel_m, c.several, c.pull
                )
        return self.look()

    def _explained(
        self, exploration: Exploration, part: ModelPart, tried: Tried
    ) -> tuple[int, ...]:
        """The contacts that are on a part, which was closed when they were seen."""
        c, contacts = self.config.several, exploration.contacts
        p_world = np.array([contact.p_world for contact in contacts])
        off_m = cKDTree(part.surface.p_world).query(p_world)[0]
        own = np.array([contact.front == tried.attempt.contact.front for contact in contacts])
        on = off_m < np.where(own, c.own_front_m, c.on_part_m)
        on[tried.attempt.hypothesis.contact] = True
        return tuple(np.flatnonzero(on).tolist())

    def _closed(self, part: ModelPart, state: float) -> bool:
        return self._open_m(part, state) < self.config.several.closed_m

    def _open_m(self, part: ModelPart, state: float) -> float:
        """Largest way of the part's points from the closed state."""
        T, p = part.T_seen_part(state), part.surface.p_world
        moved = p @ T.rotation().matrix().T + T.translation()
        return float(np.linalg.norm(moved - p, axis=1).max())

    def _told(self, part: ModelPart, state: float | None) -> str:
        if state is None:
            return "is not to be seen now"
        if self._closed(part, state):
            return "is closed"
        return f"stands open by {100.0 * self._open_m(part, state):.1f} cm"


def on_front(contacts: Sequence[Contact], front: int) -> tuple[int, ...]:
    """The contacts of a front."""
    return tuple(i for i, contact in enumerate(contacts) if contact.front == front)
