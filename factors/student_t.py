"""The heavy-tailed noise of all observation factors: a multivariate Student-t.

For a p-dimensional error with squared Mahalanobis length d2 = e^T cov^-1 e and `dof` degrees of
freedom nu, the density is (Kotz and Nadarajah, Multivariate t Distributions, 2004, eq. 1.1)

    p(e) = Gamma((nu + p)/2) / (Gamma(nu/2) (nu pi)^(p/2) |cov|^(1/2)) (1 + d2/nu)^(-(nu + p)/2).

`cov` is the scale matrix; the covariance is larger by nu / (nu - 2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def twice_negative_log_kernel(d2: Array, dof: float, dim: int) -> Array:
    """-2 log of the density without its normaliser; zero at the mode, d2 for infinite dof."""
    return (dof + dim) * np.log1p(d2 / dof)


def weight(d2: Array, dof: float, dim: int) -> Array:
    """Derivative of `twice_negative_log_kernel` by d2: the weight of iterated least squares."""
    return (dof + dim) / (dof + d2)


def log_normaliser(dof: float, dim: int) -> float:
    """Log of the density at its mode for a unit scale matrix."""
    return math.lgamma((dof + dim) / 2) - math.lgamma(dof / 2) - dim / 2 * math.log(dof * math.pi)


def covariance_factor(d2: Array, dof: float, dim: int, freedom: float = 1.0) -> float:
    """True covariance of the estimate over the inverse of its weighted Gauss-Newton information.

    The covariance of an M-estimator is K^2 b / a^2 times the inverse information of unit weights,
    where a is the mean slope of the influence function, b its mean square, corrected for the
    numbers fitted, and K - 1 the share of fitted numbers times the relative variance of the slope
    (Huber and Ronchetti, Robust Statistics, 2009, sec. 7.6, eqs. 7.81 to 7.83); the weighted
    information is the mean weight times that of unit weights. Measured on the residuals, so it
    holds whether or not the noise is really Student-t.

    Args:
        d2: (n,) squared whitened residuals, those that the information was weighted by.
        dof: degrees of freedom of the kernel.
        dim: dimension of one error.
        freedom: share of the errors' squares that the fit has left in the residuals.
    """
    across = weight(d2, dof, dim)  # slope of the influence function across the error,
    along = across - 2 * d2 * (dof + dim) / (dof + d2) ** 2  # and along it
    slope = np.mean((dim - 1) * across + along) / dim
    variance = np.mean((dim - 1) * across**2 + along**2) / dim - slope**2
    K = 1 + (1 - freedom) * variance / slope**2
    power = np.mean(across**2 * d2) / (dim * freedom)
    return float(K**2 * power * np.mean(across) / slope**2)
