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
    """What a depth image says at S points, in one place or in several."""

    off_m: FloatArray  # (..., S) how far the depth lies off them, along their normals
    sigma_m: FloatArray  # (..., S) its standard deviation
    seen: BoolArray  # (..., S) where there is a depth, on the side that the normal points to


@dataclass(frozen=True, slots=True)
class Found:
    """Where Gauss-Newton ended."""

    q: float
    information: float  # of independent readings
    found: int  # points
    read: int  # points at which there is a depth, on the side that the normal points to
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
        self,
        frame: RgbdFrame,
        noise: DepthNoiseModel,
        starts: FloatArray,
        config: KnownSurfaceConfig,
    ) -> Found:
        """Gauss-Newton from several states at once; of the ends, the one that finds most points.

        Args:
            frame: its depth.
            noise: of single readings.
            starts: (M,) roughly the state.
            config: tuning.
        """
        M, S = starts.size, len(self.x_world)
        q, information, along_m = starts.astype(np.float64), np.zeros(M), np.zeros(M)
        seen = np.zeros(M, dtype=int)
        good, going = np.zeros((M, S), dtype=bool), np.ones(M, dtype=bool)
        for gate_m in config.gates_m:
            R, t = (each[going] for each in self.joint.motion(q))
            Rt = np.ascontiguousarray(R.transpose(0, 2, 1))
            x, n = self.x_world @ Rt + t[:, None], self.normal_world @ Rt
            read = readings(frame, noise, x, n, config.least_cosine)
            near = read.seen & (np.abs(read.off_m) < gate_m + config.gate_sigmas * read.sigma_m)
            way = self.joint.velocity(x)
            J, e = np.where(near, (way * n).sum(axis=-1), 0.0), np.where(near, read.off_m, 0.0)
            w = weight((e / read.sigma_m) ** 2, config.dof, 1) / read.sigma_m**2
            told, pull = (w * J * J).sum(axis=1), (w * J * e).sum(axis=1)
            some = told > 0  # the others stay where they are
            going[going] = some
            # From farther than its gate it sees other surfaces.
            metres = np.sqrt((way[some] ** 2).sum(axis=-1).mean(axis=1))
            most = 2.0 * gate_m / np.maximum(metres, 1e-9)
            q[going] += np.clip(pull[some] / told[some], -most, most)
            information[going], good[going] = told[some], near[some]
            along_m[going] = np.sqrt((J[some] ** 2).sum(axis=1) / near[some].sum(axis=1))
            seen[going] = read.seen[some].sum(axis=1)
            if not some.any():
                break
        found = good.sum(axis=1)
        k = int(found.argmax())
        return Found(
            float(q[k]),
            float(information[k]),
            int(found[k]),
            int(seen[k]),
            float(along_m[k]),
            good[k],
        )


def readings(
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    x_world: FloatArray,
    normal_world: FloatArray,
    least_cosine: float,
) -> Readings:
    """What the depth says at points (..., S, 3) with normals (..., S, 3)."""
    camera, T = frame.camera, frame.T_world_cam
    R, eye = T.rotation().matrix(), T.translation()
    rays = x_world - eye
    cosine = -(normal_world * rays).sum(axis=-1) / np.sqrt((rays * rays).sum(axis=-1))
    uv = np.nan_to_num(camera.project(rays @ R), nan=-1.0).round()
    seen = (uv >= 0).all(axis=-1) & (uv[..., 0] < camera.width) & (uv[..., 1] < camera.height)
    whole = np.where(seen[..., None], uv, 0).astype(int)
    z = frame.depth_m[whole[..., 1], whole[..., 0]].astype(np.float64)
    seen &= np.isfinite(z) & (z > 0) & (cosine > least_cosine)
    z = np.where(seen, z, 1.0)
    p_world = camera.back_project(uv, z) @ R.T + eye
    e = ((p_world - x_world) * normal_world).sum(axis=-1)
    sigma = noise.sigma_m(z, camera.fx) * np.maximum(cosine, least_cosine)
    return Readings(e, sigma, np.asarray(seen))
