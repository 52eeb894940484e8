"""Whether rotations and positions of a log go together."""

from __future__ import annotations

import numpy as np

from akm_fg.io.logs.layouts import Poses, rotations_of
from akm_fg.io.read_options import QuaternionOrder
from akm_fg.records import FloatArray

MIN_TURN_RAD = np.deg2rad(8.0)  # less may be a tracker's noise
CONTRADICTS, AGREES = 0.2, 0.05  # of the path's rms size, left by the best turning joint
COMPARED_ROWS = 200  # spread over the log


def order_note(poses: Poses) -> tuple[str, ...]:
    """Says so where the rotations contradict the path as read, but agree in the other order.

    A part on any joint that turns has positions c + R(t) b with constant c and b (a turn about an
    axis through c); c and b are found by least squares, and the rest is compared to the path.
    """
    if poses.quaternions is None:
        return ()
    other: QuaternionOrder = "xyzw" if poses.order == "wxyz" else "wxyz"
    pick = np.unique(np.linspace(0, len(poses.positions) - 1, COMPARED_ROWS).astype(int))
    path, quaternions = poses.positions[pick], poses.quaternions[pick]
    as_read = _unexplained(path, rotations_of(quaternions, poses.order))
    swapped = _unexplained(path, rotations_of(quaternions, other))
    if as_read is None or swapped is None or as_read < CONTRADICTS or swapped > AGREES:
        return ()
    note = (
        f"rotations contradict the path as quaternions {poses.order}, and agree with it as "
        f"{other}: likely --quaternion {other}"
    )
    return (note,)


def _unexplained(path: FloatArray, rotations: FloatArray) -> float | None:
    """Share of the path that c + R b leaves over; None where nothing moves or turns."""
    relative = rotations[0].T @ rotations
    cosine = float((np.trace(relative, axis1=1, axis2=2).min() - 1) / 2)
    if np.arccos(np.clip(cosine, -1.0, 1.0)) < MIN_TURN_RAD:
        return None
    centred = path - path.mean(axis=0)
    size = float(np.sqrt((centred**2).sum(axis=1).mean()))
    if size == 0:
        return None
    A = np.concatenate([np.broadcast_to(np.eye(3), rotations.shape), rotations], axis=2)
    A, y = A.reshape(-1, 6), centred.reshape(-1)
    left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return float(np.sqrt((left**2).sum() / len(path)) / size)
