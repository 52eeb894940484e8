"""Frames one at a time: after each, joint and state as far as they are known.

Every frame gets its state at once, the joint held. A frame where the part has not been yet becomes
a keyframe, and the leading kind's graph is solved on from where it was; any other frame is pooled
into the keyframe it is near (see `akm_fg.estimation.stream.keyframes`), so that nothing it says on
the
joint is lost and memory and time stay bounded. When enough has come in, all kinds are fitted anew
from the keyframes, exactly as `fit_tracks` would, a piece of that work a frame. No frame does two
pieces of work: where both are due, solving on and comparing take turns.
"""

from __future__ import annotations

import numpy as np

from akm_fg.errors import InsufficientData, TracksLost
from akm_fg.estimation.between_kinds.weighed_kinds import joint_posterior
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import one_blas_thread
from akm_fg.estimation.stream.keyframes import Keyframes, StreamFrame
from akm_fg.estimation.stream.kind_comparison import (
    Compare,
    Comparison,
    Snapshot,
    StreamSettings,
    compare_kinds,
)
from akm_fg.estimation.stream.leading_kind import LeadingKind
from akm_fg.estimation.stream.stream_records import (
    LEAST_KEYFRAMES,
    FrameUpdate,
    IncrementalConfig,
)
from akm_fg.estimation.stream.stream_tracks import StreamTracks
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, FloatArray, PointTracks
from akm_fg.steps import Steps, to_end

__all__ = ["FrameUpdate", "IncrementalConfig", "IncrementalFit"]

_PROVISIONAL = (
    "the joint is provisional, its deviations may be too small: "
    "only part of what is known was compared yet"
)


