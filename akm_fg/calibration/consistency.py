"""Do the robot's poses belong to the images? Before anything is fitted, and by geometry alone.

With B_i = T_cam_board of each image and H_i = T_mount_holder as reported,

    H_i T_holder_board = T_mount_cam B_i.

Rotations: of two views, R_ij = R_i^T R_j of H is that of B turned by R_holder_board, and so are the
rotation vectors (Park and Martin, Robot sensor calibration, 1994). Translations are linear beside
it, with the scale of the board as a seventh unknown: a wrong size of its squares, or poses in
millimetres, show there and not as poses that do not belong. Few views (RANSAC) give a solution, by
which the others are judged. Where most do not agree, the usual slips are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.calibration.initial import ViewsAlone, median_error_px, reported_mount_holder
from akm_fg.calibration.records import CalibrationConfig, CalibrationViews, LeftOut
from akm_fg.errors import InputError
from akm_fg.records import BoolArray, FloatArray

SAMPLE = 3  # views that make a solution
SAMPLES = 200  # tried: with a third of the views wrong, all fail with a chance of 1e-30
ROUNDS = 5  # of solving again with all that agree
LEAST = 4  # views that must agree, or all
MILLI = (700.0, 1300.0)  # scales of the board that say millimetres
EXPECTED = "T_world_gripper of each image: from the gripper's axes to the robot's base, metres"


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Reported poses beside board poses, as arrays."""

    R_mount_holder: FloatArray  # (V, 3, 3)
    t_mount_holder: FloatArray  # (V, 3)
    R_cam_board: FloatArray  # (V, 3, 3)
    t_cam_board: FloatArray  # (V, 3)
    corners: tuple[tuple[FloatArray, FloatArray], ...]  # each on the board (N, 3) m, seen (N, 2)

    def chosen(self, which: np.ndarray) -> _Pairs:
        """Of some of the views."""
        return _Pairs(
            self.R_mount_holder[which],
            self.t_mount_holder[which],
            self.R_cam_board[which],
            self.t_cam_board[which],
            tuple(self.corners[i] for i in which),
        )


@dataclass(frozen=True, slots=True)
class _Agreement:
    """What fits together."""

    off_px: FloatArray  # (V,) of the median corner, from where the solution has it
    scale: float  # of the board's translations
    share: float  # of the views that agree
    enough: bool


def agreeing_views(
    data: CalibrationViews, config: CalibrationConfig, alone: ViewsAlone
) -> tuple[BoolArray, tuple[LeftOut, ...], tuple[str, ...]]:
    """Which views agree with each other, those that do not, and what is to be said of these.

    Raises:
        InputError: most do not agree; the likely cause is named where a slip explains it.
    """
    pairs = _pairs(reported_mount_holder(data, config), alone, data, np.arange(len(data.views)))
    limit_px = config.checks.agreeing_share * data.camera.width
    found = _agreement(pairs, alone.fx, limit_px)
    if found.enough and MILLI[0] < found.scale < MILLI[1]:
        raise InputError(data.name, "T_world_gripper is likely in millimetres", EXPECTED)
    if not found.enough:
        error, is_slip = _explained(data, config, alone, found, limit_px)
        far_px = config.checks.apart_share * data.camera.width
        if is_slip or median_error_px(data, config, alone) > far_px:
            raise error
        # Corners gone astray, or few views: the fit is robust, and its result is judged.
        return np.ones(len(data.views), dtype=bool), (), ()
    kept = np.asarray(found.off_px < limit_px)
    out = [LeftOut(data.views[i].frame, float(found.off_px[i])) for i in np.flatnonzero(~kept)]
    return kept, tuple(out), _words(data, alone.fx, pairs, kept, out, limit_px)


