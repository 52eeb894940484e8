"""Where a part with a known surface and joint is in one depth image.

At a state q each point of the surface is expected at a place; the depth there, less what is
expected, along the point's normal, is moved by q as much as the point's way along its normal.
Gauss-Newton with the Student-t weights of single readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, FloatArray, RgbdFrame
from factors.joint import Joint
from factors.student_t import weight


@dataclass(frozen=True, slots=True)
class KnownSurfaceConfig:
    """Finding a surface again from a state nearby."""

    gates_m: tuple[float, ...] = (0.03, 0.02, 0.01, 0.01)  # off the surface, a step
    gate_sigmas: float = 3.0  # of a reading, on top
    least_cosine: float = 0.2  # between ray and normal: 78 deg
    dof: float = 4.0  # of the Student-t weights of readings: other surfaces are common


@dataclass(frozen=True, slots=True)
class Readings:
    """What a depth image says at S points."""

    off_m: FloatArray  # (S,) how far the depth lies off them, along their normals
    sigma_m: FloatArray  # (S,) its standard deviation
    seen: BoolArray  # (S,) where there is a depth, on the side that the normal points to


@dataclass(frozen=True, slots=True)
class Found:
    """Where Gauss-Newton ended."""

    q: float
    information: float  # of independent readings
    found: int  # points
    along_m: float  # rms way of these along their normals, for a unit of the state
    good: BoolArray  # (S,) which points these are


@dataclass(frozen=True, slots=True)
class KnownSurface:
    """Points of a part, and the joint that it moves by."""

    joint: Joint
    x_world: FloatArray  # (S, 3) at state zero
    normal_world: FloatArray  # (S, 3) unit

    def moved(self, q: float) -> tuple[FloatArray, FloatArray]:
        """Points and normals (S, 3) at a state."""
        (R,), (t,) = self.joint.motion(np.array([q]))
        return self.x_world @ R.T + t, self.normal_world @ R.T

    def metres_per_unit(self, q: float) -> float:
        """Root mean square way of the points for a unit of the state."""
        way = self.joint.velocity(self.moved(q)[0])
        return float(np.sqrt((way**2).sum(axis=1).mean()))

    def solved(
        self, frame: RgbdFrame, noise: DepthNoiseModel, q: float, config: KnownSurfaceConfig
    ) -> Found:
        """Gauss-Newton from a state.

        Args:
            frame: its depth.
            noise: of single readings.
            q: roughly the state.
            config: tuning.
        """
        solved = Found(q, 0.0, 0, 0.0, np.zeros(len(self.x_world), dtype=bool))
        for gate_m in config.gates_m:
            x, n = self.moved(solved.q)
            read = readings(frame, noise, x, n, config.least_cosine)
            off = np.abs(read.off_m) < gate_m + config.gate_sigmas * read.sigma_m
            good = read.seen & off
            J = (self.joint.velocity(x) * n).sum(axis=1)[good]
            e, sigma = read.off_m[good], read.sigma_m[good]
            w = weight((e / sigma) ** 2, config.dof, 1) / sigma**2
            information = float((w * J * J).sum())
            if information <= 0:
                break
            step, along_m = float((w * J * e).sum()) / information, float(np.sqrt((J**2).mean()))
            # From farther than its gate it sees other surfaces.
            most = 2.0 * gate_m / max(self.metres_per_unit(solved.q), 1e-9)
            step = float(np.clip(step, -most, most))
            solved = Found(solved.q + step, information, int(good.sum()), along_m, good)
        return solved


def readings(
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    x_world: FloatArray,
    normal_world: FloatArray,
    least_cosine: float,
) -> Readings:
    """What the depth says at points (S, 3) with normals (S, 3)."""
    camera, T = frame.camera, frame.T_world_cam
    R, eye = T.rotation().matrix(), T.translation()
    rays = x_world - eye
    cosine = -(normal_world * rays).sum(axis=1) / np.linalg.norm(rays, axis=1)
    uv = np.nan_to_num(camera.project(rays @ R), nan=-1.0).round()
    seen = (uv >= 0).all(axis=1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    u, v = np.where(seen[:, None], uv, 0).astype(int).T
    z = frame.depth_m[v, u].astype(np.float64)
    seen &= np.isfinite(z) & (z > 0) & (cosine > least_cosine)
    z = np.where(seen, z, 1.0)
    p_world = camera.back_project(uv, z) @ R.T + eye
    e = ((p_world - x_world) * normal_world).sum(axis=1)
    sigma = noise.sigma_m(z, camera.fx) * np.maximum(cosine, least_cosine)
    return Readings(e, sigma, np.asarray(seen))