class IncrementalFit:
    """Fits all joint kinds to tracked points of one part, frame by frame.

    Args:
        name: of the stream, for the result.
        noise_known: False when the covariances are only nominal and the level must be found.
        seed: of the consensus sampling.
        config: how much is kept, and how often it is thought over.
        systematic_m: see `fit_tracks`.
        compare: fits all kinds when enough has come in; from the keyframes if not given. Whoever
            knows more than tracks (the part's surface, what rests) hands in his own.
        fit: how kinds are fitted.

    Raises:
        ValueError: more keyframes than the graph of a fit takes.
    """

    def __init__(
        self,
        name: str = "stream",
        noise_known: bool = True,
        seed: int = 0,
        config: IncrementalConfig | None = None,
        systematic_m: float = 0.0,
        compare: Compare | None = None,
        fit: FitConfig | None = None,
    ) -> None:
        self._config = config = config or IncrementalConfig()
        fit = fit or FitConfig()
        if config.max_keyframes > fit.max_frames:
            raise ValueError(
                f"max_keyframes {config.max_keyframes}, "
                f"expected {LEAST_KEYFRAMES} to {fit.max_frames}"
            )
        self._keyframes = Keyframes(
            config.max_keyframes, config.max_pooled, fit.rigid_motion.inlier_sigmas
        )
        self._settings = StreamSettings(
            name, noise_known, seed, systematic_m, fit, config.pieces_together
        )
        self._given = compare
        self._tracks = StreamTracks(config.max_tracks)
        self._version = 0  # of the keyframes
        self._lead: LeadingKind | None = None
        self._states: dict[int, float] = {}  # of the keyframes, under the leading kind
        self._solved_total = self._compared_total = 0
        self._to_solve = False  # the leading kind has not seen all keyframes yet
        self._pieces = 0  # of comparing since the leading kind was solved on: they take turns
        self._solving: Steps[LeadingKind] | None = None
        self._comparing: Steps[Comparison] | None = None
        self._compared: Comparison | None = None
        self._warning: str | None = None

    @property
    def lead(self) -> LeadingKind | None:
        """The moving kind that explains the stream best so far, as it was solved last."""
        return self._lead

    @property
    def keyframes(self) -> tuple[int, ...]:
        """Numbers of the frames kept, growing."""
        return tuple(self._keyframes.numbers.tolist())

    @property
    def keyframe_tracks(self) -> PointTracks:
        """What is kept: K keyframes, each the average of the frames pooled into it.

        Raises:
            TracksLost: no frame has been seen yet.
        """
        if not self._keyframes.frames:
            raise TracksLost(f"{self._settings.name}: no frame with {MIN_POINTS} tracks yet")
        return self._keyframes.tracks()

    def add(
        self, p_world: FloatArray, cov_world: FloatArray, stamp_s: float | None = None
    ) -> FrameUpdate:
        """Take in the next frame.

        Args:
            p_world: (N, 3) metres, NaN where a track is lost; N may grow from frame to frame.
            cov_world: (N, 3, 3) m^2, of the observed points.
            stamp_s: time of the frame, if known; must grow.

        Raises:
            ValueError: shapes that do not match, fewer tracks than before, covariances that are
                not positive definite, or a stamp that does not grow.
        """
        frame = self._tracks.taken_in(p_world, cov_world, stamp_s, self._keyframes)
        with one_blas_thread():
            state, is_keyframe = self._placed(frame)
            state = self._think(frame.number, is_keyframe) or state
        return self._update(frame, stamp_s, is_keyframe, state)

    def posterior(self) -> ArticulationPosterior:
        """All kinds compared over the keyframes as they are now; states are the keyframes'.

        The same as `fit_tracks` of `keyframe_tracks`, but for the states' deviations: the state
        of a pooled keyframe is known as well as its first frame alone tells it.

        Raises:
            TracksLost: fewer than two keyframes, or too few tracks of one rigid part.
            AxisUnobservable: no moving kind can be fitted; names the open direction.
        """
        with one_blas_thread():
            if self._compared is None or self._compared.version != self._version:
                self._publish(to_end(self._comparison()))
        assert self._compared is not None
        return self._compared.posterior()

    def _placed(self, frame: StreamFrame) -> tuple[tuple[float, float] | None, bool]:
        """State and deviation of a frame that becomes a keyframe (True) or is pooled into one."""
        if frame.observed.sum() < MIN_POINTS:
            return None, False
        keyframes, lead = self._keyframes, self._lead
        if not keyframes.frames:
            keyframes.add(frame, np.zeros(0), self._motion, 1.0)
            self._states[frame.number] = 0.0
            self._version += 1
            return None, True
        scale = 1.0 if lead is None else lead.scale
        distance, noise = keyframes.distances(frame, self._members(frame), scale)
        state = self._state(frame, int(np.argmin(distance)))
        if state is not None:
            self._states[frame.number] = state[0]
        elif lead is not None:
            return None, False
        if lead is not None and state is not None and self._moves():
            q = np.array([self._states.get(n, np.inf) for n in keyframes.numbers.tolist()])
            distance = lead.lever_m * np.abs(q - state[0])
            noise = np.full(q.size, lead.lever_m * state[1])
        place = keyframes.place_of(distance, noise, self._moves(), self._config)
        if place is None:
            keyframes.add(frame, distance, self._motion, scale)
        else:
            there = frame.moved(*self._motion(frame.number, keyframes.frames[place].number))
            keyframes.pool(place, there, scale)
        kept = set(keyframes.numbers.tolist())
        self._states = {n: q for n, q in self._states.items() if n in kept}
        self._version += 1
        return state, place is None

    def _moves(self) -> bool:
        """Whether a kind of motion has been named: then states tell places apart.

        Noise across the path must not choose what is averaged with what: means of frames chosen
        by it lie apart even where nothing moved. Noise along the path may: the states are free.
        Before, the frames of a place are shared out in turn.
        """
        if self._lead is None or self._compared is None:
            return False
        return self._compared.fitted.posterior.kind == self._lead.fit.kind

    def _members(self, frame: StreamFrame) -> BoolArray:
        """(N,) tracks that tell how far the part is: those known to be its, where enough are."""
        if self._lead is not None:
            members = np.isin(self._tracks.ids, self._lead.ids)
            if (members & frame.observed).sum() >= MIN_POINTS:
                return np.asarray(members)
        return np.ones(self._tracks.ids.size, dtype=bool)

    def _state(self, frame: StreamFrame, nearest: int) -> tuple[float, float] | None:
        if self._lead is None:
            return None
        start = self._states.get(self._keyframes.frames[nearest].number, 0.0)
        return self._lead.state(frame, self._tracks.ids, start)

    def _motion(self, number_from: int, number_to: int) -> tuple[FloatArray, FloatArray]:
        """Of the part between two frames; none as long as no kind of motion leads."""
        known = number_from in self._states and number_to in self._states
        if self._lead is None or not known:
            return np.eye(3), np.zeros(3)
        return self._lead.motion(self._states[number_from], self._states[number_to])

    def _solve_on(self, number: int) -> tuple[float, float] | None:
        """A piece of solving the leading kind with the keyframes as they were when it began.

        Returns the state and deviation of the frame that came in if it was solved for.
        """
        assert self._lead is not None
        if self._solving is None:
            self._solved_total, self._to_solve = self._keyframes.total, False
            self._solving = self._lead.solved_on(self._keyframes, self._tracks.ids, self._states)
        try:
            next(self._solving)
            return None
        except StopIteration as end:
            self._solving, self._lead = None, end.value
        except InsufficientData as error:
            self._solving, self._warning = None, str(error)
            return None
        lead = self._lead
        self._states |= zip(lead.numbers.tolist(), lead.fit.q.tolist(), strict=True)
        if number not in lead.numbers:
            return None
        place = int(np.searchsorted(lead.numbers, number))
        return float(lead.fit.q[place]), float(lead.fit.state_sd[place])

    def _think(self, number: int, is_keyframe: bool) -> tuple[float, float] | None:
        """One piece of work, if there is reason to: solve on, or go on comparing the kinds.

        Returns the state and deviation of the frame that came in if it was solved for.
        """
        total, config = self._keyframes.total, self._config
        if self._comparing is None:
            own = self._given is None  # else every frame may tell more
            comparable = total if own else number + 1
            places = len(self._keyframes.frames) if own else number + 1
            due = comparable > (1 + config.growth_to_compare) * self._compared_total
            if places > 1 and (due or (is_keyframe and self._lead is None)):
                self._compared_total = comparable
                self._comparing = self._comparison()
        grown = total > (1 + config.growth_to_solve) * self._solved_total
        self._to_solve |= is_keyframe or (grown and self._comparing is None)
        its_turn = self._comparing is None or self._pieces >= config.pieces_to_solve
        followed = self._lead is not None and self._lead.ids.size >= MIN_POINTS
        if followed and its_turn and (self._to_solve or self._solving is not None):
            self._pieces = 0
            return self._solve_on(number)
        if self._comparing is not None:
            self._pieces += 1
            self._compare_on(self._comparing)
        return None

    def _compare_on(self, comparing: Steps[Comparison]) -> None:
        try:
            next(comparing)
        except StopIteration as end:
            self._publish(end.value)
            self._to_solve = True  # with what came in meanwhile
        except InsufficientData as error:
            self._comparing, self._warning = None, str(error)

    def _publish(self, compared: Comparison) -> None:
        self._comparing, self._solving, self._warning = None, None, None
        if compared.whole:
            self._compared = compared
        else:
            self._compared_total = 0  # the whole of it is due at once
        self._lead = LeadingKind.of(compared)
        self._states = {}
        if self._lead is not None:
            self._states = self._lead.states(self._keyframes, self._tracks.ids)

    def _comparison(self) -> Steps[Comparison]:
        """A comparison that begins now."""
        if self._given is not None:
            return self._given(self._lead is not None)
        return compare_kinds(self._snapshot(), self._settings)

    def _snapshot(self) -> Snapshot:
        keyframes = self._keyframes
        return Snapshot(
            self.keyframe_tracks,
            self._tracks.ids,
            keyframes.numbers,
            np.array(keyframes.counts),
            self._version,
        )

    def _update(
        self,
        frame: StreamFrame,
        stamp_s: float | None,
        is_keyframe: bool,
        state: tuple[float, float] | None,
    ) -> FrameUpdate:
        posterior = None if self._compared is None else self._compared.fitted.posterior
        leads_alone = self._compared is None and self._lead is not None
        provisional = _PROVISIONAL if leads_alone else None
        return FrameUpdate(
            number=frame.number,
            stamp_s=stamp_s,
            is_keyframe=is_keyframe,
            kind="undecided" if posterior is None else posterior.kind,
            kind_probability={} if posterior is None else posterior.kind_probability,
            joint=None if self._lead is None else joint_posterior(self._lead.fit),
            state=None if state is None else state[0],
            state_sd=None if state is None else state[1],
            zero_frame=None if self._lead is None else int(self._lead.numbers[0]),
            keyframes=len(self._keyframes.frames),
            warning=self._warning or provisional,
        )
