"""Static part: what does not move stays where it is, and tells the noise level.

Claim: N points, observed in T frames with known relative 3x3 covariances, do not move in world:
p_tn = x_n + s * noise, the x_n latent, s the scale on the given standard deviations. Unknown:
log_scale = log s. For the moving part this is the hypothesis that nothing moved; for the
background it measures the scale that the moving part's factors assume.

The noise is the Student-t of all observation factors, nu degrees of freedom. With the latent points
marginalised, half the squared error is, up to a constant,

    F(lambda) = 1/2 sum_tn rho(d2_tn) + 3 m lambda,    lambda = log_scale,
    d2_tn = (p_tn - x_n)^T cov_tn^-1 (p_tn - x_n) e^(-2 lambda),
    rho(d2) = (nu + 3) log(1 + d2 / nu),

with x_n at its best for that lambda. As it is, with w = rho'(d2), F' = 3 m - sum w d2.

m counts the observations less those that the latents use up: m = observations - kappa points. For
Gaussian noise kappa is 1, restricted maximum likelihood (Patterson and Thompson, Recovery of
inter-block information when block sizes are unequal, 1971). In general it is what Laplace's
approximation (Cox and Reid, Parameter orthogonality and approximate conditional inference, 1987)
takes off: 1/2 log det of the information on x_n, whose expectation under noise of scale e^lambda0
is proportional to e^(-2 lambda) h(lambda - lambda0), has the slope -3 kappa at lambda0, with

    kappa = 1 - h'/(2 h),    h'/h = (2 + 8 (nu + 2) / (nu + 7)) / (nu + 3)

from the moments of nu / (nu + d2), which is Beta(nu/2, 3/2). Measured, 40 points, nu = 6: the
log of the scale is off by -0.004 for ten observations a point, -0.02 for four, -0.08 for two; with
kappa = 1 it is 0.04, 0.10 and 0.19, which is 1.3 to 2.3 of its standard deviations.

The information is the expected one, 6 m nu / (nu + 5) (Lange, Little and Taylor, Robust statistical
modeling using the t distribution, 1989): its inverse is the variance of log_scale. It is no factor
of a graph: one number is solved for directly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.measurements.track_cost import TrackObservations, best_reference
from factors.packed import times
from factors.student_t import twice_negative_log_kernel, weight

Array = NDArray[np.float64]

# Squared steps of the latent points, in their own variances, below which they have settled. Tight:
# the scale's cost must not depend on where they started.
LATENT_TOLERANCE = 1e-8
SCALE_TOLERANCE = 1e-7  # of log_scale
LARGEST_STEP = 1.0  # of log_scale
ITERATIONS = 100
SAME_PLACE_M = 1e-9  # far below any sensor's noise: an observation repeated, not seen again
CHI2_MEDIAN = 2.366  # of three degrees of freedom


@dataclass(frozen=True, slots=True)
class StaticCost:
    """F and its derivatives at one scale, latent points at their best."""

    cost: float  # F, without the constant
    gradient: float  # F'
    information: float  # expected
    x_world: Array  # (3, N) latent points


@dataclass(frozen=True, slots=True)
class StaticScale:
    """The scale on the standard deviations under which the points most likely stood still."""

    log_scale: float
    log_scale_sd: float
    cost: float  # F there
    x_world: Array  # (3, N) where the points are


def static_part_cost(
    tracks: TrackObservations, dof: float, log_scale: float, x_world: Array
) -> StaticCost:
    """Evaluate F at one scale.

    Args:
        tracks: every point observed at least twice.
        dof: degrees of freedom of the Student-t noise.
        log_scale: log of the factor on the observations' standard deviations.
        x_world: (3, N) where to start the latent points.
    """
    information = tracks.information_world * math.exp(-2 * log_scale)
    x, _, d2 = best_reference(tracks.p_world, information, x_world, dof, 200, LATENT_TOLERANCE)
    freedom = 3.0 * _spare(tracks, dof)
    return StaticCost(
        cost=0.5 * float(twice_negative_log_kernel(d2, dof, 3).sum()) + freedom * log_scale,
        gradient=freedom - float((weight(d2, dof, 3) * d2).sum()),
        information=2 * freedom / (1 + 5 / dof),
        x_world=x,
    )


def static_scale(tracks: TrackObservations, dof: float) -> StaticScale:
    """The most likely scale and its standard deviation.

    Args:
        tracks: points of T frames; those seen less than twice say nothing and are left out.
        dof: degrees of freedom of the Student-t noise.

    Raises:
        ValueError: no point seen twice, a dof that is not positive, or observations so alike that
            the likelihood grows without bound as the scale goes to zero.
    """
    repeated = _repeated(tracks, dof)
    x = _medians(repeated)
    log_scale = _rough_log_scale(repeated, x)
    low, high = -math.inf, math.inf
    here = static_part_cost(repeated, dof, log_scale, x)
    for _ in range(ITERATIONS):
        if here.gradient > 0:
            high = log_scale
        else:
            low = log_scale
        step = -here.gradient / here.information
        new = log_scale + min(max(step, -LARGEST_STEP), LARGEST_STEP)
        if not low < new < high:  # both ends are known then
            new = (low + high) / 2
        change, log_scale = abs(new - log_scale), new
        here = static_part_cost(repeated, dof, log_scale, here.x_world)
        if change < SCALE_TOLERANCE:
            break
    return StaticScale(log_scale, here.information**-0.5, here.cost, here.x_world)


def latent_freedom(dof: float) -> float:
    """kappa: the observations that a latent point uses up, 1 for Gaussian noise."""
    return 1 - (1 + 4 * (dof + 2) / (dof + 7)) / (dof + 3)


def _spare(tracks: TrackObservations, dof: float) -> float:
    """m: observations less those that the latent points use up."""
    return float(tracks.observed.sum()) - latent_freedom(dof) * tracks.observed.shape[1]


def _repeated(tracks: TrackObservations, dof: float) -> TrackObservations:
    """The points seen at least twice, refused if they do not tell a scale."""
    if not dof > 0:
        raise ValueError(f"dof is {dof}, expected > 0")
    repeated = tracks.select(np.flatnonzero(tracks.observed.sum(axis=0) >= 2))
    if repeated.observed.size == 0:
        raise ValueError("no point is observed twice, expected at least one")
    apart = np.abs(repeated.p_world - _medians(repeated)).max(axis=1) > SAME_PLACE_M
    differing = int((apart & repeated.observed).sum())
    # As the scale goes to zero, F falls by 3 m and rises by nu + 3 an observation off its latent.
    if not differing * (dof + 3) > 3 * _spare(repeated, dof):
        raise ValueError(
            f"{differing} of {int(repeated.observed.sum())} observations differ from their "
            "point's median: too few to tell a noise level"
        )
    return repeated


def _medians(tracks: TrackObservations) -> Array:
    """Median over the frames of each point, (3, N) world."""
    seen = np.where(tracks.observed[:, None, :], tracks.p_world, np.nan)
    medians: Array = np.nanmedian(seen, axis=0)
    return medians


def _rough_log_scale(tracks: TrackObservations, x_world: Array) -> float:
    """From the median squared error of the observations off their point's median."""
    e = tracks.p_world - x_world
    d2 = (e * times(tracks.information_world, e)).sum(axis=1)[tracks.observed]
    return 0.5 * math.log(float(np.median(d2[d2 > 0])) / CHI2_MEDIAN)
