"""Surface patches of the moving part and where they are seen again: data for dense registration.

Patches are set where keyframes show the part's surface, one a cell of space in the reference
pose. Given the part's motions, a patch is projected into every keyframe; where the depth image
shows a plane there, of like normal and not far off, the point where the patch's ray meets that
plane is an observation (projective association, Blais and Levine, 1995). What covers a patch (the
robot, another part, the image's border) shows no plane of the part there: no observation.

A surface has a side: seen normals face the camera, so that a patch which would show its back is
seen nowhere. And it is opaque: where a frame shows what lies behind the patches of the first view,
which should be in front of it, the part is not there (`Association.seen_through`). Where the first
view shows the same surface in the same place, though it should have moved, it is not the part's
either (`Association.was_there`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_planes import DepthPlanes
from akm_fg.perception.surface.part_cloud import PartCloud, sample_cloud
from akm_fg.records import BoolArray, FloatArray
from factors.measurements.dense_registration import PatchObservations


@dataclass(frozen=True, slots=True)
class PatchConfig:
    """Setting patches and finding them again."""

    cell_m: float = 0.006  # of space with one patch: about three pixels at arm's length
    max_patches: int = 4000
    max_normal_angle_rad: float = 0.35  # between a patch and the plane seen; normals are +-3 deg
    min_views: int = 2  # keyframes a patch must be seen in
    stride_px: int = 2  # of the pixels at which patches may be set
    least_cosine: float = 0.26  # between ray and normal, 75 deg: turned farther, nothing is judged
    least_judged: int = 30  # patches by which a frame is judged


@dataclass(frozen=True, slots=True)
class LookedFor:
    """Patches, not all of which are seen again, under one set of motions."""

    R_world: FloatArray  # (K, 3, 3)
    t_world: FloatArray  # (K, 3)
    x_world: FloatArray  # (3, S) in the reference pose
    normal_world: FloatArray  # (3, S)
    gate_m: float
    uv: FloatArray  # (K, S, 2) pixels where they were looked for
    found: BoolArray  # (K, S)

    def moved(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Points and normals (3, S) in a view."""
        R = self.R_world[k]
        return R @ self.x_world + self.t_world[k][:, None], R @ self.normal_world


@dataclass(frozen=True, slots=True)
class Association:
    """Patches and their observations under one set of motions."""

    patches: PatchObservations  # those that are seen again
    uv: FloatArray  # (K, S, 2) pixels where they were looked for
    views: PatchViews
    looked_for: LookedFor

    @property
    def seen_through(self) -> FloatArray:
        """(K,) share of a view in which the part is not: something farther away is seen.

        Of the first view's patches that face the camera and are not covered; NaN where too few are
        judged.
        """
        return self.views.seen_through(self.looked_for)

    @property
    def was_there(self) -> FloatArray:
        """(K,) share of a view's patches in whose place is what was there before.

        Of those whose surface should have moved: seen in the first view (it rests), or hidden in it
        where the part came nearer (it is what the part has covered); NaN where too few are judged.
        """
        return self.views.was_there(self.looked_for)


