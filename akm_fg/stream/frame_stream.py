"""A frame goes in, the posterior so far comes out: perception, graph and kinds advance together.

Every frame is watched (tracked, lifted), gets its state with the leading joint held, and moves the
thinking on by at most one bounded piece of work (`akm_fg.estimation.stream.incremental`): the
leading kind's graph solved on, or a piece of comparing all kinds by what is kept, exactly as a
recording of the same frames is fitted. `posterior` does at once what is left to do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import one_blas_thread
from akm_fg.estimation.sources.state_knowledge import StateKnowledge
from akm_fg.estimation.stream.incremental import IncrementalFit
from akm_fg.estimation.stream.kind_comparison import Compare, Comparison
from akm_fg.estimation.stream.leading_kind import LeadingKind
from akm_fg.estimation.stream.stream_records import FrameUpdate, IncrementalConfig
from akm_fg.records import BoolArray, CalibrationErrors, RgbdFrame
from akm_fg.stages import ModelSettings, RecordingFit, Stages
from akm_fg.steps import Steps, every
from akm_fg.stream.seen_so_far import Hand, SeenSoFar
from akm_fg.stream.surface_state import HeldSurface

__all__ = ["FrameStream", "FrameUpdate"]


class FrameStream:
    """The joint of an object that one fixed camera watches, frame by frame.

    Args:
        name: of the posterior, and in messages.
        settings: how the frames are modelled, and how often what came is thought over.
        stages: who masks, tracks and estimates; an estimator that is handed in is asked by
            `posterior` alone.
        calibration: what is not known of the camera; `posterior` holds it, updates do not.
    """

    def __init__(
        self,
        name: str = "stream",
        settings: ModelSettings | None = None,
        stages: Stages | None = None,
        calibration: CalibrationErrors | None = None,
    ) -> None:
        settings = settings or ModelSettings()
        one_blas_thread()  # looks through all libraries once: not in the first frame's time
        self._seen = SeenSoFar(name, settings, stages, calibration)
        self._thinking = IncrementalFit(
            name,
            seed=settings.seed,
            config=_within(settings.stream.thinking, settings.fit),
            systematic_m=settings.fit.camera_systematic_m,
            compare=_comparing(self._seen),
            fit=settings.fit,
        )
        self._lead: LeadingKind | None = None  # that the surface below is of
        self._surface: HeldSurface | None = None
        self._state = 0.0  # where to look for it

    def add(
        self, frame: RgbdFrame, hand: Hand | None = None, object_mask: BoolArray | None = None
    ) -> FrameUpdate:
        """Take in the next frame.

        Args:
            frame: later than the last one.
            hand: the gripper at that time, where it is known.
            object_mask: (H, W) the object in it, where that is known.

        Raises:
            TracksLost: no object is seen in the first frame; the next one is the first again.
            ValueError: a stamp that does not grow.
        """
        seen = self._seen.watch(frame, hand, object_mask)
        p_world = np.full((self._seen.points, 3), np.nan)
        cov_world = np.full((*p_world.shape, 3), np.nan)
        p_world[seen.pixels.index], cov_world[seen.pixels.index] = seen.p_world, seen.cov_world
        update = self._thinking.add(p_world, cov_world, frame.stamp_s)
        return update if update.state is not None else self._by_surface(update, frame)

    def _by_surface(self, update: FrameUpdate, frame: RgbdFrame) -> FrameUpdate:
        """With the state that the part's surface tells, where tracks tell none."""
        lead, config = self._thinking.lead, self._seen.settings.stream.surface_state
        if lead is None:
            return update
        if lead is not self._lead:
            self._lead = lead
            self._surface = HeldSurface.of(lead.fit, lead.problem.sources, config)
            self._state = float(lead.fit.q[-1])
        if self._surface is None:
            return update
        noise = self._seen.settings.perception.observe.noise
        found = self._surface.state(frame, noise, self._state, config)
        if found is None:
            return update
        self._state = found[0]
        return replace(update, state=found[0], state_sd=found[1])

    def posterior(self) -> RecordingFit:
        """What was seen and what it means: what `fit_recording` says of the same frames.

        Raises:
            TracksLost: nothing on the object could be followed and depth shows no motion.
            NoMotionObserved: nothing moved beyond the noise.
            AxisUnobservable: no moving kind can be fitted.
        """
        return self._seen.answer()


def _within(thinking: IncrementalConfig, fit: FitConfig) -> IncrementalConfig:
    """With no more keyframes than a graph of the fit takes."""
    return replace(thinking, max_keyframes=min(thinking.max_keyframes, fit.max_frames))


def _comparing(seen: SeenSoFar) -> Compare:
    """Compares the kinds by all that was seen, as it is when a comparison begins.

    As long as none leads, by the tracks alone first: that takes a few frames, the surface many.
    """

    def compare(led: bool) -> Steps[Comparison]:
        numbers, soon, config = seen.numbers, not led, seen.settings.stream
        together = max(1, config.frames_a_piece // numbers.size)
        if soon:
            try:
                estimate = yield from every(together, seen.estimate_in_steps("tracks"))
            except InsufficientData:  # depth may show what tracks do not
                if numbers.size < config.least_frames:
                    raise
                numbers, soon = seen.numbers, False
        if not soon:
            estimate = yield from every(together, seen.estimate_in_steps())
        fitted = _beside_the_clock(estimate.fitted)
        frames = numbers[fitted.problem.keyframes]
        counts = np.ones(frames.size, dtype=int)
        return Comparison(fitted, estimate.members, frames, counts, None, not soon)

    return compare


def _beside_the_clock(fitted: FittedKinds) -> FittedKinds:
    """Without what binds the states of given frames by their times: others are going to come."""
    problem = fitted.problem
    sources = tuple(
        replace(source, stamps_s=None, sigma_m_per_sqrt_s=None, sigma_m_per_s_three_halves=None)
        if isinstance(source, StateKnowledge)
        else source
        for source in problem.sources
    )
    return replace(fitted, problem=replace(problem, sources=sources))
