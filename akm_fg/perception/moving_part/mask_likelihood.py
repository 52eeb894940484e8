"""Does a pixel of one frame rest, or move with the part? What another frame says.

A resting pixel of a fixed camera has the same depth in the other frame, and that of a camera which
moves as its poses say lies on the surface seen there; so does a point of the part, carried by the
part's rigid motion. For either hypothesis with
depth error d = seen - predicted, the log-likelihood ratio against "anything may be seen there"
is

    s(d) = log(range / (sigma sqrt(2 pi))) - d^2 / (2 sigma^2),

bounded below: something farther away refutes the hypothesis up to an outlier's probability;
something nearer only hides the point. Where the other frame has no depth nothing is said.

A plane that slides within itself fits both. Where depth fits, the texture is compared too: the
high-passed gray levels g differ by r with variance s2 if it is the same spot, and by s2 + 2 v
on unrelated spots of a texture with variance v:

    s(r) = log(1 + 2 v / s2) / 2 - (r^2 / 2) (1 / s2 - 1 / (s2 + 2 v)).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import gtsam
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import Box, Image
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame


@dataclass(frozen=True, slots=True)
class MaskLikelihoodConfig:
    """Likelihoods of differences of depth and of gray levels."""

    systematic_m: float = 0.003  # of the rigid motion, and of half a pixel on a slanted surface
    range_m: float = 0.3  # over which depths spread that have nothing to do with the prediction
    log_outlier: float = -3.5  # ratio where the surface is gone: 3 % of such readings are wrong
    log_hidden: float = -0.5  # ratio where something nearer is seen
    gray_sigma: float = 8.0  # sd of a gray level found again: noise, half a pixel, shading
    texture_px: int = 15  # size of what counts as texture; coarser is shading
    max_texture: float = 2.5  # ratio; one that does not fit cancels most of what depth says
    max_per_frame: float = 3.0  # no single frame counts more: its errors are shared by many pixels


@dataclass(frozen=True, slots=True)
class MaskView:
    """A frame to compare with: depth, and texture."""

    depth_m: Image  # (H, W), NaN unknown
    texture: Image  # (H, W) gray levels without their local mean
    camera: PinholeCamera
    T_world_cam: gtsam.Pose3


@dataclass(frozen=True, slots=True)
class PixelLikelihood:
    """Log-likelihood ratios of a crop's pixels, summed over frames; 0 where nothing is known."""

    moving: Image  # (h, w) against anything
    static: Image  # (h, w) against anything
    ratio: Image  # (h, w) moving against static, bounded per frame


def mask_view(frame: RgbdFrame, config: MaskLikelihoodConfig) -> MaskView:
    """Prepare a frame."""
    gray = cv2.GaussianBlur(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), (3, 3), 0)
    size = (config.texture_px, config.texture_px)
    texture = np.asarray(gray - cv2.boxFilter(gray, cv2.CV_32F, size), dtype=np.float32)
    return MaskView(frame.depth_m, texture, frame.camera, frame.T_world_cam)


def gather_likelihood(
    view: MaskView,
    box: Box,
    others: list[tuple[MaskView, gtsam.Pose3]],
    noise: DepthNoiseModel,
    config: MaskLikelihoodConfig,
) -> PixelLikelihood:
    """What other frames say of one frame's pixels.

    Args:
        view: the frame whose pixels are judged.
        box: rows and columns of its image to judge, with their stride.
        others: the frames that are asked, each with the part's motion (world) from `view`.
        noise: of the depth, as large as it has been found to be.
        config: tuning.
    """
    judge = _Judge(view, box, noise, config)
    sums = [np.zeros(judge.z.shape, np.float32) for _ in range(3)]
    for other, moved_world in others:
        static = judge.score(*judge.at_rest(other, box))
        moving = judge.score(*judge.look_up(other, moved_world))
        bound = config.max_per_frame
        ratio = np.clip(moving - static, -bound, bound)
        for total, value in zip(sums, (moving, static, ratio), strict=True):
            total += value
    return PixelLikelihood(*sums)


