"""What is believed of every (contact, way to pull) before the next pull: Bayes, the default.

A rigid front f opens by one way or by none: w_f in {none, outward, left, right, upward}. A contact
c on it serves (s_c) if it sits on that front and has the lever to move it; its grasp holds (g_c)
or not, which is another matter. A pull by way d opens iff w_f = d, s_c and g_c. Outcomes:

    rigid while held:  p = 1 - s_c (1 - e) where w_f = d, else 1    (e: it moves too little to see,
                       or a catch is stronger than the pull)
    grasp empty:       says nothing of w_f and s_c; g_c ~ Beta gets a failure
    slipped off:       the same, and what gives at once slips less: a quarter of a rigid pull
    refused:           says nothing of either; the contact is left alone, and so is one that was
                       missed a few times in a row: closed on nothing, or never reached

Given w_f the contacts' s_c are independent, so the posterior of w_f is exact:
p(w_f = d | pulls) ~ p(w_f = d) prod_c (1 - s_c + s_c e^n_cd) over n_cd rigid pulls: whether a
contact serves is the same in all of them. Fronts are independent: more than one part may be free.

What is held and rigid one way may be pulled another way for the time of the pull alone. That is
done where it is likelier to open for a second of the robot's time than a new hold elsewhere; or
where nothing else is likely to open, so that the hand would come back for it: with B the
probability that nothing opens, B times the time to reach against 1 - B times that of the pulls.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from akm_fg.exploration.records import BeliefSnapshot, Contact, Hypothesis, Outcome, Way
from akm_fg.records import FloatArray

WAYS: tuple[Way, ...] = ("outward", "left", "right", "upward")


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Prior of the ways, and what the outcomes mean.

    The ways' shares are those of the mechanisms that people build, not of any suite: of the single
    joints of furniture nearly all open outwards; sliding doors and lifted lids are the rest.
    """

    outward: float = 0.88
    sideways: float = 0.04  # either side
    upward: float = 0.04
    on_its_front: float = 0.98  # a contact is on the front that it was given to, and has a lever
    slipped: float = 0.25  # of a rigid pull: a bad grasp slips off what is free, too
    missed: float = 0.01  # a rigid pull on what is free that way: a catch, a jam
    # Beta of a grasp: successes and failures beforehand. Less than one of both: what one grasp
    # finds at a place the next finds too; a corner taken for a handle offers no hold at all.
    holds: tuple[float, float] = (0.8, 0.2)
    # Grasps in a row that met nothing, after which a place is left alone: of 241 holds on
    # furniture-dev, 239 came at once, one after one miss and one after two.
    most_missed: int = 4
    nothing_left: float = 0.05  # probability that anything opens below which the search ends
    worth_a_pull: float = 0.01  # probability below which what is held is not pulled another way
    # Robot's seconds: stepping aside, reaching and closing; a pull that opens, or is in vain.
    reach_s: float = 20.0
    open_s: float = 12.0
    rigid_s: float = 5.0

    def way(self, way: Way) -> float:
        """Share of what opens that opens this way."""
        shares = {"outward": self.outward, "upward": self.upward}
        return shares.get(way, self.sideways)


class Belief(Protocol):
    """Says what to try next, and learns from what came of it."""

    def next(self) -> Hypothesis | None:
        """What to try; None where nothing is worth a pull any more."""
        ...

    def probability(self, hypothesis: Hypothesis) -> float:
        """That a pull there opens."""
        ...

    def while_held(self, rigid: Sequence[Hypothesis]) -> Hypothesis | None:
        """Another way to pull what is held, which was rigid in these; None: rather let go."""
        ...

    def learn(
        self, hypothesis: Hypothesis, outcome: Outcome, moved: bool, held: bool = False
    ) -> None:
        """Take in what came of a try.

        Args:
            hypothesis: that was tried.
            outcome: of the attempt.
            moved: a part was seen to move before it was lost.
            held: the fingers had closed on something.
        """
        ...

    def noticed(self, place: int, way: Way) -> None:
        """A contact has gone this way with its part, in no attempt that held it."""
        ...

    def leave(self, contacts: Sequence[int]) -> None:
        """Nothing more is to be tried at these: what they are on is known."""
        ...

    def snapshot(self) -> BeliefSnapshot:
        """As it is now."""
        ...


