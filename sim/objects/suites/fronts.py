"""What the locked fronts of an object carry: handles like the free one's, and decoys."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.meshes import Box
from sim.objects.part_spec import Hinge
from sim.objects.suites.furniture_body import Body, Corners
from sim.objects.suites.furniture_spec import FurnitureSpec, HandleSpec, fitted, handle_spot
from sim.objects.suites.handles import R_LYING, edge_strip, handle_boxes, pose_on_front
from sim.objects.suites.manners import seeming_hinge

RAIL_LENGTH = 0.7  # of its panel's width
RAIL_M = (0.014, 0.045)  # thickness, and from the panel to the middle of the bar
KNOB_M = (0.036, 0.030)  # diameter, and from the panel to the middle of the head
NOWHERE = np.full(3, np.nan)


@dataclass(frozen=True, slots=True)
class Dressed:
    """What is on the locked fronts, and where. Object frame."""

    boxes: list[Box]  # on the locked fronts
    p_handles: list[FloatArray]  # (3,) of every place where one could grip; NaN on a blind front
    more: list[list[Box]]  # on those of the spec's further fronts that open
    p_more: list[FloatArray]  # (3,) of their handles


def dress(spec: FurnitureSpec, body: Body) -> Dressed:
    """Handles and decoys on an object's other fronts, in the order of the fronts, then knobs."""
    rng = np.random.default_rng([*spec.key, 63])
    boxes: list[Box] = []
    p_handles: list[FloatArray] = []
    freed = dict(zip(body.more_in_locked(), spec.more, strict=True))
    of_freed: dict[int, tuple[list[Box], FloatArray]] = {}
    for i, (lower, upper) in enumerate(body.locked):
        hinge = _hinge_of(spec, upper - lower, rng)
        if i in freed:
            found, T = _like_the_free_one(spec, freed[i].hinge, lower, upper)
            of_freed[freed[i].front] = found, T.translation()
            continue
        if i in spec.looks.blind:
            p_handles.append(NOWHERE)
            continue
        if i in spec.looks.rails:
            found, T = _rail(lower, upper)
        else:
            found, T = _like_the_free_one(spec, hinge, lower, upper)
        boxes += found
        p_handles.append(T.translation())
    for T in _knob_poses(spec, body.panel):
        boxes += handle_boxes(_knob(), T)
        p_handles.append(T.translation())
    named = [_renamed(box, i) for i, box in enumerate(boxes)]
    carried = [of_freed[front.front] for front in spec.more]
    return Dressed(named, p_handles, [boxes for boxes, _ in carried], [p for _, p in carried])


def _hinge_of(spec: FurnitureSpec, size_m: FloatArray, rng: np.random.Generator) -> Hinge | None:
    """What a locked front looks like; boards that are pinched can be so on one side alone."""
    seeming = seeming_hinge((float(size_m[0]), float(size_m[2])), rng)
    if spec.handle.style != "edge":
        return seeming
    if spec.hinge in ("left", "right"):
        return "left" if rng.random() < 0.5 else "right"
    return None


def _like_the_free_one(
    spec: FurnitureSpec, hinge: Hinge | None, lower: FloatArray, upper: FloatArray
) -> tuple[list[Box], gtsam.Pose3]:
    size = upper - lower
    upright = handle_spot(spec.handle, spec.looks, hinge, spec.family).upright
    handle = fitted(spec.handle, upright, (float(size[0]), float(size[2])))
    T = pose_on_front(spec, hinge, handle, lower, upper)
    if handle.style == "edge":
        return [edge_strip(spec, hinge, lower, upper)], T
    return handle_boxes(handle, T), T


def _rail(lower: FloatArray, upper: FloatArray) -> tuple[list[Box], gtsam.Pose3]:
    """A towel rail on a panel that never opens."""
    thickness, reach = RAIL_M
    length = RAIL_LENGTH * float(upper[0] - lower[0])
    rail = HandleSpec("rod", length, thickness, reach, 0.0, 0.0)
    p_object = (lower + upper) / 2.0
    p_object[1] = lower[1] - reach
    p_object[2] += (upper[2] - lower[2]) / 4.0
    T = gtsam.Pose3(gtsam.Rot3(R_LYING), p_object)
    return handle_boxes(rail, T), T


def _knob() -> HandleSpec:
    diameter, reach = KNOB_M
    return HandleSpec("knob", diameter, diameter, reach, 0.0, 0.0)


def _knob_poses(spec: FurnitureSpec, panel: Corners | None) -> list[gtsam.Pose3]:
    """T_object_knob, evenly along the panel's longer side."""
    if panel is None:
        return []
    lower, upper = panel
    along = 0 if upper[0] - lower[0] > upper[2] - lower[2] else 2
    poses = []
    for i in range(spec.looks.knobs):
        p_object = (lower + upper) / 2.0
        p_object[along] = lower[along] + (upper - lower)[along] * (i + 1) / (spec.looks.knobs + 1)
        p_object[1] = lower[1] - KNOB_M[1]
        poses.append(gtsam.Pose3(gtsam.Rot3(R_LYING), p_object))
    return poses


def _renamed(box: Box, i: int) -> Box:
    return Box(f"locked_{i}", box.size_m, box.T_link_box, box.material, box.rounded)