def _pairs(
    reported: Sequence[gtsam.Pose3],
    alone: ViewsAlone,
    data: CalibrationViews,
    images: np.ndarray,
) -> _Pairs:
    """Reported poses beside what some images show, in their order."""
    boards = [alone.T_cam_boards[i] for i in images]
    R_h, R_b = (np.array([T.rotation().matrix() for T in Ts]) for Ts in (reported, boards))
    t_h, t_b = (np.array([T.translation() for T in Ts]) for Ts in (reported, boards))
    p_boards = data.p_boards
    seen = [(p_boards[i], alone.rays(data.views[i].uv)) for i in images]
    return _Pairs(R_h, t_h, R_b, t_b, tuple(seen))


def _agreement(pairs: _Pairs, fx: float, limit_px: float) -> _Agreement:
    n, rng = len(pairs.t_cam_board), np.random.default_rng(0)
    best: tuple[FloatArray, float] | None = None
    for _ in range(SAMPLES if n > SAMPLE else 1):
        some = rng.choice(n, SAMPLE, replace=False) if n > SAMPLE else np.arange(n)
        off, scale = _judged(pairs, some, fx)
        if best is None or _rank(off, limit_px) > _rank(best[0], limit_px):
            best = off, scale
    assert best is not None
    for _ in range(ROUNDS):
        which = np.flatnonzero(best[0] < limit_px)
        if which.size < SAMPLE:
            break
        off, scale = _judged(pairs, which, fx)
        if _rank(off, limit_px) < _rank(best[0], limit_px):
            break
        best = off, scale
    agree = int((best[0] < limit_px).sum())
    needed = min(n, max(LEAST, int(np.ceil(0.5 * n))))
    return _Agreement(best[0], best[1], agree / n, agree >= needed)


def _rank(off_px: FloatArray, limit_px: float) -> tuple[int, float]:
    """More views that agree, then agreeing better."""
    near = off_px < limit_px
    return int(near.sum()), -float(off_px[near].sum())


def _judged(pairs: _Pairs, which: np.ndarray, fx: float) -> tuple[FloatArray, float]:
    """How far all views (V,) are from what some of them say, in pixels; and the board's scale."""
    some = pairs.chosen(which)
    i, j = np.triu_indices(which.size, 1)
    a = _rotation_vectors(some.R_mount_holder[i], some.R_mount_holder[j])
    b = _rotation_vectors(some.R_cam_board[i], some.R_cam_board[j])
    R_holder_board = _nearest_rotation(a.T @ b)
    turned = some.R_mount_holder @ R_holder_board @ np.swapaxes(some.R_cam_board, 1, 2)
    R_cam_mount = _nearest_rotation(turned.sum(axis=0)).T
    A = np.zeros((which.size, 3, 7))
    A[:, :, 0] = some.t_cam_board
    A[:, :, 1:4] = -R_cam_mount @ some.R_mount_holder
    A[:, :, 4:] = -np.eye(3)
    right = some.t_mount_holder @ R_cam_mount.T
    x = np.linalg.lstsq(A.reshape(-1, 7), right.reshape(-1), rcond=None)[0]
    scale = float(x[0])
    if not abs(scale) > 0:
        return np.full(len(pairs.t_cam_board), np.inf), 1.0
    held = pairs.R_mount_holder @ x[1:4] + pairs.t_mount_holder
    t_cam_board = (held @ R_cam_mount.T + x[4:]) / scale
    R_cam_board = R_cam_mount @ pairs.R_mount_holder @ R_holder_board
    off = [
        _median_off(p_board @ R.T + t, seen)
        for R, t, (p_board, seen) in zip(R_cam_board, t_cam_board, pairs.corners, strict=True)
    ]
    return fx * np.array(off), scale


def _median_off(p_cam: FloatArray, seen: FloatArray) -> float:
    """Of points (N, 3) from rays (N, 2), both at z = 1; infinite behind the camera."""
    if (p_cam[:, 2] <= 0).any():
        return float("inf")
    return float(np.median(np.linalg.norm(p_cam[:, :2] / p_cam[:, 2:] - seen, axis=1)))