def on_background(
    view: MaskView,
    box: Box,
    background: MaskView,
    moved_world: gtsam.Pose3 | None,
    noise: DepthNoiseModel,
    config: MaskLikelihoodConfig,
) -> BoolArray:
    """(h, w), whether a crop's pixels lie on a background's surface, at rest or moved.

    Args:
        view: the frame whose pixels are judged.
        box: rows and columns of its image, with their stride.
        background: a frame without the depth of the object.
        moved_world: the part's motion from `view` to it; None if not known.
        noise: of the depth.
        config: tuning.
    """
    judge = _Judge(view, box, noise, config)
    rest = np.asarray(judge.score(judge.at_rest(background, box)[0], None) > 0)
    if moved_world is not None:
        rest |= judge.score(judge.look_up(background, moved_world)[0], None) > 0
    return rest


def camera_rays(camera: PinholeCamera, box: Box) -> tuple[Image, Image]:
    """Rays of a crop's pixels: x / z (w,) and y / z (h, 1)."""
    x = (np.arange(camera.width)[box[1]] - camera.cx) / camera.fx
    y = (np.arange(camera.height)[box[0]] - camera.cy) / camera.fy
    return x.astype(np.float32), y.astype(np.float32)[:, None]


class _Judge:
    """Scores predictions for the pixels of one crop."""

    def __init__(
        self, view: MaskView, box: Box, noise: DepthNoiseModel, config: MaskLikelihoodConfig
    ) -> None:
        self.z = view.depth_m[box]
        self._view, self._config = view, config
        self._rays = camera_rays(view.camera, box)
        knots = np.linspace(0.1, 10.0, 200)  # the noise is smooth in depth: a table is faster
        table: FloatArray = 2 * noise.sigma_m(knots, view.camera.fx) ** 2 + config.systematic_m**2
        variance = np.interp(self.z, knots, table).astype(np.float32)
        self._half_information = 0.5 / variance
        self._log_at_zero = np.log(config.range_m / np.sqrt(2 * np.pi * variance))
        s2 = np.float32(config.gray_sigma**2)
        size = (config.texture_px, config.texture_px)
        unrelated = s2 + 2 * cv2.sqrBoxFilter(view.texture, cv2.CV_32F, size)[box]
        self._texture = view.texture[box]
        self._texture_at_zero = 0.5 * np.log(unrelated / s2)
        self._texture_information = 0.5 / s2 - 0.5 / unrelated

    def score(self, error_m: Image, texture: Image | None) -> Image:
        """The module's s(d) + s(r) of depth errors (h, w); 0 where they are NaN."""
        c = self._config
        fits = self._log_at_zero - error_m**2 * self._half_information
        floor = np.where(error_m > 0, np.float32(c.log_outlier), np.float32(c.log_hidden))
        if texture is not None:
            r = texture - self._texture
            same = self._texture_at_zero - r * r * self._texture_information
            fits += np.clip(same, -c.max_texture, c.max_texture)
        return np.asarray(np.where(np.isnan(error_m), 0, np.maximum(fits, floor)), np.float32)

    def at_rest(self, other: MaskView, box: Box) -> tuple[Image, Image]:
        """As `look_up`, of points that did not move; without a search where the camera stood."""
        if other.T_world_cam.equals(self._view.T_world_cam, 0.0):
            return other.depth_m[box] - self.z, other.texture[box]
        return self.look_up(other, gtsam.Pose3())

    def look_up(self, other: MaskView, moved_world: gtsam.Pose3) -> tuple[Image, Image]:
        """Seen minus predicted depth, NaN if unseen, and texture, where the points moved to."""
        motion = other.T_world_cam.inverse() * moved_world * self._view.T_world_cam
        R, t = motion.rotation().matrix().astype(np.float32), motion.translation()
        camera, (x, y) = other.camera, self._rays
        p = [self.z * (R[i, 0] * x + R[i, 1] * y + R[i, 2]) + np.float32(t[i]) for i in range(3)]
        with np.errstate(invalid="ignore", divide="ignore"):
            u = np.float32(camera.fx) * p[0] / p[2] + np.float32(camera.cx + 0.5)
            v = np.float32(camera.fy) * p[1] / p[2] + np.float32(camera.cy + 0.5)
            inside = (p[2] > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        index = np.where(inside, v, 0).astype(np.int32) * camera.width
        index += np.where(inside, u, 0).astype(np.int32)
        seen = np.where(inside, other.depth_m.ravel().take(index), np.float32(np.nan))
        return seen - p[2], other.texture.ravel().take(index)
