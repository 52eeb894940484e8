"""The states of all parts of a model: a filter each, and no part taken for another.

The parts do not touch each other's joints, so given where the others are their states are
independent; one filter over all would have a grid that grows by a power with their number. What
couples them is the picture: one may hide another, and one open front may stand where another
would. Pixels that show a part where it is known to be are therefore no evidence for the others:
they carry no depth in the frames that these get.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.model.records import ModelPart, ObjectModel
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, RgbdFrame
from akm_fg.relocalization.config import RelocalizationConfig
from akm_fg.relocalization.records import StateBelief
from akm_fg.relocalization.relocalizer import Relocalizer
from akm_fg.stream.seen_so_far import Hand

WINDOW_PX = 2  # about a surface's points, which lie 4 mm apart: 2 px at 1.2 m
GATE_M = 0.01  # of depth from them, with the noise of the surface and of the state
GATE_SIGMAS = 3.0
MOVED_SIGMAS = 4.0  # between two states of a part, beyond which it has moved
MOST_SD_M = 0.02  # of the points' way: a state that is known worse masks nothing


class PartsRelocalizer:
    """Follows the states of all parts of a known object through frames of a camera.

    Args:
        model: of the object.
        noise: of the depth.
        config: tuning of each part's filter.
        scale_told: place of the part of which the caller knows better than the model how far off
            the camera's lengths are; its deviations do not hold that.
    """

    def __init__(
        self,
        model: ObjectModel,
        noise: DepthNoiseModel | None = None,
        config: RelocalizationConfig | None = None,
        scale_told: int | None = None,
    ) -> None:
        self._parts, self._noise = model.parts, noise or DepthNoiseModel()
        self._filters = [
            Relocalizer(model, place, noise, config, scale_told=place == scale_told)
            for place in range(len(model.parts))
        ]
        self._beliefs: list[StateBelief | None] = [None] * len(model.parts)

    def update(
        self,
        frame: RgbdFrame,
        hand: Hand | None = None,
        held: int | None = None,
        commanded: float | None = None,
        felt: tuple[float, float] | None = None,
    ) -> tuple[StateBelief, ...]:
        """Take in the next frame; a belief for each part, in the model's order.

        Args:
            frame: later than the last one; the robot's own pixels carry no depth.
            hand: the gripper then, where it is known.
            held: place of the part that it holds, or is about to; None: not known. Only its filter
                is moved by the hand and the command.
            commanded: how far that part was told to move since the last frame, m or rad.
            felt: its state and deviation by a hand that has just taken hold of it, m or rad.

        Raises:
            ValueError: a stamp that does not grow, or a part that is not there.
        """
        if held is not None and not 0 <= held < len(self._parts):
            raise ValueError(f"part {held} of {len(self._parts)}")
        if len(self._parts) == 1:
            held = 0
        # Those that are known best go first: what they explain is no evidence for the others.
        masks: dict[int, BoolArray] = {}
        for place in self._known_first():
            others = [mask for other, mask in masks.items() if other != place]
            others += [
                shown(self._parts[other], belief, frame, self._noise)
                for other, belief in enumerate(self._beliefs)
                if belief is not None and other != place and other not in masks
            ]
            own = _without(frame, others)
            moved = place == held
            belief = self._filters[place].update(own, *((hand, commanded, felt) if moved else ()))
            self._beliefs[place] = belief
            masks[place] = shown(self._parts[place], belief, frame, self._noise)
        return tuple(belief for belief in self._beliefs if belief is not None)

    def _known_first(self) -> list[int]:
        def vague(place: int) -> float:
            belief = self._beliefs[place]
            known = belief is not None and belief.mode == "tracking" and belief.sd is not None
            return belief.sd if known else np.inf  # type: ignore[union-attr,return-value]

        return sorted(range(len(self._parts)), key=vague)


@dataclass(frozen=True, slots=True)
class Beside:
    """A part that was not meant to move: where it was first found, and where it was last seen."""

    first: StateBelief
    last: StateBelief

    @property
    def state(self) -> tuple[float, float]:
        """Where it was last seen, and the standard deviation of that."""
        return _state(self.last)

    @property
    def moved(self) -> bool:
        """By more than both beliefs leave open."""
        (q0, sd0), (q1, sd1) = (_state(belief) for belief in (self.first, self.last))
        return abs(q1 - q0) > MOVED_SIGMAS * float(np.hypot(sd0, sd1))


class FollowedPart:
    """One part of a model, as a manipulator asks for it; the others are followed beside it.

    Args:
        model: of the object.
        place: of the part among the model's.
        noise: of the depth.
        config: tuning of each part's filter.
    """

    def __init__(
        self,
        model: ObjectModel,
        place: int,
        noise: DepthNoiseModel | None = None,
        config: RelocalizationConfig | None = None,
    ) -> None:
        self._all, self._place = PartsRelocalizer(model, noise, config, scale_told=place), place
        self._names = [part.name for part in model.parts]
        self.beside: dict[str, Beside | None] = {
            name: None for number, name in enumerate(self._names) if number != place
        }

    def update(
        self,
        frame: RgbdFrame,
        hand: Hand | None = None,
        commanded: float | None = None,
        felt: tuple[float, float] | None = None,
    ) -> StateBelief:
        """Take in the next frame; the belief of the followed part.

        Raises:
            ValueError: a stamp that does not grow.
        """
        beliefs = self._all.update(frame, hand, self._place, commanded, felt)
        for name, belief in zip(self._names, beliefs, strict=True):
            if name in self.beside and belief.mode == "tracking" and belief.seen:
                known = self.beside[name]
                self.beside[name] = Beside(known.first if known else belief, belief)
        return beliefs[self._place]


def _state(belief: StateBelief) -> tuple[float, float]:
    assert belief.mean is not None and belief.sd is not None
    return belief.mean, belief.sd


def shown(
    part: ModelPart, belief: StateBelief, frame: RgbdFrame, noise: DepthNoiseModel
) -> BoolArray:
    """(H, W) pixels whose depth is that of a part where it is believed to be; none if it is vague.

    Args:
        part: with its surface.
        belief: of its state.
        frame: with the depth.
        noise: of the depth.
    """
    mask = np.zeros(frame.depth_m.shape, dtype=bool)
    if belief.mode != "tracking" or belief.mean is None or belief.sd is None:
        return mask
    T = frame.T_world_cam.inverse() * part.T_seen_part(belief.mean)
    p_cam = part.surface.p_world @ T.rotation().matrix().T + T.translation()
    way = part.joint.joint.velocity(part.surface.p_world)
    sd_m = belief.sd * float(np.linalg.norm(way, axis=1).max())
    if sd_m > MOST_SD_M:
        return mask
    uv = np.nan_to_num(np.rint(frame.camera.project(p_cam)), nan=-1.0).astype(int)
    gate_m = GATE_M + GATE_SIGMAS * np.hypot(noise.sigma_m(p_cam[:, 2], frame.camera.fx), sd_m)
    height, width = frame.camera.height, frame.camera.width
    for du in range(-WINDOW_PX, WINDOW_PX + 1):
        for dv in range(-WINDOW_PX, WINDOW_PX + 1):
            u, v = uv[:, 0] + du, uv[:, 1] + dv
            inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
            u, v = u[inside], v[inside]
            near = np.abs(frame.depth_m[v, u] - p_cam[inside, 2]) < gate_m[inside]
            mask[v[near], u[near]] = True
    return mask


def _without(frame: RgbdFrame, masks: Sequence[BoolArray]) -> RgbdFrame:
    """The frame without depth at the pixels of some masks."""
    if not any(mask.any() for mask in masks):
        return frame
    hidden = np.logical_or.reduce(masks)
    return replace(frame, depth_m=np.where(hidden, np.nan, frame.depth_m).astype(np.float32))
