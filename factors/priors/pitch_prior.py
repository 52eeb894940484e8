"""Pitch prior: how far a helical joint usually slides for every radian it turns.

Claim: pitch ~ N(0, sigma^2), in metres per radian. Among furniture's joints, screws of large pitch
are rare, and a pitch of zero is a hinge; without a proper prior, the extra freedom would make the
helical kind's evidence undefined. Variable: pitch (double). Error (1,), dimensionless:

    e = pitch / sigma,    d e / d pitch = 1 / sigma.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor

Array = NDArray[np.float64]


def pitch_prior_residual(pitch: float, sigma_m_per_rad: float) -> tuple[float, float]:
    """The error and its derivative by the pitch (metres per radian)."""
    return pitch / sigma_m_per_rad, 1.0 / sigma_m_per_rad


def pitch_log_density(pitch: float, sigma_m_per_rad: float) -> float:
    """Log of the normalised prior density at a pitch, both in metres per radian.

    Raises:
        ValueError: a sigma that is not positive and finite.
    """
    _check(sigma_m_per_rad)
    e, _ = pitch_prior_residual(pitch, sigma_m_per_rad)
    return -0.5 * e * e - math.log(sigma_m_per_rad) - 0.5 * math.log(2 * math.pi)


def pitch_prior_factor(pitch_key: int, sigma_m_per_rad: float) -> gtsam.CustomFactor:
    """The factor over the pitch.

    Args:
        pitch_key: key of the pitch (double), metres per radian.
        sigma_m_per_rad: standard deviation of the prior.

    Raises:
        ValueError: a sigma that is not positive and finite.
    """
    _check(sigma_m_per_rad)

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        e, J = pitch_prior_residual(values.atDouble(pitch_key), sigma_m_per_rad)
        return np.array([e]), [np.array([[J]])] if want_jacobians else None

    return make_factor(residual, {pitch_key: 1}, gtsam.noiseModel.Unit.Create(1))


def _check(sigma_m_per_rad: float) -> None:
    if not 0 < sigma_m_per_rad < math.inf:
        raise ValueError(f"sigma_m_per_rad is {sigma_m_per_rad}, expected > 0 and finite")
