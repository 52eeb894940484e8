"""Errors of tracks that last: the same in every frame, so that no number of frames averages them.

A point that slips along an edge, or lies elsewhere on its ray than the patch that is followed, is
off in frame t by s_tm a_m: a known vector for each way m of being off, and one latent number of the
track, a_m ~ N(0, b_m^2). Beside the latent reference point x_n of a track (`point_track`) its a_n
are latent, too:

    e_tn = z_tn - x_n - sum_m s_tnm a_nm,    cost = 1/2 sum rho(e^T Lambda e) + 1/2 |a_n / b_n|^2.

With W the weighted information, A = sum_t W, V_m = sum_t W s_m and K = diag(1 / b^2) + sum_t
s^T W s, what is left of a_n once x_n is marginalised has the information K' = K - V^T A^-1 V; x_n
goes as without it, and a_n after it (block elimination: Boyd and Vandenberghe, Convex Optimization,
2004, A.5.5). What does not change in the part's own frame is no error of the motion: x_n takes it
up, and K' is diag(1 / b^2). All of it concerns the few tracks for which it matters alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from factors.packed import inverse_and_determinant, squared_length, times
from factors.student_t import weight

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LastingModes:
    """The ways in which L of the N tracks may be off alike in all T frames, M each."""

    tracks: NDArray[np.int_]  # (L,) growing
    vectors: Array  # (M, T, 3, L) s, metres; 0 where not observed
    sd: Array  # (M, L) b

    def at(self, frames: NDArray[np.int_]) -> LastingModes:
        """In the frames with these indices."""
        return replace(self, vectors=self.vectors[:, frames])

    def select(self, tracks: NDArray[np.int_]) -> LastingModes | None:
        """Of the tracks with these indices (growing), numbered anew; None where there is none."""
        _, new, old = np.intersect1d(tracks, self.tracks, return_indices=True)
        return LastingModes(new, self.vectors[..., old], self.sd[:, old]) if new.size else None

    def turned(self, rotation: Array) -> LastingModes:
        """R_t^T s of every frame, rotations (T, 3, 3)."""
        return replace(self, vectors=rotation.transpose(0, 2, 1) @ self.vectors)

    def off(self, amount: Array) -> Array:
        """(T, 3, L) metres, by which the tracks are off; amounts (M, L)."""
        return np.asarray(np.einsum("mtil,ml->til", self.vectors, amount))

    def without(self, z: Array, amount: Array) -> Array:
        """Points (T, 3, N) less what their tracks are off."""
        z = z.copy()
        z[..., self.tracks] -= self.off(amount)
        return z


@dataclass(frozen=True, slots=True)
class Slips:
    """Errors that last, at their best."""

    tracks: NDArray[np.int_]  # (L,)
    amount: Array  # (M, L)


@dataclass(frozen=True, slots=True)
class Marginal:
    """The information on a of L tracks at some amounts, latent points marginalised."""

    modes: LastingModes
    amount: Array  # (M, L) a
    weighted: Array  # (M, T, 3, L) W s
    coupling: Array  # (M, 3, L) A^-1 V
    information: Array  # (L, M, M) K'

    @staticmethod
    def of(modes: LastingModes, amount: Array, W: Array) -> Marginal:
        """Of weighted information (T, 6, L) on the tracks of the modes, at amounts (M, L)."""
        s = modes.vectors
        weighted = np.stack([times(W, each) for each in s])
        V = weighted.sum(axis=1)
        coupling = times(inverse_and_determinant(W.sum(axis=0))[0][None], V)
        K = np.einsum("mtil,ktil->lmk", s, weighted)
        K += np.eye(len(s)) / modes.sd.T[:, None] ** 2
        return Marginal(
            modes, amount, weighted, coupling, K - np.einsum("mil,kil->lmk", coupling, V)
        )

    @property
    def slips(self) -> Slips:
        """The amounts, and whose they are."""
        return Slips(self.modes.tracks, self.amount)

    @property
    def log_det(self) -> float:
        """Sum over the tracks of log |diag(b) K' diag(b)|."""
        log_K = np.linalg.slogdet(self.information)[1].sum()
        return float(log_K + 2 * np.log(self.modes.sd).sum())

    def by_twists(self, G: Array) -> Array:
        """G^T W s of every frame (T, 6, M, L), from the twist Jacobians (3, 6, N) of all tracks."""
        return np.einsum("mtil,ijl->tjml", self.weighted, G[..., self.modes.tracks])

    def pull(self, e: Array) -> Array:
        """(M, L) what is left of a's own gradient, at errors (T, 3, L)."""
        return np.einsum("mtil,til->ml", self.weighted, e) - self.amount / self.modes.sd**2

    def left(self, rows: Array, rows_of_points: Array) -> Array:
        """What is left of rows (D, M, L) on a, those on the latent points (D, 3, L) taken out."""
        return rows - np.einsum("mil,dil->dml", self.coupling, rows_of_points)

    def taken(self, rows: Array) -> Array:
        """(D, D) what marginalising a takes from an information, rows (D, M, L) from `left`."""
        columns = rows.transpose(2, 1, 0)  # (L, M, D)
        held = np.linalg.solve(self.information, columns)
        d = len(rows)
        return np.asarray(columns.reshape(-1, d).T @ held.reshape(-1, d))


def best_latents(
    z: Array,
    information: Array,
    x: Array,
    modes: LastingModes,
    dof: float,
    iterations: int,
    tolerance: float,
) -> tuple[Array, Array]:
    """Reference points (3, L) and amounts (M, L) that minimise the tracks' own robust costs.

    Args:
        z: (T, 3, L) reference coordinates.
        information: (T, 6, L) packed.
        x: (3, L) where to start.
        modes: of these L tracks, in the axes of z.
        dof: degrees of freedom of the Student-t kernel.
        iterations: at most so many.
        tolerance: squared length of a step, in their own deviations, that is the last.
    """
    a = np.zeros((len(modes.vectors), x.shape[1]))
    for _ in range(iterations):
        e = z - x - modes.off(a)
        W = information * weight(squared_length(information, e), dof, 3)[:, None, :]
        marginal = Marginal.of(modes, a, W)
        pull = times(W, e).sum(axis=0)
        pull_a = marginal.pull(e)
        alone = marginal.left(pull_a[None], pull[None])[0]
        step_a = np.linalg.solve(marginal.information, alone.T[..., None])[..., 0].T
        held = times(inverse_and_determinant(W.sum(axis=0))[0][None], pull[None])[0]
        step = held - np.einsum("mil,ml->il", marginal.coupling, step_a)
        x, a = x + step, a + step_a
        if not ((step * pull).sum(axis=0) + (step_a * pull_a).sum(axis=0) > tolerance).any():
            break
    return x, a
