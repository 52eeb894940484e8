"""Which frames of a graph belong together, and which of them tell of the joint.

Frames are tied by what they see in common: patches, or points that were followed from one to the
other. What ties to nothing may be anything that happens to lie where some state would put the
part: the hand, or what the part covered. And a thin part that has passed edge-on shows its back,
which no frame before knows: how far it has turned in between nothing tells, so that one graph
over both has a direction that is open. One side has to do.
"""

from __future__ import annotations

import itertools

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
    number = np.arange(q.size) if frames is None else frames
    steps = np.diff(q) / np.diff(number)
    if q.size < 3 or not steps.any():
        return off
    most = _most(steps, config)
    far = np.abs(steps) > most
    back = steps[:-1] * steps[1:] < 0
    off[1:-1] = far[:-1] & far[1:] & back
    # Where the part began is left out by the size of its step alone: a wait after it is no excuse.
    leaps = abs(q[1] - q[0]) > _most(np.diff(q), config)
    off[0], off[-1] = leaps & far[0] & back[0] & ~off[1], far[-1] & back[-1] & ~off[-2]
    return off | _astray(q, number, config) | _gone_back_beyond(q, steps, far, most)


def _most(steps: FloatArray, config: SurfaceConfig) -> float:
    """How far a part may go in a step, by what it usually goes; infinite where it goes nowhere."""
    moved = np.abs(steps[steps != 0])
    return config.usual_steps * float(np.median(moved)) if moved.size else np.inf


def _astray(q: FloatArray, frames: NDArray[np.int_], config: SurfaceConfig) -> BoolArray:
    """(T,) runs between a far step and one back, without which the path goes on as usual.

    Which run is the one astray is open where several are in question: the shortest goes first.
    """
    kept = np.arange(q.size)
    while kept.size >= 3:
        steps = np.diff(q[kept]) / np.diff(frames[kept])
        most = _most(steps, config)
        ends = np.flatnonzero(np.abs(steps) > most)  # a run is kept[i + 1 : j + 1]
        across = [
            (j - i, i, j)
            for i, j in itertools.pairwise(ends.tolist())
            if steps[i] * steps[j] < 0
            and 2 * (j - i) < q.size
            and abs(q[kept[j + 1]] - q[kept[i]]) <= most * (frames[kept[j + 1]] - frames[kept[i]])
        ]
        if not across:
            break
        _, i, j = min(across)
        kept = np.delete(kept, np.arange(i + 1, j + 1))
    return np.asarray(~np.isin(np.arange(q.size), kept))


def _gone_back_beyond(q: FloatArray, steps: FloatArray, far: BoolArray, most: float) -> BoolArray:
    """(T,) fewer than half, to the end, after a far step back to outside the others' range."""
    off = np.zeros(q.size, dtype=bool)
    ends = np.flatnonzero(far)
    if not ends.size or steps[ends[-1]] * steps[~far].sum() >= 0:
        return off
    first = int(ends[-1]) + 1
    others, those = q[:first], q[first:]
    if (
        2 * those.size < q.size
        and ((those < others.min() - most) | (those > others.max() + most)).all()
    ):
        off[first:] = True
    return off
