"""From remembered contacts to a new object: the paper's Eq. 1, with several memories.

A(u) = mean over the k most similar memories m of  cos(phi(I, u), phi(I_m, u_m))

with phi less the object's mean feature, so that what tells places of one object apart counts, not
what its colour is. Memories are similar where their objects' descriptors, less the mean of the
memory's, point one way.

What comes of it is weak on purpose. Scores are weights exp((A - max A) / temperature), and
kinds are drawn to even odds; both numbers are fitted on `furniture-dev`, on objects that were left
out of the memory (`experiments.hands.contact_memory`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.exploration.analogy.contacts import ContactMemory, OpeningKind, RememberedContact
from akm_fg.exploration.analogy.front import front_axes, front_normal
from akm_fg.interfaces import FeatureMap
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

K = 32  # memories that are averaged; fewer find less, more find no more


@dataclass(frozen=True, slots=True)
class TransferConfig:
    """How much analogy is worth; measured for EfficientNet's features."""

    temperature: float = 0.02  # of scores: a place with so much less similarity weighs a third
    # Share of the memories' vote in the kinds; the rest is even odds. On furniture-dev the vote
    # says nothing of an object that was left out: likelihood is largest at 0.
    trust_in_kinds: float = 0.0
    finest_px: float = 2.0  # places scored are so far apart; between them scores are interpolated


@dataclass(frozen=True, slots=True)
class AnalogyPrior:
    """What remembered contacts say of an object that nobody has touched."""

    similarity: NDArray[np.float32]  # (H, W) A(u) in [-1, 1]; NaN off the object
    score: NDArray[np.float32]  # (H, W) weight in [0, 1], 1 at the best place; 0 off the object
    best_uv: FloatArray  # (2,) where the score is 1
    directions_front: FloatArray  # (k, 3) unit: across, up, out of a front (`front_axes`)
    weights: FloatArray  # (k,) of the directions, sum 1
    directions_world: FloatArray | None  # (k, 3) at `best_uv`; None where it shows no front
    kinds: Mapping[OpeningKind, float]  # sum 1; given that it opens
    memories: tuple[RememberedContact, ...]  # the k that were asked, the most similar first

    def directions_on(self, normal_world: FloatArray) -> FloatArray:
        """(k, 3) unit, world: the ways to pull on a front with this outward normal (3,)."""
        return np.asarray(self.directions_front @ front_axes(normal_world).T)

    def weights_at(self, uv: FloatArray) -> FloatArray:
        """(N,) scores at pixels (N, 2); 0 outside the image."""
        height, width = self.score.shape
        column, row = np.rint(uv).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        found = self.score[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, found, 0.0).astype(float)


def transfer(
    memory: ContactMemory,
    features: FeatureMap,
    frame: RgbdFrame,
    mask: BoolArray,
    k: int = K,
    config: TransferConfig | None = None,
) -> AnalogyPrior:
    """What the k most similar memories say of an object.

    Args:
        memory: at least one contact.
        features: of the object, by the maker that the memory is described by.
        frame: its depth tells the front's axes.
        mask: (H, W), True on the object.
        k: how many memories are asked; all of them if there are fewer.
        config: tuning.

    Raises:
        ValueError: an empty memory or mask, or features of another maker.
    """
    config = config or TransferConfig()
    if not memory.contacts or k < 1 or not mask.any():
        n = len(memory.contacts)
        raise ValueError(f"{n} memories, k = {k}, {int(mask.sum())} pixels: at least 1 of each")
    if memory.made_by != features.made_by:
        raise ValueError(f"memory described by {memory.made_by}, object by {features.made_by}")
    asked = most_similar(memory, features.descriptor, k)
    similarity = similarity_map(features, [contact.feature for contact in asked], mask, config)
    row, column = np.unravel_index(np.nanargmax(similarity), mask.shape)
    best_uv = np.array([column, row], dtype=float)
    score = np.exp((similarity - similarity[row, column]) / config.temperature)
    directions = np.array([contact.direction_front for contact in asked])
    normal = front_normal(frame, mask, best_uv)
    return AnalogyPrior(
        similarity=similarity,
        score=np.where(mask, score, 0.0).astype(np.float32),
        best_uv=best_uv,
        directions_front=directions,
        weights=np.full(len(asked), 1.0 / len(asked)),
        directions_world=None if normal is None else directions @ front_axes(normal).T,
        kinds=kind_prior([contact.kind for contact in asked], config.trust_in_kinds),
        memories=asked,
    )


def most_similar(
    memory: ContactMemory, descriptor: NDArray[np.float32], k: int
) -> tuple[RememberedContact, ...]:
    """The k contacts whose objects are most like one with this descriptor (C,), best first."""
    known = np.array([contact.descriptor for contact in memory.contacts])
    middle = known.mean(axis=0)
    likeness = _unit(known - middle) @ _unit(descriptor - middle)
    return tuple(memory.contacts[i] for i in np.argsort(-likeness, kind="stable")[:k])


def similarity_map(
    features: FeatureMap,
    remembered: list[NDArray[np.float32]],
    mask: BoolArray,
    config: TransferConfig,
) -> NDArray[np.float32]:
    """A(u) (H, W) of remembered features (C,); NaN off the mask."""
    height, width = mask.shape
    # Cosines of features between cells, at a grid finer than the cells and coarser than pixels.
    step = max(1.0, min(config.finest_px, features.step_px / 4.0))
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    u = np.arange(columns[0], columns[-1] + step, step)
    v = np.arange(rows[0], rows[-1] + step, step)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    directions = _unit(np.array(remembered)).mean(axis=0)
    coarse = (_unit(features.at(grid)) @ directions).reshape(len(v), len(u))
    back = np.array([[1.0 / step, 0.0, -u[0] / step], [0.0, 1.0 / step, -v[0] / step]])
    fine = cv2.warpAffine(
        coarse.astype(np.float32),
        back,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.where(mask, fine, np.nan).astype(np.float32)


def kind_prior(votes: list[OpeningKind], trust: float) -> dict[OpeningKind, float]:
    """Probability of each kind, given that it opens: a share of the vote, the rest even odds.

    Helical is left to its own share of the vote: hardly anything that one opens is a screw.
    """
    even: tuple[OpeningKind, ...] = ("prismatic", "revolute")
    return {
        kind: trust * votes.count(kind) / len(votes) + (1.0 - trust) * (kind in even) / len(even)
        for kind in get_args(OpeningKind)
    }


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(np.float32).tiny))
