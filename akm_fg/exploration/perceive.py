"""From a first look to contacts with a prior, and from a contact to grasps.

What shape says (what sticks out of which front) and what remembered contacts say (analogy) are
multiplied: places that look like handles and look like handles that opened come first. The fronts'
priors are then raised or lowered together until something here opens with the probability that is
believed before anything is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from akm_fg.errors import TracksLost
from akm_fg.exploration.analogy.contacts import (
    ContactMemory,
    Opened,
    RememberedContact,
    remembered,
)
from akm_fg.exploration.analogy.transfer import transfer
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.records import Contact
from akm_fg.interfaces import DenseFeatures, GraspSampler, ObjectSegmenter
from akm_fg.perception.fronts.contacts import contact_candidates
from akm_fg.perception.fronts.front_records import ContactCandidate
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

MOST_PRIOR = 0.98  # of one front: nothing is certain before it was pulled


@dataclass(frozen=True, slots=True)
class Analogy:
    """What remembers, and what looks at the object as the memory does."""

    memory: ContactMemory
    features: DenseFeatures


class Perceiver:
    """Finds contacts and grasps in frames.

    Args:
        segmenter: finds the object.
        sampler: finds grasps.
        analogy: what was learned from other objects; None: shape alone.
        config: of the exploration.
    """

    def __init__(
        self,
        segmenter: ObjectSegmenter,
        sampler: GraspSampler,
        analogy: Analogy | None,
        config: ExploreConfig,
    ) -> None:
        self._segmenter, self._sampler = segmenter, sampler
        self._analogy, self._config = analogy, config
        self._masked: tuple[RgbdFrame, BoolArray | None] | None = None  # of the last frame

    def contacts(self, frame: RgbdFrame) -> Sequence[Contact]:
        """The contacts of what is seen; none where there is no object."""
        mask = self._mask(frame)
        if mask is None:
            return ()
        candidates = apart(contact_candidates(frame, mask), self._config.same_contact_m)
        weights = self._weights(candidates, frame, mask)
        return with_priors(candidates, weights, self._config.opens_at_all)

    def grasps(self, frame: RgbdFrame, contact: Contact) -> Sequence[gtsam.Pose3]:
        """Grasps of a contact, best first."""
        mask = self._mask(frame)
        if mask is None:
            return ()
        found = self._sampler.sample(
            frame, mask, contact.p_world, contact.normal_world, at_edge=contact.what == "edge"
        )
        return [candidate.T_world_grasp for candidate in found]

    def as_remembered(
        self, frame: RgbdFrame, opened: Opened
    ) -> tuple[RememberedContact, ContactMemory] | None:
        """A contact that opened, as it is kept, and the memory that was asked beside it.

        None without a memory, and where the object is not seen.
        """
        mask, analogy = self._mask(frame), self._analogy
        if mask is None or analogy is None:
            return None
        features = analogy.features.describe(frame.rgb, mask)
        return remembered(frame, mask, features, opened), analogy.memory

    def _mask(self, frame: RgbdFrame) -> BoolArray | None:
        """The object in a frame; the same frame is asked about again for every contact."""
        if self._masked is None or self._masked[0] is not frame:
            self._masked = frame, self._segmented(frame)
        return self._masked[1]

    def _segmented(self, frame: RgbdFrame) -> BoolArray | None:
        try:
            mask = self._segmenter.segment(frame)
        except TracksLost:
            return None
        return mask if mask.any() else None

    def _weights(
        self, candidates: Sequence[ContactCandidate], frame: RgbdFrame, mask: BoolArray
    ) -> FloatArray:
        """(C,) how promising each is, relative to the others."""
        if not self._config.contact_analogy or not candidates:
            return np.ones(len(candidates))
        shape = np.array([candidate.prior for candidate in candidates])
        analogy = self._analogy
        if analogy is None or not analogy.memory.contacts:
            return shape
        features = analogy.features.describe(frame.rgb, mask)
        prior = transfer(analogy.memory, features, frame, mask)
        score = prior.weights_at(np.array([candidate.uv for candidate in candidates]))
        share = self._config.shape_alone
        return np.asarray(shape * (share + (1.0 - share) * score))


def apart(candidates: Sequence[ContactCandidate], least_m: float) -> tuple[ContactCandidate, ...]:
    """Those that are no nearer than this to a more promising one."""
    kept: list[ContactCandidate] = []
    for candidate in candidates:
        if all(np.linalg.norm(candidate.p_world - other.p_world) >= least_m for other in kept):
            kept.append(candidate)
    return tuple(kept)


def with_priors(
    candidates: Sequence[ContactCandidate], weights: FloatArray, opens_at_all: float
) -> tuple[Contact, ...]:
    """Contacts whose fronts' priors agree with what is believed of the whole.

    A front's prior is that of its best contact; fronts are independent, so something opens with
    probability 1 - prod_f (1 - scale w_f), which fixes the scale.

    Args:
        candidates: places.
        weights: (C,) how promising each is, relative to the others; above 0.
        opens_at_all: probability that anything here opens.
    """
    if not candidates:
        return ()
    fronts = rigid_groups(candidates)
    best = np.array([weights[fronts == front].max() for front in np.unique(fronts)])

    def closed(log_scale: float) -> float:
        return float(np.prod(1.0 - np.minimum(np.exp(log_scale) * best, MOST_PRIOR)))

    low, high = -np.log(best.max()) - 20.0, -np.log(best.min()) + 1.0
    wanted = 1.0 - opens_at_all
    scale = np.exp(high)
    if closed(high) < wanted:
        scale = np.exp(brentq(lambda x: closed(x) - wanted, low, high))
    priors = np.minimum(scale * weights, MOST_PRIOR)
    return tuple(
        Contact(c.p_world, c.uv, c.normal_world, int(front), float(prior), c.what, c.serves)
        for c, front, prior in zip(candidates, fronts, priors, strict=True)
    )


def rigid_groups(candidates: Sequence[ContactCandidate]) -> NDArray[np.int_]:
    """(C,) which contacts move together, as far as can be seen.

    A front has one handle: where several stand on what looks like one front, gaps between fronts
    have been missed, and each handle is taken to have a front of its own. Two handles on one wide
    drawer then cost a second pull, where the other mistake would leave the free one untried.
    """
    groups = np.array([candidate.front for candidate in candidates], dtype=int)
    handles: dict[int, set[int]] = {}
    for candidate in candidates:
        if candidate.thing is not None:
            handles.setdefault(candidate.front, set()).add(candidate.thing)
    own: dict[int, int] = {}
    for place, candidate in enumerate(candidates):
        if candidate.thing is not None and len(handles[candidate.front]) > 1:
            new = int(groups.max(initial=0)) + 1
            groups[place] = own.setdefault(candidate.thing, new)
    return groups
