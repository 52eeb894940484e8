"""Openings with known joints, and surfaces of their panels, as fixtures."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from akm_fg.records import PinholeCamera
from factors.measurements.dense_registration import PatchObservations

CAMERA = PinholeCamera(640, 480, 600.0, 600.0, 319.5, 239.5)


@dataclass(frozen=True)
class Slab:
    """A panel with a front, edges and handle sides that a camera sees: patches on planes.

    Fits `SurfaceSource` and `SurfaceViews`. Where a patch is looked for, the ray through its pixel
    meets the plane it lies on, moved as the part really is; every keyframe reads that plane with
    noise of its own. Nothing here knows the joint but through where the planes are.
    """

    x_world: np.ndarray  # (3, S) patches at state zero
    normal_world: np.ndarray  # (3, S)
    R_world: np.ndarray  # (T, 3, 3) true motions of all frames
    t_world: np.ndarray  # (T, 3)
    noise_m: np.ndarray  # (T, S) of the readings, along the normals
    sigma_m: float  # that they claim
    T_world_cam: np.ndarray  # (4, 4)
    hidden: tuple[int, ...] = ()  # frames in which nothing is seen
    frames: tuple[int, ...] = ()

    def views(self, frames, R_world, t_world, known):
        assert known[list(frames)].all()
        yield
        return replace(self, frames=tuple(k for k in frames if k not in self.hidden))

    def associate(self, R_world, t_world, gate_m, most=None):
        p_world, precision, uv = [], [], []
        R_world_cam, eye = self.T_world_cam[:3, :3], self.T_world_cam[:3, 3]
        for R, t, k in zip(R_world, t_world, self.frames, strict=True):
            moved = R @ self.x_world + t[:, None]
            n = self.R_world[k] @ self.normal_world
            on = self.R_world[k] @ (self.x_world + self.noise_m[k] * self.normal_world)
            rays = moved - eye[:, None]
            off = ((on + self.t_world[k][:, None] - moved) * n).sum(axis=0)
            along = (rays * n).sum(axis=0)
            seen = (np.abs(off) < gate_m) & (np.abs(along) > 0.2 * np.linalg.norm(rays, axis=0))
            step = np.where(seen, off / along, 0.0)
            p_world.append(np.where(seen, moved + step * rays, 0.0))
            precision.append(seen / self.sigma_m**2)
            uv.append(CAMERA.project(rays.T @ R_world_cam))
        kept = (np.array(precision) > 0).sum(axis=0) >= 2
        patches = PatchObservations(
            np.array(p_world)[:, :, kept],
            np.array(precision)[:, kept],
            self.normal_world[:, kept],
        )
        unknown = np.full(len(uv), np.nan)
        return Association(patches, np.array(uv)[:, kept], unknown, unknown)


@dataclass(frozen=True)
class Association:
    """What `Slab.associate` finds."""

    patches: PatchObservations
    uv: np.ndarray
    seen_through: np.ndarray
    was_there: np.ndarray


@pytest.fixture(scope="session")
def surface_of():
    """Factory: surface_of(opening, ...), the surface of the opening's panel."""

    def build(truth, seed=0, patches=600, sigma_m=0.001, noise_m=None, block_px=0, hidden=()):
        """`block_px`: the noise of patches in the same block of that many pixels is the same."""
        rng = np.random.default_rng([seed, 77])
        span = np.linalg.svd(truth.rest_world - truth.rest_world.mean(axis=0))[2]
        across = span[rng.choice(3, patches, p=[0.2, 0.2, 0.6])]  # edges, handle sides, front
        x = (
            truth.rest_world.mean(axis=0)
            + rng.uniform(-1, 1, (patches, 3)) * [0.2, 0.2, 0.04] @ span
        )
        T_world_cam = np.eye(4)  # before the front, towards two corners
        T_world_cam[:3, :3] = span.T * np.linalg.det(span)
        T_world_cam[:3, 3] = x.mean(axis=0) - T_world_cam[:3, :3] @ [0.7, 0.7, 1.2]
        R, t = truth.joint.motion(truth.q)
        noise = (sigma_m if noise_m is None else noise_m) * rng.normal(size=(truth.q.size, patches))
        if block_px:
            uv = CAMERA.project((x - T_world_cam[:3, 3]) @ T_world_cam[:3, :3])
            _, of_patch = np.unique(np.floor(uv / block_px), axis=0, return_inverse=True)
            noise = noise[:, of_patch.ravel()]
        return Slab(x.T, across.T, R, t, noise, sigma_m, T_world_cam, tuple(hidden))

    return build
