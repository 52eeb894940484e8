"""The cost of point tracks at one joint and one set of states.

See `factors.measurements.point_track`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.joint import Joint
from factors.measurements.lasting_errors import LastingModes, Marginal, best_latents
from factors.packed import (
    COL,
    ROW,
    inverse_and_determinant,
    multiples_of_identity,
    rotated,
    squared_length,
    times,
)
from factors.student_t import twice_negative_log_kernel, weight

Array = NDArray[np.float64]

ITERATIONS = 20
TOLERANCE = 5e-3  # squared step in a latent point's own deviations


@dataclass(frozen=True, slots=True)
class TrackObservations:
    """Observed points in the layout the factor works in."""

    p_world: Array  # (T, 3, N) metres; 0 where not observed
    information_world: Array  # (T, 6 or 1, N) inverse covariance, packed; 0 where not observed
    observed: NDArray[np.bool_]  # (T, N)
    log_det_cov: float  # sum over the observed of log |cov|
    lasting: LastingModes | None = None  # errors beside those of the covariances, world axes

    @staticmethod
    def from_points(
        p_world: Array, cov_world: Array, lasting: LastingModes | None = None
    ) -> TrackObservations:
        """Pack points (T, N, 3), NaN where lost, with covariances (T, N, 3, 3) in m^2.

        Args:
            p_world: the points.
            cov_world: of what is off anew in every frame.
            lasting: what is off alike in all of them.

        Raises:
            ValueError: shapes that do not match, or a covariance that is not positive definite.
        """
        if p_world.ndim != 3 or p_world.shape[2] != 3 or cov_world.shape != (*p_world.shape, 3):
            raise ValueError(
                f"points {p_world.shape} and covariances {cov_world.shape}, "
                "expected (T, N, 3) and (T, N, 3, 3)"
            )
        finite = np.isfinite(p_world)
        observed: NDArray[np.bool_] = finite[..., 0] & finite[..., 1] & finite[..., 2]
        packed = np.empty((6, *observed.shape))
        for k, (i, j) in enumerate(zip(ROW, COL, strict=True)):
            packed[k] = cov_world[..., i, j]
        points = p_world
        if not observed.all():
            packed = np.where(observed, packed, np.eye(3)[ROW, COL][:, None, None])
            points = np.where(observed[..., None], p_world, 0.0)
        if not np.isfinite(packed).all():
            raise ValueError("a covariance of an observed point is not finite")
        minors = [packed[0], packed[0] * packed[3] - packed[1] * packed[1]]
        if lasting is None and multiples_of_identity(packed):
            packed = packed[:1]
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse, determinant = inverse_and_determinant(packed)
        if not all((minor > 0).all() for minor in (*minors, determinant)):  # Sylvester's criterion
            raise ValueError("a covariance is not positive definite")
        return TrackObservations(
            p_world=np.ascontiguousarray(points.swapaxes(1, 2)),
            information_world=np.ascontiguousarray((inverse * observed).swapaxes(0, 1)),
            observed=observed,
            log_det_cov=float(np.log(determinant).sum()),
            lasting=lasting,
        )

    def select(self, tracks: NDArray) -> TrackObservations:
        """The tracks with these indices; `log_det_cov` is not theirs and NaN."""
        return TrackObservations(
            self.p_world[:, :, tracks],
            self.information_world[:, :, tracks],
            self.observed[:, tracks],
            float("nan"),
            None if self.lasting is None else self.lasting.select(tracks),
        )

    def at(self, frames: NDArray[np.int_]) -> TrackObservations:
        """The frames with these indices; `log_det_cov` stays that of all."""
        return TrackObservations(
            self.p_world[frames],
            self.information_world[frames],
            self.observed[frames],
            self.log_det_cov,
            None if self.lasting is None else self.lasting.at(frames),
        )


@dataclass(frozen=True, slots=True)
class TrackCost:
    """The cost of all tracks at one joint and one set of states, latent points at their best."""

    twice_cost: float
    d2: Array  # (T, N) squared whitened errors; 0 where not observed
    x_joint: Array  # (3, N) latent reference points, joint frame
    log_det_latent: float  # sum of log |information of x_n, and of what lasts|
    z_joint: Array  # (T, 3, N) reference coordinates, less what lasts
    information: Array  # (T, 6 or 1, N) weighted, packed, in reference coordinates
    lasting: Marginal | None = None  # of errors that last, in reference coordinates


def track_cost(
    joint: Joint,
    q: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
) -> TrackCost:
    """Evaluate the tracks' cost.

    Args:
        joint: the joint.
        q: (T,) states.
        tracks: the observations.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        x_start: (3, N) where to start the latent points; their medians over the frames if None.
    """
    z, information, modes = taken_back(joint, q, tracks)
    x = first_reference(z, tracks.observed) if x_start is None else x_start
    return cost_at(z, information / scale**2, x, dof, modes)


def cost_at(
    z: Array, information: Array, x: Array, dof: float, modes: LastingModes | None
) -> TrackCost:
    """The cost of points (T, 3, N) in the reference pose, of `information` there.

    Args:
        z: reference coordinates.
        information: (T, 6 or 1, N) packed, noise scale included.
        x: (3, N) where to start the latent points.
        dof: degrees of freedom of the Student-t kernel.
        modes: what lasts, in the axes of z.
    """
    if modes is None:
        x, weighted, d2 = best_reference(z, information, x, dof)
        lasting, twice, log_det = None, 0.0, 0.0
    else:
        z, x, amount = _with_what_lasts(z, information, x, dof, modes)
        d2 = squared_length(information, z - x)
        weighted = information * weight(d2, dof, 3)[:, None, :]
        lasting = Marginal.of(modes, amount, weighted[..., modes.tracks])
        twice, log_det = float(((amount / modes.sd) ** 2).sum()), lasting.log_det
    return TrackCost(
        twice_cost=float(twice_negative_log_kernel(d2, dof, 3).sum()) + twice,
        d2=d2,
        x_joint=x,
        log_det_latent=float(np.log(inverse_and_determinant(weighted.sum(axis=0))[1]).sum())
        + log_det,
        z_joint=z,
        information=weighted,
        lasting=lasting,
    )


def _with_what_lasts(
    z: Array, information: Array, x: Array, dof: float, modes: LastingModes
) -> tuple[Array, Array, Array]:
    """Points less what their tracks are off, latent points, and the amounts (M, L)."""
    some = modes.tracks
    others = np.setdiff1d(np.arange(x.shape[1]), some)
    x = x.copy()
    if others.size:
        found = best_reference(z[..., others], information[..., others], x[:, others], dof)
        x[:, others] = found[0]
    x[:, some], amount = best_latents(
        z[..., some], information[..., some], x[:, some], modes, dof, ITERATIONS, TOLERANCE
    )
    return modes.without(z, amount), x, amount


def taken_back(
    joint: Joint, q: Array, tracks: TrackObservations
) -> tuple[Array, Array, LastingModes | None]:
    """Reference coordinates (T, 3, N) of the observations; their information there, what lasts."""
    z = joint.reference_coordinates(q, tracks.p_world)
    information, modes = tracks.information_world, tracks.lasting
    if information.shape[1] > 1:
        rotation = joint.R_world_joint @ joint.displacement(q)[0]
        information = rotated(information, rotation)
        modes = None if modes is None else modes.turned(rotation)
    return z, information, modes


def first_reference(z: Array, observed: NDArray[np.bool_]) -> Array:
    """Median over the frames of each point's reference coordinates, (3, N)."""
    growing = np.sort(np.where(observed[:, None, :], z, np.inf), axis=0)  # the unseen come last
    count = observed.sum(axis=0)
    middle = np.stack([(count - 1) // 2, count // 2])[:, None, :]
    lower, upper = np.take_along_axis(growing, middle, axis=0)
    return np.asarray(0.5 * (lower + upper))


def rough_track_cost(joint: Joint, q: Array, tracks: TrackObservations) -> Array:
    """Squared whitened errors (M,) of the M observations, latent points at their medians.

    For comparing starts: cheap, and not for sale to outliers when a median is taken of it.
    """
    z, information, _ = taken_back(joint, q, tracks)
    z -= first_reference(z, tracks.observed)
    return squared_length(information, z)[tracks.observed]


def best_reference(
    z: Array,
    information: Array,
    x: Array,
    dof: float,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
) -> tuple[Array, Array, Array]:
    """Minimise each point's robust cost over its reference; x, weighted information, d2."""
    x = x.copy()
    active: slice | NDArray[np.int_] = slice(None)
    z_active, information_active = z, information
    for _ in range(iterations):
        e = z_active - x[:, active]
        w = weight(squared_length(information_active, e), dof, 3)[:, None, :]
        weighted = information_active * w
        pull = times(weighted, e).sum(axis=0)
        step = times(inverse_and_determinant(weighted.sum(axis=0))[0][None], pull[None])[0]
        x[:, active] += step
        # A step's squared length in units of the reference's own standard deviation.
        moving = (step * pull).sum(axis=0) > tolerance
        count = np.count_nonzero(moving)
        if count == 0:
            break
        if count < 0.7 * moving.size:  # points settle at their own pace
            active = np.flatnonzero(moving) if isinstance(active, slice) else active[moving]
            z_active, information_active = z[:, :, active], information[:, :, active]
    d2 = squared_length(information, z - x)
    return x, information * weight(d2, dof, 3)[:, None, :], d2