@dataclass(frozen=True, slots=True)
class PatchViews:
    """The part's surface in K keyframes."""

    frames: tuple[int, ...]  # (K,) numbers in the recording
    planes: tuple[DepthPlanes, ...]
    clouds: tuple[PartCloud, ...]
    config: PatchConfig
    came_nearer: bool = False  # whether the clouds are of what is nearer than in the first view

    def associate(
        self, R_world: FloatArray, t_world: FloatArray, gate_m: float, most: int | None = None
    ) -> Association:
        """Patches and observations for motions (K, 3, 3), (K, 3) from the reference pose.

        Args:
            R_world: rotations.
            t_world: translations.
            gate_m: how far off the predicted surface an observation may lie.
            most: patches that are looked for, spread over all there are; every one if not given.
        """
        x, n = self._patches(R_world, t_world)
        if most is not None and x.shape[1] > most:
            some = np.linspace(0, x.shape[1] - 1, most).round().astype(int)
            x, n = np.ascontiguousarray(x[:, some]), np.ascontiguousarray(n[:, some])
        K, S = len(self.planes), x.shape[1]
        p_world, precision = np.zeros((K, 3, S)), np.zeros((K, S))
        normal, uv = np.zeros((3, S)), np.full((K, S, 2), np.nan)
        looked_for = LookedFor(R_world, t_world, x, n, gate_m, uv, np.zeros((K, S), dtype=bool))
        least_cosine = np.cos(self.config.max_normal_angle_rad)
        for k, planes in enumerate(self.planes):
            R_world_cam, eye = (
                planes.T_world_cam.rotation().matrix(),
                planes.T_world_cam.translation(),
            )
            R_cam_x = R_world_cam.T @ R_world[k]
            p_cam = R_cam_x @ x + (R_world_cam.T @ (t_world[k] - eye))[:, None]
            uv[k] = planes.camera.project(p_cam.T)
            met = planes.met(uv[k, :, 0], uv[k, :, 1])
            expected = R_cam_x @ n[:, met.index]
            off = np.abs((expected * (met.p_cam - p_cam[:, met.index])).sum(axis=0))
            good = (expected * met.normal_cam).sum(axis=0) > least_cosine
            good &= off < gate_m
            at = met.index[good]
            looked_for.found[k, at] = True
            p_world[k][:, at] = R_world_cam @ met.p_cam[:, good] + eye[:, None]
            precision[k, at] = met.sigma_normal_m[good] ** -2
            normal[:, at] += R_cam_x.T @ met.normal_cam[:, good]
        kept = looked_for.found.sum(axis=0) >= self.config.min_views
        normal = normal[:, kept]
        return Association(
            PatchObservations(
                p_world[:, :, kept],
                precision[:, kept],
                normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-12),
            ),
            uv[:, kept],
            self,
            looked_for,
        )

    def seen_through(self, looked_for: LookedFor) -> FloatArray:
        """See `Association.seen_through`."""
        farther = np.zeros(looked_for.found.shape, dtype=bool)
        for k in range(len(self.planes)):
            behind, clear_m = self._behind(k, k, looked_for)
            farther[k] = behind > clear_m
        judged = (looked_for.found | farther) & looked_for.found[:1].any(axis=0)
        return self._share(farther, judged)

    def was_there(self, looked_for: LookedFor) -> FloatArray:
        """See `Association.was_there`."""
        same, went = (np.zeros(looked_for.found.shape, dtype=bool) for _ in range(2))
        x_first, _ = looked_for.moved(0)
        for k in range(len(self.planes)):
            before, clear_m = self._behind(0, k, looked_for)
            moved, expected = looked_for.moved(k)
            came = np.abs((expected * (moved - x_first)).sum(axis=0)) > 2 * clear_m
            covered = self.came_nearer and len(self.clouds[k].p_world) >= self.config.least_judged
            same[k] = (np.abs(before) < clear_m) | (covered & (before < -clear_m))
            went[k] = looked_for.found[k] & came & np.isfinite(before)
        return self._share(same, went)

    def _share(self, those: BoolArray, judged: BoolArray) -> FloatArray:
        """(K,) share of the patches (K, S) that are judged; NaN where they are too few."""
        count = judged.sum(axis=1)
        share = (those & judged).sum(axis=1) / np.maximum(count, 1)
        return np.where(count >= self.config.least_judged, share, np.nan)

    def _behind(self, view: int, k: int, looked_for: LookedFor) -> tuple[FloatArray, FloatArray]:
        """How far behind patches, where they are in view k, a view sees something, and clearly so.

        Along their normals (S,), NaN where a patch does not face the camera or nothing is seen.
        """
        planes, uv = self.planes[view], looked_for.uv[k]
        moved, normal = looked_for.moved(k)
        rays = moved - planes.T_world_cam.translation()[:, None]
        cosine = -(normal * rays).sum(axis=0) / np.linalg.norm(rays, axis=0)
        camera = planes.camera
        u, v = np.nan_to_num(uv, nan=-1.0).round().astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        seen_m = np.where(inside, planes.depth_m[np.where(inside, v, 0), np.where(inside, u, 0)], 0)
        expected_m = planes.T_world_cam.rotation().matrix()[:, 2] @ rays
        behind = (seen_m - expected_m) * cosine
        facing = inside & (cosine > self.config.least_cosine)
        clear_m = looked_for.gate_m + 3 * planes.noise.sigma_m(expected_m, camera.fx)
        return np.where(facing, behind, np.nan), np.asarray(clear_m)

    def _patches(self, R_world: FloatArray, t_world: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and normals (3, S) in the reference pose, one a cell."""
        points, normals = [], []
        for k, cloud in enumerate(self.clouds):
            points.append((cloud.p_world - t_world[k]) @ R_world[k])
            normals.append(cloud.normal_world @ R_world[k])
        x = np.concatenate([np.zeros((0, 3)), *points])  # no frame may show any of the part
        n = np.concatenate([np.zeros((0, 3)), *normals])
        cell = self.config.cell_m
        while True:
            first = _first_of_each(np.floor(x / cell).astype(np.int64))
            if first.size <= self.config.max_patches:
                return np.ascontiguousarray(x[first].T), np.ascontiguousarray(n[first].T)
            cell *= 1.1 * np.sqrt(first.size / self.config.max_patches)


def patch_views(
    frames: Sequence[int],
    planes: Sequence[DepthPlanes],
    rng: np.random.Generator,
    config: PatchConfig | None = None,
    points_per_frame: int | None = None,
) -> PatchViews:
    """Views of keyframes whose planes are fitted.

    Args:
        frames: numbers of the keyframes in the recording.
        planes: of each, within the part's mask.
        rng: draws the points at which patches may be set.
        config: tuning.
        points_per_frame: None for every pixel with a plane.
    """
    config = config or PatchConfig()
    kept = [k for k, p in enumerate(planes) if p.valid.any()]
    clouds = tuple(
        sample_cloud(planes[k], frames[k], rng, points_per_frame, config.stride_px) for k in kept
    )
    numbers, fitted = tuple(frames[k] for k in kept), tuple(planes[k] for k in kept)
    return PatchViews(numbers, fitted, clouds, config)


def _first_of_each(cells: NDArray[np.int64]) -> NDArray[np.int_]:
    """Indices of the first row of each distinct (n, 3) cell."""
    if not len(cells):
        return np.zeros(0, dtype=int)
    low = cells.min(axis=0)
    spread = cells.max(axis=0) - low + 1
    key = ((cells[:, 0] - low[0]) * spread[1] + cells[:, 1] - low[1]) * spread[2]
    _, first = np.unique(key + cells[:, 2] - low[2], return_index=True)
    return np.sort(first)
