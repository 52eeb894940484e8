"""Point-track factor: every tracked point of the part follows the joint.

Claim: N points of one rigid part, observed in T frames with known 3x3 covariances, move as the
joint says. Variables: T_world_joint (Pose3), one state q_t per frame (double; q of a frame may be
fixed at zero), and a helical joint's pitch (double). The points' reference positions are latent
and marginalised here, so that no frame counts as exact (the paper's Eq. 5 takes the first frame's
points as truth, which makes the axis' covariance several times too small).

Residual of one observation, in reference coordinates (see `factors.joint`):

    e_tn = z_tn - x_n,     d2_tn = e_tn^T Lambda_tn e_tn,     cost = 1/2 sum rho(d2_tn)

with rho the Student-t kernel *per observation* and Lambda the inverse covariance, rotated from
world by the joint and the state. That rotation is what makes the twist Jacobian G(x), at the
latent point, and not G(z): the error in world is p - T_world_joint Exp(q S) x. For given joint
and states the latent x_n minimises its own terms (iterated weighted means); the
Gauss-Newton information of what remains is the Schur complement over all x_n. GTSAM sees
6 + T + 1 rows however many points there are (`square_root_rows`).
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.joint import Joint, JointKind
from factors.joint_variables import joint_variables, normal_equations_factor
from factors.measurements.track_cost import TrackCost, TrackObservations, track_cost
from factors.measurements.track_information import track_normal_equations

Array = NDArray[np.float64]


def point_key(joint: Joint, q: Array) -> bytes:
    """What a joint of a known kind and states (T,) are filed under."""
    return joint.T_world_joint.tobytes() + q.tobytes() + np.float64(joint.pitch).tobytes()


def point_track_factor(
    kind: JointKind,
    joint_key: int,
    state_keys: Sequence[int | None],
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
    last: dict[bytes, TrackCost] | None = None,
    pitch_key: int | None = None,
) -> gtsam.CustomFactor:
    """The factor over T_world_joint, the states and a helical joint's pitch.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        state_keys: one a frame, key of q_t (double), or None where q_t is fixed at zero.
        tracks: the observations, T frames.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        x_start: (3, N) where to start the latent points, joint frame; saves time only.
        last: keeps the last evaluation under `point_key`, for a caller who wants it too.
        pitch_key: key of a helical joint's pitch (double), metres per radian.

    Raises:
        ValueError: the number of keys is not that of the frames, an unknown kind, or a pitch key
            where there is no pitch (or none where there is one).
    """
    variables = joint_variables(kind, joint_key, state_keys, pitch_key, tracks.p_world.shape[0])
    memory = {} if last is None else last

    def evaluate(
        joint: Joint, q: Array, want_equations: bool
    ) -> tuple[float, tuple[Array, Array] | None]:
        here = point_key(joint, q)
        if here not in memory:  # the optimiser asks for the error first, then for the Jacobian
            start = next((cost.x_joint for cost in memory.values()), x_start)
            memory.clear()
            memory[here] = track_cost(joint, q, tracks, dof, scale, start)
        cost = memory[here]
        equations = track_normal_equations(joint, q, cost) if want_equations else None
        return cost.twice_cost, equations

    return normal_equations_factor(variables, evaluate)
