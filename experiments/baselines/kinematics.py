"""Rigid motion of a joint as torch tensors, so that gradients flow (the paper's Eq. 4).

The formula of `factors.joint`, which works in numpy and gives Jacobians; a test holds the two
together.
"""

from __future__ import annotations

import torch
from torch import Tensor

from factors.joint import JointKind


def joint_motion(kind: JointKind, axis: Tensor, pivot: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation and translation of the part when its state grows by q.

    Args:
        kind: one of `akm_fg`'s that the paper knows: without a pitch.
        axis: (..., 3) of any length but zero.
        pivot: (..., 3) a point of a hinge's axis, metres.
        q: (..., T) metres or radians.

    Returns:
        R (..., T, 3, 3) and t (..., T, 3): p moves to R p + t. Eq. 4: R = I and t = q a, or a
        rotation by q about a and t = (I - R) c.

    Raises:
        ValueError: a kind with a pitch.
    """
    unit = axis / torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    eye = torch.eye(3, dtype=axis.dtype)
    if kind.has_pitch:
        raise ValueError(f"joint kind {kind}, expected one without a pitch")
    if not kind.turns:
        return eye.expand(*q.shape, 3, 3), q[..., None] * unit[..., None, :]
    cross = _cross_matrix(unit)[..., None, :, :]
    angle = q[..., None, None]
    R = eye + torch.sin(angle) * cross + (1 - torch.cos(angle)) * (cross @ cross)
    return R, ((eye - R) @ pivot[..., None, :, None])[..., 0]


def _cross_matrix(v: Tensor) -> Tensor:
    """(..., 3, 3) with cross(v) @ u = v x u."""
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return torch.stack(rows, dim=-1).reshape(*v.shape[:-1], 3, 3)
