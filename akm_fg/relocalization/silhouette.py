"""Where a part stands whose known surface is not seen: as a board, by what it hides and what not.

A door that stands edge-on to the camera shows little of the front that the model knows; turned
farther it shows its back, which no model knows. But it is a board with a front, an edge and a back,
and it stands somewhere. Along the ray of each cell of the image that a state's board covers,
between the nearest and the farthest of its points there, a reading z lies

    on it      p(z | q) = w_on / (z_max - z_min + 2 slack): something stands there
    behind it  p(z | q) = w_behind / D: the camera looks through, so the part does not stand so
    before it  p(z | q) = w_before / D: something is in the way

against p(z | no part) = 1 / 2D. What rests explains readings, too, and these say nothing for a
state. So a part that is gone stands nowhere: no state has its readings, and absence alone is no
evidence for the states in which little would be seen. Nor is anything said where what rests is not
seen where the model has it: then it is not this object, or not this camera's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.model.records import ModelPart, Surface
from akm_fg.perception.surface.known_surface import KnownSurface
from akm_fg.records import BoolArray, FloatArray, RgbdFrame
from akm_fg.relocalization.config import SilhouetteConfig
from akm_fg.relocalization.likelihood import Shares, spread


@dataclass(frozen=True, slots=True)
class Stands:
    """Where a part stands, as the camera sees its joint."""

    mean: float  # m or rad
    sd: float  # with what outlines are off by
    probability: float  # of being within three deviations, among the states that were asked
    shares: Shares  # of the likeliest state's cells


class Silhouette:
    """The board of one part: front, edge and back.

    Args:
        part: whose state is asked.
        static: what rests.
        config: tuning.
    """

    def __init__(self, part: ModelPart, static: Surface, config: SilhouetteConfig) -> None:
        self.config = config
        joint = part.seen_joint.joint
        (R,), (t,) = joint.motion(np.array([-part.seen_state(part.closed_state)]))
        solid = _solid(part.surface, config) @ R.T + t
        self._board = KnownSurface(joint, solid, np.zeros_like(solid))
        self._static = static.p_world[spread(static.p_world, config.static_points)]

    def stands(self, frame: RgbdFrame, states: FloatArray) -> Stands | None:
        """Where it stands among states (Q,) that grow evenly; None: nowhere that can be told."""
        c = self.config
        rests = _grid_of(frame, self._in_camera(frame, self._static), c.cell_px)
        if not self._is_seen(frame, rests):
            return None
        told = [self.told(frame, float(q), rests.near) for q in states]
        score = np.array([each for each, _ in told])
        best = int(score.argmax())
        shares = told[best][1]
        if score[best] < c.least_log_odds or shares.readings < c.least_cells:
            return None
        if shares.on < c.least_on or shares.behind > c.most_behind:
            return None
        weight = np.exp(score - score[best])
        weight = weight / weight.sum()
        mean = float(weight @ states)
        floor = self.least_sd(mean)
        sd = float(np.sqrt(weight @ (states - mean) ** 2 + floor**2))
        if sd > c.most_floors * floor:
            return None  # it may stand here or there
        near = float(weight[np.abs(states - mean) <= 3.0 * sd].sum())
        return Stands(mean, sd, min(near, 1.0), shares)

    def least_sd(self, q: float) -> float:
        """Deviation about a state that no outline betters."""
        return self.config.outline_m / max(self._board.metres_per_unit(q), 1e-9)

    def told(self, frame: RgbdFrame, q: float, rests: FloatArray) -> tuple[float, Shares]:
        """Evidence for a state, nats, and what its cells read.

        Args:
            frame: with the depth.
            q: state.
            rests: nearest depth of what rests, in cells.
        """
        c = self.config
        grid = _grid_of(frame, self._in_camera(frame, self._board.moved(q)[0]), c.cell_px)
        read = frame.depth_m[grid.v, grid.u].astype(np.float64)
        z_min, z_max = (each[grid.at] for each in (grid.near - c.slack_m, grid.far + c.slack_m))
        on = (read >= z_min) & (read <= z_max)
        explained = np.abs(read - rests[grid.at]) < c.explained_m
        used = np.isfinite(read) & (rests[grid.at] >= z_min) & ~(on & explained)
        cell = np.ravel_multi_index(grid.at, grid.near.shape)[used]
        # Of several points in a cell each counts its share.
        share = 1.0 / np.bincount(cell, minlength=grid.near.size)[cell]
        on, behind = on[used], (read > z_max)[used]
        density = np.where(behind, c.behind, c.before) / c.depth_range_m
        density[on] = c.on / (z_max - z_min)[used][on]
        evidence = float(share @ np.log(2.0 * c.depth_range_m * density)) / c.as_one
        total = max(float(share.sum()), 1e-9)
        parts = [float(share[chosen].sum()) / total for chosen in (on, ~on & ~behind, behind)]
        return evidence, Shares(round(float(share.sum())), *parts)

    def _is_seen(self, frame: RgbdFrame, rests: _Grid) -> bool:
        """Whether what rests is seen where the model has it, as far as nothing stands before it."""
        c = self.config
        off = frame.depth_m[rests.v, rests.u] - rests.z
        shown = rests.z < rests.near[rests.at] + c.static_off_m
        seen = np.isfinite(off) & (off > -c.static_off_m) & shown
        if not seen.any():
            return False
        return float((off[seen] < c.static_off_m).mean()) >= c.least_static

    @staticmethod
    def _in_camera(frame: RgbdFrame, p_world: FloatArray) -> FloatArray:
        T = frame.T_world_cam
        return np.asarray((p_world - T.translation()) @ T.rotation().matrix())


def facing(frame: RgbdFrame, x: FloatArray, normal: FloatArray, least_cosine: float) -> BoolArray:
    """(S,) whether points (S, 3) with normals are turned to the camera enough to be read."""
    rays = frame.T_world_cam.translation() - x
    cosine = (rays * normal).sum(axis=1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    return np.asarray(cosine > least_cosine)


@dataclass(frozen=True, slots=True)
class _Grid:
    """Points of which the image has pixels, and the depths that cells of the image span."""

    u: NDArray[np.int_]  # (N,)
    v: NDArray[np.int_]  # (N,)
    z: FloatArray  # (N,)
    at: tuple[NDArray[np.int_], NDArray[np.int_]]  # row and column of each point's cell
    near: FloatArray  # (R, C) of a cell and its neighbours; infinite where there is none
    far: FloatArray


def _grid_of(frame: RgbdFrame, p_cam: FloatArray, cell_px: int) -> _Grid:
    camera = frame.camera
    uv = np.nan_to_num(camera.project(p_cam), nan=-1.0).round().astype(int)
    inside = np.asarray((uv >= 0).all(axis=1) & (uv < (camera.width, camera.height)).all(axis=1))
    (u, v), z = uv[inside].T, p_cam[inside, 2]
    at = v // cell_px, u // cell_px
    shape = -(-camera.height // cell_px), -(-camera.width // cell_px)
    near, far = np.full(shape, np.inf), np.full(shape, -np.inf)
    np.minimum.at(near, at, z)
    np.maximum.at(far, at, z)
    return _Grid(u, v, z, at, -_around(-near), _around(far))


def _around(far: FloatArray) -> FloatArray:
    """The greatest of each cell and its eight neighbours."""
    wide = np.pad(far, 1, constant_values=-np.inf)
    wide = np.maximum(np.maximum(wide[:-2], wide[1:-1]), wide[2:])
    return np.asarray(np.maximum(np.maximum(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:]))


def _solid(surface: Surface, config: SilhouetteConfig) -> FloatArray:
    """Points (N, 3) of the surface, and of the board behind the plane that most of it lies on."""
    chosen = spread(surface.p_world, config.points)
    x = surface.p_world[chosen]
    outwards = surface.normal_world[chosen].mean(axis=0)
    outwards = outwards / max(float(np.linalg.norm(outwards)), 1e-9)
    depth = x @ outwards
    flat = np.abs(depth - np.median(depth)) < config.flat_m
    behind = [x[flat] - share * config.board_m * outwards for share in config.layers]
    return np.concatenate([x, *behind])
