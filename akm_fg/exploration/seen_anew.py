"""A part that was moved by an attempt that opened nothing: it crept while the hand felt for it.

Where the first look shows a contact and a later one something else, the first look is no longer
what fingers should go by. The contact is then looked for anew beside where it was, and how it went
tells which way its front opens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from akm_fg.exploration.belief import WAYS, ways_of
from akm_fg.exploration.records import Contact, Exploration, Way
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class SeenAnewConfig:
    """What counts as moved."""

    radius_m: float = 0.03  # about a contact, as wide as a handle: behind it may be the same front
    off_m: float = 0.01  # of the depth there
    off_sigmas: float = 4.0  # of a reading, on top
    least_share: float = 0.3  # of the readings that are off
    least_readings: int = 10
    least_way_m: float = 0.015  # of the contact: it is not found better than that
    reach_m: float = 0.25  # within which it is looked for: more is another handle
    noise: DepthNoiseModel = field(default_factory=DepthNoiseModel)


def changed(before: RgbdFrame, now: RgbdFrame, p_world: FloatArray, config: SeenAnewConfig) -> bool:
    """Whether a later frame shows something else than a first one around a place of it.

    False where too little is seen in both.

    Args:
        before: the first frame.
        now: a later one of the same camera, which stands still.
        p_world: (3,) on what the first frame shows.
        config: tuning.
    """
    camera, p_cam = before.camera, before.T_world_cam.transformTo(p_world)
    if p_cam[2] <= 0:
        return False
    u, v = np.rint(camera.project(p_cam)).astype(int)
    reach = int(np.ceil(camera.fx * config.radius_m / p_cam[2]))
    rows = slice(max(v - reach, 0), max(v + reach + 1, 0))
    columns = slice(max(u - reach, 0), max(u + reach + 1, 0))
    z, z_now = (frame.depth_m[rows, columns].astype(np.float64) for frame in (before, now))
    if not z.size:
        return False
    row, column = np.mgrid[: z.shape[0], : z.shape[1]]
    uv = np.stack([column + columns.start, row + rows.start], axis=-1).astype(np.float64)
    near = np.linalg.norm(camera.back_project(uv, z) - p_cam, axis=-1) < config.radius_m
    near &= np.isfinite(z_now)
    if near.sum() < config.least_readings:
        return False
    gate = config.off_m + config.off_sigmas * config.noise.sigma_m(z[near], camera.fx)
    return float((np.abs(z_now - z)[near] > gate).mean()) > config.least_share


def followed(
    exploration: Exploration, place: int, seen: Sequence[Contact], config: SeenAnewConfig
) -> Way | None:
    """Let a contact be where it has gone; the way it went, None where it is not found again.

    Args:
        exploration: its contacts, all but this one, are where they were.
        place: of the contact among these.
        seen: what a later frame shows.
        config: tuning.
    """
    contact = exploration.contacts[place]
    others = [other.p_world for k, other in enumerate(exploration.contacts) if k != place]
    best, nearest = None, config.reach_m
    for each in seen:
        way_m = float(np.linalg.norm(each.p_world - contact.p_world))
        stays = any(np.linalg.norm(each.p_world - other) < config.least_way_m for other in others)
        if each.what == contact.what and not stays and config.least_way_m < way_m < nearest:
            best, nearest = each, way_m
    if best is None:
        return None
    moved = replace(contact, p_world=best.p_world, normal_world=best.normal_world)
    exploration.contacts = tuple(
        moved if k == place else other for k, other in enumerate(exploration.contacts)
    )
    went, ways = best.p_world - contact.p_world, ways_of(contact.normal_world)
    return max(WAYS, key=lambda way: float(ways[way] @ went))
