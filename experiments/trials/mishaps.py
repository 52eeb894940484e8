"""What may go wrong while a part is moved, done to a simulated world and to what a run is told.

A mishap happens once: at a time, as soon as it can; at a share of the part's way, where the hand
moves it; or in what the run is handed before it begins. Times and shares are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from akm_fg.model.read import read_model
from akm_fg.model.records import ModelPart, StateLimits
from akm_fg.model.write import write_model
from akm_fg.posterior import ArticulationPosterior, NamedKind
from akm_fg.records import RgbdFrame
from sim.episode import SimEpisode
from sim.mishaps import make_slippery, push_part, stop_part, teleport_part

NOTHING = "nothing"  # the same run without a mishap, for comparison
PUSHED, TELEPORTED, BLOCKED = "part pushed unseen", "part teleported unseen", "camera blocked"
OPENED, SLIPPED = "fingers opened", "grasp slipped"
JAMMED, STOPPED = "joint jammed half way", "stop earlier than told"
WRONG_KIND, OTHERS = "wrong kind", "other object's model"
MISHAPS = (PUSHED, TELEPORTED, BLOCKED, OPENED, SLIPPED, JAMMED, STOPPED, WRONG_KIND, OTHERS)
IN_THE_MODEL = (WRONG_KIND, OTHERS)  # what is handed in is wrong, the world is not

AT_STOP = 0.02  # of the way, from a stop: it is met


@dataclass(frozen=True, slots=True)
class MishapConfig:
    """When and how much."""

    between_s: tuple[float, float] = (1.0, 7.0)  # after the run began, of what happens at a time
    again_s: float = 0.5  # where the robot was in the way
    frames: tuple[int, int] = (2, 14)  # number of the first that is dark
    blocked_frames: int = 10
    on_the_way: tuple[float, float] = (0.05, 0.9)  # share of the way, where fingers fail
    half_way: tuple[float, float] = (0.3, 0.7)  # where a part jams or meets a stop
    least_way: float = 0.1  # of the range: a part that is moved less is not moved
    slippery_mu: float = 0.03  # of the pads, while they slip
    slippery_s: float = 1.0
    told_beyond: float = 0.1  # of the range: how far beyond the target a model tells the stop


@dataclass(frozen=True, slots=True)
class Way:
    """Of the task: true states from closed, m or rad."""

    start: float
    target: float
    most: float  # end of the range in which tasks are

    def share(self, state: float) -> float:
        """Of the way that is behind a state."""
        return (state - self.start) / (self.target - self.start)


class Mishap:
    """A world's camera, behind which one thing goes wrong."""

    def __init__(
        self,
        world: SimEpisode,
        what: str,
        way: Way,
        rng: np.random.Generator,
        config: MishapConfig | None = None,
    ) -> None:
        self._world, self._what, self._way, self._rng = world, what, way, rng
        self._config = c = config or MishapConfig()
        self.happened = what in IN_THE_MODEL
        self._frames, self._dark_from = 0, int(rng.integers(*c.frames))
        self._due_s = world.world.time_s + float(rng.uniform(*c.between_s))
        self._share = float(
            rng.uniform(*(c.on_the_way if what in (OPENED, SLIPPED) else c.half_way))
        )
        self._grips_again_s: float | None = None
        if what == STOPPED:
            self._stop_early()
        world.world.every_step.append(self._step)

    def capture(self) -> RgbdFrame:
        """The scene now."""
        self._frames += 1
        frame = self._world.camera.capture()
        dark = self._dark_from <= self._frames < self._dark_from + self._config.blocked_frames
        if self._what != BLOCKED or not dark:
            return frame
        self.happened = True
        nothing = np.full_like(frame.depth_m, np.nan)
        return replace(frame, rgb=np.zeros_like(frame.rgb), depth_m=nothing)

    def _step(self) -> None:
        world = self._world.world
        if self._grips_again_s is not None and world.time_s >= self._grips_again_s:
            make_slippery(world)
            self._grips_again_s = None
        if self.happened or self._what in (NOTHING, BLOCKED):
            return
        if self._what in (PUSHED, TELEPORTED):
            # What a hand holds nobody moves away.
            if world.time_s >= self._due_s and not self._world.arm.gripper.squeezing:
                self._move_unseen()
        elif self._what == STOPPED:
            self.happened = abs(self._way.share(world.part_state()) - self._share) < AT_STOP
        elif self._way.share(world.part_state()) >= self._share:
            self._fail_on_the_way()

    def _move_unseen(self) -> None:
        """To a state drawn from the range, pushed as far as the arm lets it, or just there."""
        world, c = self._world.world, self._config
        before, state = world.part_state(), float(self._rng.uniform(0.0, self._way.most))
        (push_part if self._what == PUSHED else teleport_part)(world, state)
        self.happened = abs(world.part_state() - before) >= c.least_way * self._way.most
        self._due_s += c.again_s

    def _fail_on_the_way(self) -> None:
        if self._what == JAMMED:
            self._world.world.jam()
        elif not self._world.arm.holding():
            return
        elif self._what == OPENED:
            self._world.arm.gripper.open()
        elif self._what == SLIPPED:
            make_slippery(self._world.world, self._config.slippery_mu)
            self._grips_again_s = self._world.world.time_s + self._config.slippery_s
        self.happened = True

    def _stop_early(self) -> None:
        way = self._way
        stop = way.start + self._share * (way.target - way.start)
        low, high = (0.0, stop) if way.target > way.start else (stop, way.most)
        stop_part(self._world.world, low, high)


