"""States of the frames that are not in the graph, given the solved joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.joint_graph import KindFit, Observations
from akm_fg.records import FloatArray, PointTracks


def states_of_all_frames(
    fit: KindFit,
    points: PointTracks,
    keyframes: NDArray[np.int_],
    observations: Observations,
) -> tuple[FloatArray, FloatArray]:
    """States and standard deviations of all T frames."""
    T = points.p_world.shape[0]
    mean, sd = np.full(T, np.nan), np.full(T, np.nan)
    mean[keyframes], sd[keyframes] = fit.q, fit.state_sd
    return mean, sd
