"""One model of several parts from models of one part each, made one after the other.

Each came from its own recording, in which the parts known before stood still: they are in its
resting surface, at the states that they had, and are taken out of it here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from akm_fg.model.config import ModelConfig
from akm_fg.model.records import ModelPart, ObjectModel, Surface
from akm_fg.records import BoolArray, FloatArray


def with_found(
    model: ObjectModel,
    found: ObjectModel,
    states: Sequence[float],
    config: ModelConfig | None = None,
) -> ObjectModel:
    """A model with the parts of another, which was made later of the same object and world.

    Args:
        model: what was known.
        found: what was found after it; its parts get the next numbers for names.
        states: of the model's parts while `found` was recorded, m or rad.
        config: tuning of the surfaces.

    Raises:
        ValueError: states of other parts.
    """
    config = config or ModelConfig()
    if len(states) != len(model.parts):
        raise ValueError(f"{len(states)} states of {len(model.parts)} parts")
    parts = tuple(_named(part, model) for part in model.parts)
    new = tuple(
        replace(_named(part, found), name=f"part-{len(parts) + i}")
        for i, part in enumerate(found.parts)
    )
    before = _without(model.static, [part.surface.p_world for part in new], config)
    standing = [_placed(part, float(q)) for part, q in zip(parts, states, strict=True)]
    closed = [part.surface.p_world for part in parts]
    # What lay behind a part that stood open belongs to the object; where the part itself was, and
    # where it is when closed, nothing rests.
    after = _without(found.static, [*standing, *closed], config)
    sources = dict.fromkeys([*model.sources, *found.sources])
    return ObjectModel(
        (*parts, *new), _together(before, after, config), model.camera, model.T_world_cam,
        tuple(sources),
    )  # fmt: skip


def _named(part: ModelPart, model: ObjectModel) -> ModelPart:
    """With its own recordings, which those of a model with one part are."""
    return part if part.sources else replace(part, sources=model.sources)


def _placed(part: ModelPart, q: float) -> FloatArray:
    """Points (N, 3) of a part's surface at a state."""
    T = part.T_seen_part(q)
    return np.asarray(part.surface.p_world @ T.rotation().matrix().T + T.translation())


def _without(static: Surface, parts: Sequence[FloatArray], config: ModelConfig) -> Surface:
    """What rests, less what lies on any of the clouds (N, 3)."""
    if not len(static):
        return static
    on_part = np.zeros(len(static), dtype=bool)
    for p_world in parts:
        on_part |= _near(static.p_world, p_world, config.gate_m + config.voxel_m)
    return static.select(~on_part)


def _together(first: Surface, second: Surface, config: ModelConfig) -> Surface:
    """The first surface, and of the second what the first does not have."""
    if len(first):
        second = second.select(~_near(second.p_world, first.p_world, config.voxel_m))
    own = [_own(surface) for surface in (first, second)]
    known = first.on_object is not None or second.on_object is not None
    return Surface(
        np.concatenate([first.p_world, second.p_world]),
        np.concatenate([first.normal_world, second.normal_world]),
        np.concatenate([first.rgb, second.rgb]),
        np.concatenate(own) if known else None,
    )


def _own(surface: Surface) -> BoolArray:
    """(N,) the object's own points: all where nothing is said."""
    if surface.on_object is None:
        return np.ones(len(surface), dtype=bool)
    return surface.on_object


def _near(p_world: FloatArray, others: FloatArray, within_m: float) -> BoolArray:
    """(N,) points (N, 3) that another cloud (M, 3) comes near."""
    if not len(others):
        return np.zeros(len(p_world), dtype=bool)
    distance, _ = cKDTree(others).query(p_world, distance_upper_bound=within_m)
    return np.isfinite(distance)
