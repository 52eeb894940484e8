"""Which frames of a graph belong together, and which of them tell of the joint.

Frames are tied by what they see in common: patches, or points that were followed from one to the
other. What ties to nothing may be anything that happens to lie where some state would put the
part: the hand, or what the part covered. And a thin part that has passed edge-on shows its back,
which no frame before knows: how far it has turned in between nothing tells, so that one graph
over both has a direction that is open. One side has to do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from akm_fg.estimation.config import SurfaceConfig
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import BoolArray, FloatArray


def tied_frames(
    followed: BoolArray,
    at: NDArray[np.int_],
    seen: BoolArray,
    config: SurfaceConfig | None = None,
) -> NDArray[np.int_]:
    """(T,) a number for each frame, the same of those that are tied, also through others.

    Args:
        followed: (T, N) points of the part in the graph's frames.
        at: (K,) those of the frames that have a view.
        seen: (K, S) patches.
        config: how much two views share that are tied.
    """
    config = config or SurfaceConfig()
    points = followed.astype(int)
    tied = points @ points.T > 0
    shared = seen.astype(int) @ seen.T.astype(int)
    own = np.diag(shared)
    enough = np.maximum(
        config.least_shared * np.minimum(own[:, None], own), config.least_shared_patches
    )
    tied[np.ix_(at, at)] |= shared >= enough
    _, label = connected_components(csr_matrix(tied), directed=False)
    return np.asarray(label)


def most_telling(label: NDArray[np.int_], guess: JointGuess, information: FloatArray) -> BoolArray:
    """(T,) frames of the group that tells most of the joint: which it tells by its motion.

    What rests is seen as well in any number of frames and tells nothing.

    Args:
        label: (T,) of the groups.
        guess: over the T frames.
        information: (6 T, 6 T) on their motions, in the tangent of `factors.motion_information`.
    """
    T, q = label.size, guess.q
    twist = guess.joint.motion_jacobians(np.zeros(1))[1][0]
    blocks = information.reshape(T, 6, T, 6)[np.arange(T), :, np.arange(T)]
    weight = np.maximum(np.einsum("i,tij,j->t", twist, blocks, twist), 0.0)  # of the states
    total = np.maximum(np.bincount(label, weight), np.finfo(float).tiny)
    middle = np.bincount(label, weight * q) / total
    told = np.bincount(label, weight * (q - middle[label]) ** 2)
    return np.asarray(label == told.argmax())


def off_the_path(
    q: FloatArray, config: SurfaceConfig | None = None, frames: NDArray[np.int_] | None = None
) -> BoolArray:
    """(T,) states that no part goes to: by far jumps to and fro, or back to beyond all others.

    Where a dark part is hardly seen, what is left of it fits in many places, and what a door
    uncovers may look as it would elsewhere. A part may go far from one frame to the next, but it
    seldom comes back by as much in the one after, and not past where it began.

    Args:
        q: (T,) states.
        config: how far a part may go.
        frames: (T,) numbers of the frames in their recording, growing; one after the other if
            not said.
    """
    config, off = config or SurfaceConfig(), np.zeros(q.size, dtype=bool)
    steps = np.diff(q) if frames is None else np.diff(q) / np.diff(frames)
    moved = np.abs(steps[steps != 0])
    if q.size < 3 or not moved.size:
        return off
    most = config.usual_steps * np.median(moved)
    far = np.abs(steps) > most
    back = steps[:-1] * steps[1:] < 0
    off[1:-1] = far[:-1] & far[1:] & back
    off[0], off[-1] = far[0] & back[0] & ~off[1], far[-1] & back[-1] & ~off[-2]
    return off | _gone_back(q, steps, far, most)


def _gone_back(q: FloatArray, steps: FloatArray, far: BoolArray, most: float) -> BoolArray:
    """(T,) fewer than half, after a far step against the way of the others.

    They are off where another far step leads on again, or where they lie outside the others' range.
    """
    turned = np.concatenate([[0.0], np.sign(steps * np.sign(steps[~far].sum())) * far])
    ends = np.flatnonzero(turned)
    run = np.searchsorted(ends, np.arange(q.size), side="right") - 1  # -1 before the first
    back = (run >= 0) & (turned[ends[run]] < 0) if ends.size else np.zeros(q.size, dtype=bool)
    if not back.any() or 2 * back.sum() >= q.size:
        return np.zeros(q.size, dtype=bool)
    led_on = np.append(turned[ends[1:]] > 0, False)[run]
    others = q[~back]
    beyond = (q < others.min() - most) | (q > others.max() + most)
    return np.asarray(back & (led_on | beyond))