def _rotation_vectors(R_a: FloatArray, R_b: FloatArray) -> FloatArray:
    """(N, 3) of R_a^T R_b."""
    between = np.swapaxes(R_a, 1, 2) @ R_b
    return np.array([gtsam.Rot3.Logmap(gtsam.Rot3(R)) for R in between]).reshape(-1, 3)


def _nearest_rotation(M: FloatArray) -> FloatArray:
    """The rotation that maximises tr(R^T M) (Kabsch)."""
    U, _, Vt = np.linalg.svd(M)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt)) or 1.0])
    return np.asarray(U @ D @ Vt)


def _words(
    data: CalibrationViews,
    fx: float,
    pairs: _Pairs,
    kept: BoolArray,
    out: Sequence[LeftOut],
    limit_px: float,
) -> tuple[str, ...]:
    """Of the views that are left out: which, how far off, and whether two are exchanged."""
    if not out:
        return ()
    frames = ", ".join(f"{view.frame} ({view.off_px:.0f} px)" for view in out)
    said = f"robot pose and image do not agree in frames {frames}, left out; the limit is "
    lost = np.flatnonzero(~kept)
    for i in lost:
        for j in lost[lost > i]:
            order = np.arange(len(kept))
            order[[i, j]] = j, i
            swapped = replace(
                pairs,
                R_mount_holder=pairs.R_mount_holder[order],
                t_mount_holder=pairs.t_mount_holder[order],
            )
            off, _ = _judged(swapped, np.flatnonzero(kept), fx)
            if (off[[i, j]] < limit_px).all():
                pair = f"{data.views[i].frame} and {data.views[j].frame}"
                return (f"{said}{limit_px:.0f} px; the poses of {pair} are exchanged",)
    return (f"{said}{limit_px:.0f} px",)


def _explained(
    data: CalibrationViews,
    config: CalibrationConfig,
    alone: ViewsAlone,
    found: _Agreement,
    limit_px: float,
) -> tuple[InputError, bool]:
    """The error, and whether it names a slip with which the views agree."""
    off_px = float(np.median(found.off_px))
    told = (
        f"robot poses and images do not belong together (half of the views off by {off_px:.0f} px"
    )
    told += f" or more, {limit_px:.0f} are allowed)"
    poses, images = reported_mount_holder(data, config), np.arange(len(data.views))
    inverse = [T.inverse() for T in poses]
    other = "gripper" if config.camera_place == "fixed" else "fixed"
    frames = np.array([view.frame for view in data.views])
    next_one = np.flatnonzero(np.diff(frames) == 1)
    later, earlier = next_one + 1, next_one
    slips = [
        (f"T_world_gripper is inverted, or --camera-place is {other}", inverse, images),
        ("each pose is that of the image after it", _at(poses, earlier), later),
        ("each pose is that of the image before it", _at(poses, later), earlier),
        ("the poses are in the opposite order of the images", poses[::-1], images),
        ("the rotations of T_world_gripper are inverted", _turned_back(data, config), images),
    ]
    for words, Hs, shown in slips:
        if len(Hs) <= SAMPLE:
            continue
        tried = _agreement(_pairs(Hs, alone, data, shown), alone.fx, limit_px)
        if tried.enough and tried.share > found.share:
            return InputError(data.name, f"{told}: likely {words}", EXPECTED), True
    return InputError(data.name, told, EXPECTED), False


def _at(Ts: Sequence[gtsam.Pose3], which: np.ndarray) -> list[gtsam.Pose3]:
    return [Ts[i] for i in which]


def _turned_back(data: CalibrationViews, config: CalibrationConfig) -> list[gtsam.Pose3]:
    """T_mount_holder if only the rotations of T_world_gripper are inverted."""
    grips = [view.T_world_gripper for view in data.views]
    meant = [gtsam.Pose3(T.rotation().inverse(), T.translation()) for T in grips]
    return meant if config.camera_place == "fixed" else [T.inverse() for T in meant]
