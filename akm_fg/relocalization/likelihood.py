"""How a depth image speaks for each state of a part: one log likelihood ratio a state.

Every point of the surface that a state puts before the camera, not turned away and not behind
another surface of the model, is a reading. It lies on the surface, or before it (somebody stands
in the way), or behind it (the camera looks through where the part should be):

    p(e | q) = w_on N(e; 0, s) + w_before [e > 0] / D + w_behind [e < 0] / D
    p(e | no part) = 1 / 2D

for e the distance of the depth from the surface along its normal, towards the camera positive.
The sum of log p(e | q) / p(e | no part) over the readings, divided by how many err together, is
the evidence for q. States that hide the part gain nothing and lose nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.model.records import ModelPart, Surface
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.known_surface import KnownSurface, readings
from akm_fg.records import BoolArray, FloatArray, RgbdFrame
from akm_fg.relocalization.config import LikelihoodConfig


@dataclass(frozen=True, slots=True)
class Shares:
    """Of the readings at points that a state puts before the camera."""

    readings: int
    on: float  # the surface
    before: float  # it: something is in the way
    behind: float  # it: the camera looks through


class StateLikelihood:
    """The surfaces of one part, ready to be looked for.

    Args:
        part: whose state is asked.
        static: what rests, and may hide it.
        config: tuning.
    """

    def __init__(self, part: ModelPart, static: Surface, config: LikelihoodConfig) -> None:
        self.config = config
        joint = part.seen_joint.joint
        chosen = spread(part.surface.p_world, config.points)
        # Surfaces are in the closed pose: taken to state zero, where the joint counts from.
        (R,), (t,) = joint.motion(np.array([-part.seen_state(part.closed_state)]))
        x = part.surface.p_world[chosen] @ R.T + t
        normal = part.surface.normal_world[chosen] @ R.T
        self.surface = KnownSurface(joint, x, normal)
        many = spread(part.surface.p_world, config.coloured)
        self._coloured = KnownSurface(
            joint,
            part.surface.p_world[many] @ R.T + t,
            part.surface.normal_world[many] @ R.T,
        )
        self._grey = part.surface.rgb[many].astype(float).mean(axis=1)
        self._last: tuple[RgbdFrame, NDArray[np.float32]] | None = None  # asked about many times
        self._static = static.p_world[spread(static.p_world, config.static_points)]

    @property
    def slides_along_itself(self) -> float:
        """Of the points' way, rms, the share along their normals: depth tells a state by that."""
        x, normal = self.surface.moved(0.0)
        way = self.surface.joint.velocity(x)
        along = (way * normal).sum(axis=1)
        return float(np.sqrt((along**2).mean() / max(float((way**2).sum(axis=1).mean()), 1e-12)))

    def log_odds(self, frame: RgbdFrame, noise: DepthNoiseModel, q: FloatArray) -> FloatArray:
        """(Q,) evidence for each state, nats, against a scene without the part."""
        buffer = self._static_depth(frame)
        return np.array([self._of_state(frame, noise, float(state), buffer) for state in q])

    def together(self, frame: RgbdFrame, noise: DepthNoiseModel, q: FloatArray) -> FloatArray:
        """(Q,) evidence for neighbouring states, nats, by the points that all of them show.

        A state that shows more of the part gains nothing by that.
        """
        buffer = self._static_depth(frame)
        told = [self._by_point(frame, noise, float(state), buffer) for state in q]
        shared = np.all([used for _, used in told], axis=0)
        depth = np.array([odds[shared].sum() for odds, _ in told]) / self.config.as_one
        return depth + self._looks_alike(frame, q)

    def colours(self, frame: RgbdFrame, q: FloatArray) -> FloatArray:
        """(Q,) what colours say for states anywhere, nats, each by the points that it shows."""
        evidence = np.zeros(len(q))
        for k, state in enumerate(q):
            grey, seen = self._greys(frame, float(state))
            if seen.sum() >= self.config.least_coloured:
                r = np.array(_correlation(grey[seen], self._grey[seen]))
                evidence[k] = self._of_correlation(r, int(seen.sum()))
        return evidence

    def _looks_alike(self, frame: RgbdFrame, q: FloatArray) -> FloatArray:
        """(Q,) what colours say for neighbouring states, nats, by the points that all show."""
        told = [self._greys(frame, float(state)) for state in q]
        seen = np.all([shown for _, shown in told], axis=0)
        if seen.sum() < self.config.least_coloured:
            return np.zeros(len(q))
        r = [_correlation(grey[seen], self._grey[seen]) for grey, _ in told]
        return self._of_correlation(np.array(r), int(seen.sum()))

    def _of_correlation(self, r: FloatArray, n: int) -> FloatArray:
        """Evidence of correlations over n points, nats.

        The image's grey at the points is the surface's up to scale, offset and Gaussian noise: the
        profile likelihood is (1 - r^2)^(-n / 2).
        """
        independent = n / self.config.coloured_as_one
        alike = np.clip(r, 0.0, 0.999)
        return np.asarray(-0.5 * independent * np.log(1.0 - alike**2))

    def _greys(self, frame: RgbdFrame, q: float) -> tuple[FloatArray, BoolArray]:
        """(N,) the image's grey at the surface's points, and which of them it shows."""
        c, T = self.config, frame.T_world_cam
        x, normal = self._coloured.moved(q)
        p_cam = (x - T.translation()) @ T.rotation().matrix()
        uv = np.nan_to_num(frame.camera.project(p_cam), nan=-1.0)
        inside = (uv >= 0).all(axis=1) & (uv[:, 0] < frame.camera.width - 1)
        inside &= uv[:, 1] < frame.camera.height - 1
        at = np.where(inside[:, None], uv, 0.0).astype(np.float32)
        z = frame.depth_m[at[:, 1].astype(int), at[:, 0].astype(int)]
        # What stands before the part, and the robot, have other colours.
        near = np.abs(np.nan_to_num(z, nan=-1.0) - p_cam[:, 2]) < c.hidden_m
        turned = ((T.translation() - x) * normal).sum(axis=1) > 0.0
        # Columns and rows apart: the pair in one array is for OpenCV alone to understand.
        grey = cv2.remap(self._blurred(frame), at[:, :1], at[:, 1:], cv2.INTER_LINEAR)[:, 0]
        return grey.astype(float), np.asarray(inside & near & turned)

    def _blurred(self, frame: RgbdFrame) -> NDArray[np.float32]:
        if self._last is None or self._last[0] is not frame:
            soft = cv2.GaussianBlur(frame.rgb, (0, 0), self.config.blur_px)
            self._last = frame, soft.astype(np.float32).mean(axis=2)
        return self._last[1]

    def shares(self, frame: RgbdFrame, noise: DepthNoiseModel, q: float) -> Shares:
        """What the readings say of a state, point by point."""
        x, normal = self.surface.moved(q)
        read = readings(frame, noise, x, normal, self.config.least_cosine)
        used = read.seen & self._before(frame, x, normal, self._static_depth(frame))
        e = read.off_m[used] / np.hypot(read.sigma_m[used], self.config.model_m)
        n = max(e.size, 1)
        off = self.config.off_sigmas
        return Shares(
            int(e.size),
            float((np.abs(e) <= off).sum()) / n,
            float((e > off).sum()) / n,
            float((e < -off).sum()) / n,
        )

    def shown(self, frame: RgbdFrame, q: float) -> BoolArray:
        """(S,) points that a state puts before the camera, as far as the model itself goes."""
        x, normal = self.surface.moved(q)
        return self._before(frame, x, normal, self._static_depth(frame))

    def _of_state(
        self, frame: RgbdFrame, noise: DepthNoiseModel, q: float, buffer: FloatArray
    ) -> float:
        odds, used = self._by_point(frame, noise, q, buffer)
        return float(odds[used].sum()) / self.config.as_one

    def _by_point(
        self, frame: RgbdFrame, noise: DepthNoiseModel, q: float, buffer: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(S,) evidence of each point's reading, nats, and whether it is one."""
        c = self.config
        x, normal = self.surface.moved(q)
        read = readings(frame, noise, x, normal, c.least_cosine)
        used = read.seen & self._before(frame, x, normal, buffer)
        e, s = read.off_m, np.hypot(read.sigma_m, c.model_m)
        on = c.on * np.exp(-0.5 * (e / s) ** 2) / (s * np.sqrt(2.0 * np.pi))
        other = np.where(e > 0.0, c.before, c.behind) / c.depth_range_m
        return np.log(2.0 * c.depth_range_m * (on + other)), used

    def _before(
        self, frame: RgbdFrame, x: FloatArray, normal: FloatArray, buffer: FloatArray
    ) -> BoolArray:
        """(S,) points turned to the camera and not behind a surface of the model."""
        T, c = frame.T_world_cam, self.config
        p_cam = (x - T.translation()) @ T.rotation().matrix()
        turned = ((T.translation() - x) * normal).sum(axis=1) > 0.0
        depth = np.minimum(buffer, _depth_buffer(frame, p_cam[turned], c.hidden_cell_px))
        row, column, inside = _cells(frame, p_cam, c.hidden_cell_px)
        hidden = p_cam[:, 2] > depth[row, column] + c.hidden_m
        return np.asarray(turned & inside & ~hidden)

    def _static_depth(self, frame: RgbdFrame) -> FloatArray:
        T = frame.T_world_cam
        p_cam = (self._static - T.translation()) @ T.rotation().matrix()
        return _depth_buffer(frame, p_cam, self.config.hidden_cell_px)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    a, b = one - one.mean(), other - other.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0.0 else 0.0


def spread(p_world: FloatArray, most: int) -> np.ndarray:
    """Places of at most so many of the points (N, 3), evenly over the surface's voxels."""
    n = len(p_world)
    if n <= most:
        return np.arange(n)
    order = np.lexsort(p_world.T)
    return np.sort(order[np.linspace(0, n - 1, most).astype(int)])


def _cells(frame: RgbdFrame, p_cam: FloatArray, cell_px: int) -> tuple[np.ndarray, ...]:
    """Row and column of the buffer's cell of points (N, 3), and whether they are in the image."""
    uv = np.nan_to_num(frame.camera.project(p_cam), nan=-1.0)
    camera = frame.camera
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    cells = np.where(inside[:, None], uv, 0.0).astype(int) // cell_px
    return cells[:, 1], cells[:, 0], inside


def _depth_buffer(frame: RgbdFrame, p_cam: FloatArray, cell_px: int) -> FloatArray:
    """Nearest depth of points in cells of the image; infinite where there is none."""
    camera = frame.camera
    buffer = np.full((-(-camera.height // cell_px), -(-camera.width // cell_px)), np.inf)
    row, column, inside = _cells(frame, p_cam, cell_px)
    np.minimum.at(buffer, (row[inside], column[inside]), p_cam[inside, 2])
    return buffer
