"""Scale and bias of a camera's depth, from the one thing whose place is known: the robot.

A depth camera is off by a per cent or two of what it measures (the D455's data sheet: 2 %), which
no board in its colour picture shows and no number of frames averages away: at a metre, a
centimetre. Where it sees the arm, what it should measure is known from joint angles and meshes to
a millimetre or two. In cells of pixels, with x where the ray (u, v, 1) z meets the surface with
normal n, the depth that is expected less the one that is measured is to first order

    z_expected - z = s z + b + (n . (w x x + t + J dq) - f z n . (u, v, 0)) / n . (u, v, 1) + l

with depth's scale s and bias b, the camera's place off by (w, t), its focal length by f (relative),
the joints' zeros by dq (J: how the point goes with the joints), and the link's mesh by l. All of
them are Gaussian and small, so this is linear least squares with a prior (Bayes' rule for linear
Gaussian models, e.g. Barfoot, State Estimation for Robotics, 2017, section 3.3); s and b are what
is kept of it. Cells on which something else is seen are left out (Tukey's biweight).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.arm.body.description import ArmDescription
from akm_fg.arm.body.model import N_ARM
from akm_fg.arm.body.surface import ArmSurface, SeenSurface
from akm_fg.records import BoolArray, CalibrationErrors, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class DepthFromArmConfig:
    """Where the arm is compared, and what is not known of it."""

    use: bool = True  # or leave the camera's depth as it is
    # Pictures whose depth is averaged: the noise of one moves what a metre is by half a millimetre
    # from one session to the next, and a model that another session made would be off by as much.
    frames: int = 8
    inner_px: int = 5  # from the outline of each link: depth is mixed there, and edges are off
    cell_px: int = 16  # side of a cell; a stereo camera's depth errs alike within its window
    least_in_cell: int = 60  # pixels
    least_cells: int = 12
    # What is measured farther from the arm is something else: four deviations of 1 % at a metre,
    # and what the noise adds.
    gate_m: float = 0.06
    grazing_rad: float = 1.05  # between look and normal: beyond, a small shift is a large depth
    joint_sd_rad: float = float(np.radians(0.05))  # of a joint's zero: a millimetre at the hand
    mesh_sd_m: float = 1e-3  # of each link's drawn surface: covers, stickers, paint
    # Of a cell, whatever the residuals say: what differs from cell to cell and stays from frame to
    # frame is not known better, and who trusts it more takes the noise of a session for the arm's.
    least_sd_m: float = 1.5e-3
    tukey: float = 4.685  # deviations: 95 % efficient for Gaussian noise (Beaton and Tukey, 1974)
    rounds: int = 15
    most_sigmas: float = 4.0  # of the prior: a scale that is farther off is a mistake


@dataclass(frozen=True, slots=True)
class DepthCorrection:
    """A true depth is (1 + scale) times the one measured, plus the bias."""

    scale: float
    bias_m: float
    cov: FloatArray  # (2, 2) of both
    cells: int  # from how many cells of pixels

    def corrected(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame with the depth that it should have."""
        depth = (1.0 + self.scale) * frame.depth_m + self.bias_m
        return replace(frame, depth_m=depth.astype(np.float32))

    def words(self) -> str:
        """In one line."""
        scale_sd = float(np.sqrt(self.cov[0, 0]))
        return (
            f"where the camera sees the arm, its depth is {100 * self.scale:+.1f} % off "
            f"(give or take {100 * scale_sd:.1f}): corrected"
        )

    def left(self, errors: CalibrationErrors) -> CalibrationErrors:
        """What is not known of the camera any more, once its depth is corrected.

        Scale and bias are left as if they were independent; they are not (the depth at the arm is
        known best), so that what is said is more than what there is.
        """
        scale_sd, bias_sd_m = np.sqrt(np.diag(self.cov)).tolist()
        return replace(errors, depth_scale_sd=scale_sd, depth_bias_sd_m=bias_sd_m)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Means over cells of pixels, (N,) and (N, 3)."""

    z: FloatArray
    expected: FloatArray
    ray: FloatArray  # (u, v, 1)
    normal: FloatArray
    link: NDArray[np.int64]


class MeasuringCamera(Protocol):
    """A camera that tells what it measures, and takes a correction."""

    def measured(self) -> RgbdFrame:
        """The scene now, the robot in it, depth as it is measured."""
        ...

    def correct_depth(self, correction: DepthCorrection) -> None:
        """From now on, what is captured is corrected so."""
        ...


def correct_by_arm(
    camera: MeasuringCamera,
    description: ArmDescription,
    q: FloatArray,
    fingers_m: float,
    errors: CalibrationErrors,
    config: DepthFromArmConfig,
) -> DepthCorrection | None:
    """Correct a camera's depth by an arm that stands still in its view; see `depth_from_arm`.

    Raises:
        CameraFailed: no picture comes.
        InputError: the arm's meshes cannot be read.
    """
    if not config.use:
        return None
    frames = [camera.measured() for _ in range(config.frames)]
    correction = depth_from_arm(frames, ArmSurface(description), q, fingers_m, errors, config)
    if correction is not None:
        camera.correct_depth(correction)
    return correction


def depth_from_arm(
    frames: Sequence[RgbdFrame],
    surface: ArmSurface,
    q: FloatArray,
    fingers_m: float,
    errors: CalibrationErrors,
    config: DepthFromArmConfig | None = None,
) -> DepthCorrection | None:
    """How depth is off, from frames that show the arm at rest.

    Args:
        frames: with the robot's own depth in it, undistorted; `config.frames` of them are enough.
        surface: of the robot.
        q: joint angles (7,) when they were taken, rad.
        fingers_m: travel of either finger then.
        errors: what is not known of the camera beforehand.
        config: tuning.

    Returns:
        None where it is not wanted or depth does not err, where too little of the arm is seen, or
        what is seen cannot be the arm.
    """
    config = config or DepthFromArmConfig()
    if not config.use or not errors.depth_scale_sd > 0.0:
        return None
    frame = _mean(frames)
    seen = surface.seen(q, fingers_m, frame.camera, frame.T_world_cam)
    cells = _cells(frame, seen, config)
    if len(cells.z) < config.least_cells:
        return None
    A, prior = _linear(cells, surface, frame.T_world_cam, frame.camera.fx, errors, config)
    fitted = _least_squares(A, cells.expected - cells.z, prior, config)
    if fitted is None:
        return None
    mean, cov, used = fitted
    if abs(mean[0]) > config.most_sigmas * errors.depth_scale_sd:
        return None
    return DepthCorrection(float(mean[0]), float(mean[1]), cov[:2, :2], used)


def _mean(frames: Sequence[RgbdFrame]) -> RgbdFrame:
    """The first, with the mean of what depth all of them have; NaN where one has none."""
    if len(frames) == 1:
        return frames[0]
    depth = np.mean([frame.depth_m for frame in frames], axis=0)
    return replace(frames[0], depth_m=depth.astype(np.float32))


def _cells(frame: RgbdFrame, seen: SeenSurface, config: DepthFromArmConfig) -> _Cells:
    camera, depth = frame.camera, np.asarray(frame.depth_m, dtype=float)
    v, u = np.mgrid[: camera.height, : camera.width]
    ray = np.dstack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)])
    facing = -np.einsum("hwi,hwi->hw", seen.normal_cam, ray) / np.linalg.norm(ray, axis=2)
    good = _inside(seen.link, config.inner_px) & (facing > np.cos(config.grazing_rad))
    good &= np.abs(depth - seen.depth_m) < config.gate_m  # NaN compares False
    columns = -(-camera.width // config.cell_px)
    cell = (v // config.cell_px) * columns + u // config.cell_px
    # A cell is of one link: its number goes with the cell's.
    key = (cell * (seen.link.max() + 1) + seen.link)[good]
    found, at, count = np.unique(key, return_inverse=True, return_counts=True)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(at, values[good], len(found)) / np.maximum(count, 1))

    many = count >= config.least_in_cell
    link = np.zeros(len(found), dtype=np.int64)
    link[at] = seen.link[good]
    rays, normals = (
        np.column_stack([mean(field[..., i]) for i in range(3)])[many]
        for field in (ray, seen.normal_cam)
    )
    expected = np.where(np.isfinite(seen.depth_m), seen.depth_m, 0.0).astype(float)
    return _Cells(mean(depth)[many], mean(expected)[many], rays, normals, link[many])


def _inside(link: NDArray[np.int64], inner_px: int) -> BoolArray:
    """(H, W) so far within what shows one link."""
    side = np.ones((2 * inner_px + 1,) * 2, dtype=np.uint8)
    inside = np.zeros(link.shape, dtype=bool)
    for k in np.unique(link[link >= 0]):
        inside |= cv2.erode((link == k).astype(np.uint8), side, borderValue=0) > 0
    return inside


def _linear(
    cells: _Cells,
    surface: ArmSurface,
    T_world_cam: gtsam.Pose3,
    fx_px: float,
    errors: CalibrationErrors,
    config: DepthFromArmConfig,
) -> tuple[FloatArray, FloatArray]:
    """The rows (N, K) of the module's formula, and the prior's covariance (K, K)."""
    n, x = cells.normal, cells.expected[:, None] * cells.ray
    along = np.einsum("ni,ni->n", n, cells.ray)
    R = T_world_cam.rotation().matrix()
    p_world = x @ R.T + T_world_cam.translation()
    turned_cam = np.einsum("ji,njk->nik", R, surface.turned_by(p_world, cells.link))
    slant = -cells.expected * np.einsum("ni,ni->n", n[:, :2], cells.ray[:, :2]) / along
    links = np.unique(cells.link)
    A = np.column_stack(
        [
            cells.z,
            np.ones(len(cells.z)),
            np.cross(x, n) / along[:, None],  # n . (w x x) is w . (x x n)
            n / along[:, None],
            slant,
            np.einsum("ni,nik->nk", n, turned_cam) / along[:, None],
            (cells.link[:, None] == links).astype(float),
        ]
    )
    prior = np.zeros((A.shape[1],) * 2)
    prior[0, 0], prior[1, 1] = errors.depth_scale_sd**2, errors.depth_bias_sd_m**2
    prior[2:8, 2:8] = errors.cov_world_cam
    prior[8, 8] = errors.focal_sd**2
    if errors.cov_intrinsics is not None:
        prior[8, 8] += errors.cov_intrinsics[0, 0] / fx_px**2
    rest = np.arange(9, len(prior))
    prior[rest, rest] = [config.joint_sd_rad**2] * N_ARM + [config.mesh_sd_m**2] * len(links)
    return A, prior


def _least_squares(
    A: FloatArray, y: FloatArray, prior: FloatArray, config: DepthFromArmConfig
) -> tuple[FloatArray, FloatArray, int] | None:
    """Mean (K,), covariance (K, K), and the rows that counted; None: too few did.

    The prior's covariance may be singular, so it is never inverted: with it P, the rows' weights
    on the diagonal of W and I the identity, the posterior's covariance is (I + P A' W A)^-1 P.
    """
    weights, mean = np.ones(len(y)), np.zeros(len(prior))
    cov: FloatArray = prior
    for _ in range(config.rounds):
        off = y - A @ mean
        kept = weights > 0.0
        if int(kept.sum()) < config.least_cells:
            return None
        middle = np.median(off[kept])
        sd = max(1.4826 * float(np.median(np.abs(off[kept] - middle))), config.least_sd_m)
        weighted = A.T * (weights / sd**2)
        cov = np.asarray(np.linalg.solve(np.eye(len(prior)) + prior @ weighted @ A, prior))
        mean = cov @ weighted @ y
        share = (y - A @ mean) / (config.tukey * sd)
        weights = np.where(np.abs(share) < 1.0, (1.0 - share**2) ** 2, 0.0)
    return mean, (cov + cov.T) / 2.0, int((weights > 0.0).sum())
