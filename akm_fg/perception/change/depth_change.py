"""Where depth has changed since the first frame, and which share of it a motion explains.

The camera stands still, so a pixel that shows something nearer than in frame 0 shows the moved
part, and one that shows something farther away was covered by it. Means over small windows are
compared (`compared_depth`): their noise is that of a few independent readings. The robot's pixels
are unknown.

A motion M_t explains a point of the changed surface if, moved to other frames, it is seen there.
A frame that shows something farther away at its place contradicts it; one that shows something
nearer hides it and says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.change.change_config import DepthChangeConfig
from akm_fg.perception.change.compared_depth import (
    behind_what_moves,
    changed,
    compared,
    gate_factor,
    variance,
)
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.thinning import repeated
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, Recording, RgbdFrame
from akm_fg.steps import Steps

_FRAMES_A_PIECE = 10  # compared without a pause: 20 ms


@dataclass(frozen=True, slots=True)
class DepthChange:
    """Change against frame 0, on every stride-th pixel of the image: (T, h, w)."""

    recording: Recording
    noise: DepthNoiseModel
    config: DepthChangeConfig
    frames: tuple[RgbdFrame, ...]  # T, (h, w): every stride-th pixel
    stride: int
    on_object: BoolArray  # (h, w) in frame 0
    nearer: BoolArray  # (T, h, w) shows a surface that was not there
    farther: BoolArray  # (T, h, w) the surface that was there is gone
    area_m2: FloatArray  # (T,) of the nearer surface, seen from the camera

    @property
    def camera(self) -> PinholeCamera:
        """Of the (h, w) images."""
        return self.frames[0].camera

    def mask(self, frame: int) -> BoolArray:
        """(H, W) nearer pixels of a frame at full size."""
        return self.full_size(self.nearer[frame])

    def full_size(self, image: BoolArray) -> BoolArray:
        """(H, W) of an image (h, w) of the pixels that are compared."""
        return repeated(image, self.stride, self.recording.frames[0].depth_m.shape)


def depth_change(
    recording: Recording,
    object_mask: BoolArray,
    noise: DepthNoiseModel,
    config: DepthChangeConfig | None = None,
) -> Steps[DepthChange]:
    """Compare all frames with frame 0, with a pause after some of them.

    Args:
        recording: T frames of one camera that stands still.
        object_mask: (H, W) in frame 0; changes that are beside neither it nor what was nearer
            in a frame before are left out.
        noise: of the depth.
        config: tuning.

    Raises:
        ValueError: the mask has another size than the image.
    """
    config = config or DepthChangeConfig()
    shape = recording.frames[0].depth_m.shape
    if object_mask.shape != shape:
        raise ValueError(f"mask {object_mask.shape}, expected {shape}")
    stride = _stride_px(recording.frames[0], object_mask, config)
    frames = tuple(_thinned(f, stride) for f in recording.frames)
    beside = max(1, round(config.beside_px * shape[1] / 640 / stride))
    on_object = object_mask[::stride, ::stride]
    touched = _widened(on_object, beside)
    fx = recording.frames[0].camera.fx
    rest_m = behind_what_moves([f.depth_m for f in frames], fx, noise, config)
    shown, pitch = np.isfinite(frames[0].depth_m), stride / fx
    rest_variance = variance(rest_m, fx, noise)
    last = compared(rest_m, frames[-1].depth_m, fx, noise, config, rest_variance)
    factor = gate_factor(last, stride, noise, config)
    nearer = np.zeros((len(frames), *touched.shape), dtype=bool)
    farther, area = nearer.copy(), np.zeros(len(frames))
    for t in range(1, len(frames)):
        now = last
        if t < len(frames) - 1:
            now = compared(rest_m, frames[t].depth_m, fx, noise, config, rest_variance)
        nearer[t], area[t] = changed(now, 1, factor, touched, pitch, config)
        gone, _ = changed(now, -1, factor, touched, pitch, config)
        nearer[t] &= now.known
        farther[t] = gone & shown
        touched |= _widened(nearer[t], beside)
        if t % _FRAMES_A_PIECE == 0:
            yield
    return DepthChange(recording, noise, config, frames, stride, on_object, nearer, farther, area)


def _stride_px(frame: RgbdFrame, object_mask: BoolArray, config: DepthChangeConfig) -> int:
    """Between pixels that are compared."""
    most = config.stride_px * object_mask.shape[1] / 640
    depth_m = frame.depth_m[object_mask & np.isfinite(frame.depth_m)]
    if depth_m.size:
        most = min(most, config.pitch_m * frame.camera.fx / float(np.median(depth_m)))
    return max(1, round(most))


def explained_share(
    change: DepthChange, R_world: FloatArray, t_world: FloatArray, known: BoolArray
) -> float:
    """The share of the changed surface that a motion explains, in [0, 1].

    A point of the changed surface counts as explained if frame 0 shows it where the motion puts
    it, or hides it there while more of the other frames confirm than contradict it.

    Args:
        change: of the recording.
        R_world: (T, 3, 3) motions from frame 0.
        t_world: (T, 3).
        known: (T,) where the motion is known.

    Returns:
        NaN where no changed point can be judged.
    """
    frames = change_frames(change, known, change.config.share_frames)
    explained = judged = 0
    for t in frames:
        back = R_world[t].T
        here = surface_points(change, t, change.nearer[t])
        gone = surface_points(change, 0, change.farther[t])
        x_world = np.concatenate([(here - t_world[t]) @ back.T, gone])
        own = np.concatenate([np.zeros(len(here), bool), np.ones(len(gone), bool)])
        # A vanished point must be seen in its own frame; a new one in the first.
        there = np.stack([x_world, x_world @ R_world[t].T + t_world[t]])
        (seen_0, seen_t), (through_0, through_t) = _looked_up(change, [0, t], there)
        main_seen, main_through = np.where(own, seen_t, seen_0), np.where(own, through_t, through_0)
        others = [s for s in frames if s != t]
        turned = np.ascontiguousarray(R_world[others].transpose(0, 2, 1))
        moved = x_world @ turned + t_world[others][:, None]
        seen, through = _looked_up(change, others, moved)
        votes = seen.sum(axis=0) - through.sum(axis=0)
        good = main_seen | (~main_through & (votes > 0))
        explained += int(good.sum())
        judged += int((main_seen | main_through | (seen | through).any(axis=0)).sum())
    return explained / judged if judged else float("nan")


def change_frames(change: DepthChange, known: BoolArray, count: int) -> list[int]:
    """At most `count` of the known frames with a nearer surface, evenly spread."""
    some = np.flatnonzero(change.nearer.any(axis=(1, 2)) & known)
    if some.size > count:
        some = some[np.linspace(0, some.size - 1, count).round().astype(int)]
    return [int(t) for t in some]


def _widened(mask: BoolArray, by_px: int) -> BoolArray:
    around = np.ones((2 * by_px + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), around) > 0)


def _thinned(frame: RgbdFrame, stride: int) -> RgbdFrame:
    """Every stride-th pixel as a frame of its own."""
    depth, c = frame.depth_m[::stride, ::stride], frame.camera
    small = PinholeCamera(
        depth.shape[1],
        depth.shape[0],
        c.fx / stride,
        c.fy / stride,
        c.cx / stride,
        c.cy / stride,
    )
    rgb = frame.rgb[::stride, ::stride]
    return replace(frame, depth_m=np.ascontiguousarray(depth), rgb=rgb, camera=small)


def surface_points(change: DepthChange, frame: int, mask: BoolArray) -> FloatArray:
    """World points (N, 3) of a frame's masked pixels, evenly thinned out."""
    v, u = np.nonzero(mask)
    step = max(1, -(-v.size // change.config.share_points))
    u, v = u[::step], v[::step]
    view = change.frames[frame]
    z = view.depth_m[v, u].astype(float)
    p_cam = view.camera.back_project(np.stack([u, v], axis=-1).astype(float), z)
    return np.asarray(p_cam @ view.T_world_cam.rotation().matrix().T + _eye(view.T_world_cam))


def _eye(T_world_cam: gtsam.Pose3) -> FloatArray:
    return np.asarray(T_world_cam.translation(), dtype=np.float64)


def nearest_pixels(
    camera: PinholeCamera, p_cam: FloatArray
) -> tuple[NDArray[np.int_], NDArray[np.int_], BoolArray]:
    """Columns and rows (...) of the pixels nearest to points (..., 3), and which are inside.

    Points outside the image get pixel 0, 0.
    """
    uv = np.nan_to_num(camera.project(p_cam), nan=-1.0)
    u, v = np.rint(uv[..., 0]), np.rint(uv[..., 1])
    inside = np.asarray((u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height))
    return np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int), inside


def _looked_up(
    change: DepthChange, frames: Sequence[int], p_world: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Whether points (F, N, 3) are on the surface that F frames show; whether it is seen beyond."""
    views, config = [change.recording.frames[t] for t in frames], change.config
    if not views:
        none = np.zeros(p_world.shape[:2], dtype=bool)
        return none, none
    camera, T = views[0].camera, views[0].T_world_cam  # which stands still
    p_cam = (p_world - _eye(T)) @ T.rotation().matrix()
    u, v, inside = nearest_pixels(camera, p_cam)
    seen = np.stack([view.depth_m[v[k], u[k]] for k, view in enumerate(views)])
    z = np.where(inside, seen, np.nan)
    sigma = np.sqrt(2.0) * change.noise.sigma_m(p_cam[..., 2], camera.fx)
    gate = config.share_sigmas * sigma + config.least_m
    beyond = z - p_cam[..., 2]
    return np.asarray(np.abs(beyond) < gate), np.asarray(beyond >= gate)