def handed_in(what: str, model: Path, other: Path | None, way: Way, folder: Path) -> Path:
    """The model that the run is given: its own, or one that is wrong, written to a folder.

    Raises:
        ValueError: there is no other object, or the fit of no other kind was kept.
    """
    if what == OTHERS:
        if other is None:
            raise ValueError("one object alone has no other's model")
        return other
    if what not in (WRONG_KIND, STOPPED):
        return model
    told = read_model(model)
    part = told.parts[0]
    wrong = of_wrong_kind(part) if what == WRONG_KIND else _with_stop_beyond(part, way)
    folder.mkdir(parents=True, exist_ok=True)
    return write_model(folder, replace(told, parts=(wrong, *told.parts[1:]))).parent


def of_wrong_kind(part: ModelPart) -> ModelPart:
    """The part as it were modelled had the evidence been for the other kind: its fit, believed.

    Raises:
        ValueError: that fit was not kept.
    """
    posterior = part.posterior
    kind: NamedKind = "prismatic" if part.joint.turns else "revolute"
    other = posterior.alternatives.get(kind)
    if other is None or other.joint is None:
        raise ValueError(f"no fit of a {kind} joint was kept")
    believed: ArticulationPosterior = replace(
        posterior,
        kind=kind,
        kind_probability={each: float(each == kind) for each in posterior.kind_probability},
    )
    correction = part.correction
    if correction is not None:
        correction = replace(correction, cov_seen_joint=other.joint.cov, length_share=0.0)
    contacts = tuple(replace(each, state=0.0) for each in part.contacts)  # in another unit
    return replace(
        part, posterior=believed, correction=correction, contacts=contacts, closed_state=0.0,
        limits=None,
    )  # fmt: skip


def _with_stop_beyond(part: ModelPart, way: Way) -> ModelPart:
    """As of a run that met the part's stop where it no longer is."""
    beyond = MishapConfig().told_beyond * way.most
    opens = 1.0 if part.range_seen()[1] > part.closed_state else -1.0
    ends = (part.closed_state, part.closed_state + opens * (max(way.most, way.target) + beyond))
    return replace(part, limits=StateLimits(min(ends), max(ends), 1e-3))
