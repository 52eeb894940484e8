"""The variables of one joint, and factors over them that are given by their normal equations.

T_world_joint (Pose3), one state q_t a frame (double; q of a frame may be fixed at zero) and, of a
helical joint, the pitch (double). Normal equations come over (xi, q_1 .. q_T, [pitch]), tangent
order of GTSAM; what is fixed is left out here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor, square_root_rows
from factors.joint import Joint, JointKind

Array = NDArray[np.float64]
# (joint, q, whether the equations are asked for) -> (twice the cost, equations)
Evaluation = Callable[[Joint, Array, bool], tuple[float, tuple[Array, Array] | None]]


@dataclass(frozen=True, slots=True)
class JointVariables:
    """Keys of one joint's variables.

    Raises:
        ValueError: an unknown kind, or a pitch key where there is no pitch (or none where there
            is one).
    """

    kind: JointKind
    joint_key: int
    state_keys: tuple[int | None, ...]  # one a frame; None where the state is fixed at zero
    pitch_key: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", JointKind(self.kind))
        if self.kind.has_pitch != (self.pitch_key is not None):
            raise ValueError(
                f"a {self.kind} joint with pitch key {self.pitch_key}; helical joints have one"
            )

    @property
    def free(self) -> list[int]:
        """Frames whose states are variables."""
        return [t for t, key in enumerate(self.state_keys) if key is not None]

    @property
    def dims(self) -> dict[int, int]:
        """Key to tangent dimension, in the order of the columns."""
        keys = [*(key for key in self.state_keys if key is not None)]
        if self.pitch_key is not None:
            keys.append(self.pitch_key)
        return {self.joint_key: 6, **dict.fromkeys(keys, 1)}

    @property
    def columns(self) -> NDArray[np.int_]:
        """Of the normal equations, those that are variables."""
        last = [] if self.pitch_key is None else [6 + len(self.state_keys)]
        return np.array([*range(6), *(6 + t for t in self.free), *last], dtype=int)

    def read(self, values: gtsam.Values) -> tuple[Joint, Array]:
        """The joint and the states (T,)."""
        q = np.zeros(len(self.state_keys))
        for t, key in enumerate(self.state_keys):
            if key is not None:
                q[t] = values.atDouble(key)
        pitch = 0.0 if self.pitch_key is None else values.atDouble(self.pitch_key)
        return Joint(self.kind, values.atPose3(self.joint_key).matrix(), pitch), q


def joint_variables(
    kind: JointKind,
    joint_key: int,
    state_keys: Sequence[int | None],
    pitch_key: int | None,
    frames: int,
) -> JointVariables:
    """The variables of a factor over so many frames.

    Raises:
        ValueError: the number of state keys is not that of the frames; see `JointVariables`.
    """
    if len(state_keys) != frames:
        raise ValueError(f"{len(state_keys)} state keys, {frames} frames")
    return JointVariables(kind, joint_key, tuple(state_keys), pitch_key)


def normal_equations_factor(variables: JointVariables, evaluate: Evaluation) -> gtsam.CustomFactor:
    """The factor of a cost that is known by its value and its normal equations.

    Args:
        variables: of the joint.
        evaluate: closure over plain arrays; returns information and gradient of half the cost
            over (xi, q, [pitch]) where they are asked for.
    """
    columns, dims = variables.columns, variables.dims
    rows, definite = columns.size + 1, columns.size - 6  # all but T_world_joint

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        twice_cost, equations = evaluate(*variables.read(values), want_jacobians)
        if equations is None:
            e = np.zeros(rows)
            e[-1] = np.sqrt(twice_cost)
            return e, None
        H, g = equations
        A, e = square_root_rows(H[np.ix_(columns, columns)], g[columns], twice_cost, definite)
        return e, [A[:, :6], *(A[:, k : k + 1] for k in range(6, columns.size))]

    return make_factor(residual, dims, gtsam.noiseModel.Unit.Create(rows))
