"""The kind that explains a stream best so far, solved on from where it is as keyframes come."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.kind_fit import kind_in_steps
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.one_kind.states import model_variance, solved_states, state_sd_beside
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.estimation.stream.keyframes import Keyframes, StreamFrame
from akm_fg.estimation.stream.kind_comparison import Comparison
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.records import FloatArray
from akm_fg.steps import Steps
from factors.measurements.track_cost import TrackObservations


@dataclass(frozen=True, slots=True)
class LeadingKind:
    """A solved moving kind over some keyframes of a stream."""

    fit: KindFit  # with the correlations and systematic errors of the noise in its covariance
    problem: FitProblem  # the one in which it won
    ids: NDArray[np.int_]  # (N,) tracks of the part, the caller's indices
    numbers: NDArray[np.int_]  # (K,) frames of the graph, growing
    model_variance: FloatArray  # (K - 1,) of states, beyond their own frame's noise

    @staticmethod
    def of(comparison: Comparison) -> LeadingKind | None:
        """The likeliest kind; None where that is rigid."""
        fitted = comparison.fitted
        probability = fitted.posterior.kind_probability
        fit = max(fitted.fits, key=lambda fit: probability[fit.kind])
        if fit.joint is None:
            return None
        return _of_fit(fit, fitted.problem, comparison.ids, comparison.numbers)

    @property
    def lever_m(self) -> float:
        """Root mean square way of its points for a unit of the state."""
        joint, x = self.fit.moving, self.fit.tracks.x_joint
        if not joint.kind.turns:
            return 1.0
        return float(np.sqrt((x[0] ** 2 + x[1] ** 2).mean() + joint.pitch**2))

    @property
    def scale(self) -> float:
        """Noise over its claimed standard deviation."""
        return self.fit.tracks.scale

    def state(
        self, frame: StreamFrame, ids: NDArray[np.int_], start: float
    ) -> tuple[float, float] | None:
        """State of a frame and its standard deviation, the joint held; None if it is not seen."""
        columns = _columns(self.ids, ids)
        kept = columns >= 0
        p, cov = frame.p_world[columns[kept]], frame.cov_world[columns[kept]]
        if np.isfinite(p[:, 0]).sum() < MIN_POINTS:
            return None
        tracks = TrackObservations.from_points(p[None], cov[None])
        config = self.problem.config
        here = _of_columns(self.fit, kept)
        q, information = solved_states(here, tracks, np.array([start]), config)
        sd = state_sd_beside(self.fit, q, information, self.model_variance)
        return float(q[0]), float(sd[0])

    def motion(self, q_from: float, q_to: float) -> tuple[FloatArray, FloatArray]:
        """Takes points of the part from one state to another: R (3, 3), t (3,)."""
        q = np.array([q_from, q_to])
        R, t = self.fit.moving.motion(q)
        turn = R[1] @ R[0].T
        return turn, t[1] - turn @ t[0]

    def solved_on(
        self, keyframes: Keyframes, ids: NDArray[np.int_], states: dict[int, float]
    ) -> Steps[LeadingKind]:
        """The kind solved with the keyframes as they are now, from where it was, in steps.

        Args:
            keyframes: of the stream.
            ids: of the keyframes' tracks.
            states: of the keyframes, to start from, by number; a frame without one is left out.

        Raises:
            AxisUnobservable: the data leave a direction open.
        """
        columns = _columns(self.ids, ids)
        tracks, numbers = keyframes.tracks(), keyframes.numbers
        observed = tracks.observed[:, columns] & (columns >= 0)
        usable = (observed.sum(axis=1) >= MIN_POINTS) & (numbers >= self.numbers[0])
        usable &= np.isin(numbers, list(states))
        kept = observed[usable].any(axis=0)
        frames = np.union1d(numbers[usable], self._of_other_sources())
        p = np.full((frames.size, int(kept.sum()), 3), np.nan)
        cov = np.full((*p.shape, 3), np.nan)
        at = np.searchsorted(frames, numbers[usable])
        p[at] = tracks.p_world[usable][:, columns[kept]]
        cov[at] = tracks.cov_world[usable][:, columns[kept]]
        problem = self._problem_over(frames, TrackObservations.from_points(p, cov))
        known = dict(zip(self.numbers.tolist(), self.fit.q.tolist(), strict=True)) | states
        q = np.array([known[number] for number in frames.tolist()])
        guess = JointGuess(self.fit.moving, q - q[0])
        fit = yield from kind_in_steps(guess, problem, _of_columns(self.fit, kept))
        fit = fit.tempered(self.fit.as_one).pointing_forward()
        return _of_fit(fit, problem, self.ids[kept], frames)

    def _of_other_sources(self) -> NDArray[np.int_]:
        """Numbers of the graph's frames of which more is known than what tracks say."""
        own = [source.own_frames for source in self.problem.sources[1:]]
        return self.numbers[np.unique(np.concatenate([np.zeros(0, dtype=int), *own]))]

    def _problem_over(self, frames: NDArray[np.int_], tracks: TrackObservations) -> FitProblem:
        """The problem over other frames (numbers), with their tracks."""
        there = np.isin(self.numbers, frames)
        places = np.where(there, np.searchsorted(frames, self.numbers), -1)
        others = tuple(source.moved(places) for source in self.problem.sources[1:])
        source = replace(self.problem.tracks, observations=tracks, x_world=None)
        return replace(self.problem, keyframes=frames, sources=(source, *others))

    def states(self, keyframes: Keyframes, ids: NDArray[np.int_]) -> dict[int, float]:
        """States of all keyframes that see the part, by number."""
        known = dict(zip(self.numbers.tolist(), self.fit.q.tolist(), strict=True))
        states = {}
        for frame in keyframes.frames:
            if frame.number in known:
                states[frame.number] = known[frame.number]
                continue
            start = float(np.interp(frame.number, self.numbers, self.fit.q))
            solved = self.state(frame, ids, start)
            if solved is not None:
                states[frame.number] = solved[0]
        return states


def _of_fit(
    fit: KindFit, problem: FitProblem, ids: NDArray[np.int_], numbers: NDArray[np.int_]
) -> LeadingKind:
    model = model_variance(fit, problem.tracks.observations, problem.config)
    return LeadingKind(fit, problem, ids, numbers, model)


def _of_columns(fit: KindFit, kept: NDArray[np.bool_]) -> KindFit:
    """The fit with the latent points of some of its tracks."""
    tracks = replace(fit.tracks, x_joint=fit.tracks.x_joint[:, kept], slips=None)
    return replace(fit, said={**fit.said, TRACKS: tracks})


def _columns(wanted: NDArray[np.int_], ids: NDArray[np.int_]) -> NDArray[np.int_]:
    """Places of wanted ids among ids; -1 where they are not."""
    order = np.argsort(ids)
    places = np.searchsorted(ids, wanted, sorter=order).clip(0, max(ids.size - 1, 0))
    found = order[places]
    return np.where(ids[found] == wanted, found, -1)