def ways_of(normal_world: FloatArray) -> dict[Way, FloatArray]:
    """The direction (3,), unit, of each way to pull on a front with this outward normal."""
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, normal_world)
    length = float(np.linalg.norm(side))
    # A front that looks up has no side of its own: any level direction will do.
    left = side / length if length > 0.1 else np.array([0.0, 1.0, 0.0])
    normal = normal_world / np.linalg.norm(normal_world)
    return {"outward": normal, "left": left, "right": -left, "upward": up}


@dataclass(slots=True)
class _Tries:
    """What pulls have shown at one contact."""

    rigid: dict[Way, float] = field(default_factory=dict)
    lost: int = 0
    missed: int = 0  # in a row
    refused: bool = False
    known: bool = False  # it is on a part that was found
    moved: Way | None = None


class BayesBelief:
    """The belief of this module's docstring."""

    def __init__(self, contacts: Sequence[Contact], config: BeliefConfig | None = None) -> None:
        self._contacts, self._config = tuple(contacts), config or BeliefConfig()
        self._tries = [_Tries() for _ in self._contacts]
        self._of_front: dict[int, list[int]] = {}
        for place, contact in enumerate(self._contacts):
            self._of_front.setdefault(contact.front, []).append(place)
        self._ways = [ways_of(contact.normal_world) for contact in self._contacts]

    def next(self) -> Hypothesis | None:
        """The likeliest to open for a second of the robot's time."""
        if self.anything() < self._config.nothing_left:
            return None
        best, most = None, 0.0
        for place in range(len(self._contacts)):
            for way in WAYS:
                hypothesis = Hypothesis(place, way, self._ways[place][way])
                gain = self._gain(hypothesis)
                if gain > most:
                    best, most = hypothesis, gain
        return best

    def probability(self, hypothesis: Hypothesis) -> float:
        """That a pull there opens: the front opens that way, the contact serves, it holds."""
        place, way = hypothesis.contact, hypothesis.way
        if self._left_alone(place):
            return 0.0
        opens = self.front_opens(self._contacts[place].front)[way]
        return opens * self._serves(place, way) * self._holds(place)

    def while_held(self, rigid: Sequence[Hypothesis]) -> Hypothesis | None:
        """Another way to pull what is held; None where a new hold promises more a second."""
        then, place = BayesBelief(self._contacts, self._config), rigid[0].contact
        then._tries = deepcopy(self._tries)
        for pulled in rigid:
            then.learn(pulled, "rigid", False, True)
        if then.anything() < self._config.nothing_left:
            return None
        left = [Hypothesis(place, way, self._ways[place][way]) for way in WAYS]
        left = [
            other
            for other in left
            if other.way not in then._tries[place].rigid
            and then.probability(other) > self._config.worth_a_pull
        ]
        if not left:
            return None
        best = max(left, key=lambda other: then._gain(other, held=True))
        new, back = then.next(), 1.0 - then.anything()
        comes_back = back * self._config.reach_s > (1.0 - back) * self._config.rigid_s * len(left)
        if new is None or comes_back or then._gain(best, held=True) > then._gain(new):
            return best
        return None

    def learn(
        self, hypothesis: Hypothesis, outcome: Outcome, moved: bool, held: bool = False
    ) -> None:
        """Take in what came of a try."""
        tries = self._tries[hypothesis.contact]
        tries.missed = tries.missed + 1 if outcome == "grasp_lost" and not (held or moved) else 0
        if moved:
            tries.moved = hypothesis.way
        if outcome == "rigid":
            tries.rigid[hypothesis.way] = tries.rigid.get(hypothesis.way, 0.0) + 1.0
        elif outcome == "grasp_lost":
            tries.lost += 1
            if held and not moved:
                share = self._config.slipped
                tries.rigid[hypothesis.way] = tries.rigid.get(hypothesis.way, 0.0) + share
        elif outcome == "refused":
            tries.refused = True

    def noticed(self, place: int, way: Way) -> None:
        """Its front opens this way; grasps that missed were of where it was."""
        self._tries[place].moved, self._tries[place].missed = way, 0

    def leave(self, contacts: Sequence[int]) -> None:
        """Nothing more is to be tried at these: what they are on is known."""
        for place in contacts:
            self._tries[place].known = True

    def snapshot(self) -> BeliefSnapshot:
        """As it is now."""
        by_contact = [
            sum(self.probability(Hypothesis(c, way, self._ways[c][way])) for way in WAYS)
            for c in range(len(self._contacts))
        ]
        return BeliefSnapshot(np.array(by_contact), self.anything(), self.free())

    def anything(self) -> float:
        """Probability that any front opens by a pull that can still be tried."""
        closed = 1.0
        for front, places in self._of_front.items():
            opens = self.front_opens(front)
            left = sum(
                share * max((self._still(c, way) for c in places), default=0.0)
                for way, share in opens.items()
            )
            closed *= 1.0 - min(left, 1.0)
        return 1.0 - closed

    def free(self) -> float:
        """Probability that any front opens that is not known, held by the arm or not."""
        opens = [
            sum(self.front_opens(front).values())
            for front, places in self._of_front.items()
            if not any(self._tries[place].known for place in places)
        ]
        return 1.0 - float(np.prod([1.0 - min(each, 1.0) for each in opens]))

    def front_opens(self, front: int) -> dict[Way, float]:
        """Probability of each way by which a front may open; what is missing to one: by none."""
        places, config = self._of_front[front], self._config
        for place in places:
            moved = self._tries[place].moved
            if moved is not None:
                return {way: float(way == moved) for way in WAYS}
        prior = max(self._contacts[place].prior for place in places)
        weights = {way: prior * config.way(way) * self._spared(places, way) for way in WAYS}
        total = 1.0 - prior + sum(weights.values())
        return {way: weight / total for way, weight in weights.items()}

    def _spared(self, places: Sequence[int], way: Way) -> float:
        """Likelihood of the rigid pulls by this way if the front opens by it."""
        likelihood = 1.0
        for place in places:
            serves, n = self._prior_serves(place), self._tries[place].rigid.get(way, 0.0)
            likelihood *= 1.0 - serves + serves * self._config.missed**n
        return likelihood

    def _prior_serves(self, place: int) -> float:
        """Relative to the front's best contact: that one is what the front's prior speaks of."""
        contacts = self._contacts
        best = max(contacts[c].prior for c in self._of_front[contacts[place].front])
        serves = self._config.on_its_front * contacts[place].serves
        return serves * contacts[place].prior / max(best, 1e-9)

    def _serves(self, place: int, way: Way) -> float:
        """Of a contact, given that its front opens this way and all its rigid pulls by it."""
        if self._tries[place].moved is not None:
            return 1.0
        serves, n = self._prior_serves(place), self._tries[place].rigid.get(way, 0.0)
        spared = serves * self._config.missed**n
        return spared / max(spared + 1.0 - serves, 1e-12)

    def _holds(self, place: int) -> float:
        good, bad = self._config.holds
        return good / (good + bad + self._tries[place].lost)

    def _left_alone(self, place: int) -> bool:
        tries = self._tries[place]
        return tries.refused or tries.known or tries.missed >= self._config.most_missed

    def _still(self, place: int, way: Way) -> float:
        """Probability with which a pull could still show what opens this way."""
        if self._left_alone(place):
            return 0.0
        return self._serves(place, way) * self._holds(place)

    def _gain(self, hypothesis: Hypothesis, held: bool = False) -> float:
        """Probability to open for a second; of what is held already, without reaching for it."""
        c, p = self._config, self.probability(hypothesis)
        if held:
            p /= self._holds(hypothesis.contact)
        reach_s = 0.0 if held else c.reach_s
        return p / (reach_s + p * c.open_s + (1.0 - p) * c.rigid_s)
