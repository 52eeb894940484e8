"""Lines in space, as a joint's axis sees them."""

from __future__ import annotations

import numpy as np

from akm_fg.records import FloatArray

_LEAST_ALONG = 1e-3  # cosine to the joint's axis: nearly across it, a line crosses anywhere


def line_in_joint_frame(
    T_world_joint: FloatArray, axis: FloatArray, on_axis: FloatArray
) -> FloatArray:
    """Tangent (6,) that takes the joint's z axis to a line, gauge directions zero.

    The line goes through `on_axis` (3,) along `axis` (3,), either sign, world. GTSAM order; to
    first order in the angle, T_world_joint * Exp(xi) has the line as its z axis.
    """
    R = T_world_joint[:3, :3]
    d, o = R.T @ axis, R.T @ (on_axis - T_world_joint[:3, 3])
    d = (d if d[2] >= 0 else -d) / np.linalg.norm(d)
    crossing = o - d * (o[2] / max(float(d[2]), _LEAST_ALONG))
    return np.array([-d[1], d[0], 0.0, crossing[0], crossing[1], 0.0])
