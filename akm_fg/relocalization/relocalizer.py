"""The filter: from anywhere to a Gaussian, from frame to frame, and back when it is lost.

searching: grid over the range -> hypotheses -> refined -> sure of one -> tracking
unseen:    no surface is found -> it stands where its outline can only be -> tracking
tracking:  predicted by hand, command or rate -> surface found again -> gate -> updated
lost:      frames contradict the belief, or it explains nothing -> searching
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from akm_fg.model.records import ObjectModel
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import FloatArray, RgbdFrame
from akm_fg.relocalization.bayes_filters import GridFilter, StateFilter
from akm_fg.relocalization.config import RelocalizationConfig
from akm_fg.relocalization.likelihood import StateLikelihood
from akm_fg.relocalization.records import Hypotheses, Mode, StateBelief
from akm_fg.relocalization.silhouette import Silhouette, Stands, facing
from akm_fg.relocalization.surface_state import SurfaceState
from akm_fg.stream.seen_so_far import Hand


class Relocalizer:
    """Follows the state of one part of a known object through frames of a camera.

    Args:
        model: of the object.
        part: place of the part among the model's.
        noise: of the depth.
        config: tuning.
        scale_told: whether the caller knows better than the model how far off the camera's lengths
            are; deviations do not hold that then.
    """

    def __init__(
        self,
        model: ObjectModel,
        part: int = 0,
        noise: DepthNoiseModel | None = None,
        config: RelocalizationConfig | None = None,
        scale_told: bool = False,
    ) -> None:
        self._scale_told = scale_told
        self.config, self.part = config or RelocalizationConfig(), model.parts[part]
        self._noise = noise or DepthNoiseModel()
        self._likelihood = StateLikelihood(self.part, model.static, self.config.likelihood)
        self._silhouette = Silhouette(self.part, model.static, self.config.silhouette)
        self._grid = GridFilter(self._states())
        self._surface = SurfaceState(self._likelihood, self._noise, self.config, self._grid.states)
        self._filter: StateFilter | None = None
        self._probability = 0.0  # of the tracked hypothesis
        self._stamp_s: float | None = None
        self._hand: Hand | None = None
        self._against = 0  # frames in a row that contradict the belief
        self._lost_because: str | None = None

    def update(
        self,
        frame: RgbdFrame,
        hand: Hand | None = None,
        commanded: float | None = None,
        felt: tuple[float, float] | None = None,
    ) -> StateBelief:
        """Take in the next frame.

        Args:
            frame: later than the last one; the robot's own pixels carry no depth.
            hand: the gripper then, where it is known.
            commanded: how far the part was told to move since the last frame, m or rad.
            felt: state and deviation that a hand tells which has just taken hold, m or rad. It
                counts where the frame does not show the part and the belief does not exclude it.

        Raises:
            ValueError: a stamp that does not grow.
        """
        if self._stamp_s is not None and frame.stamp_s <= self._stamp_s:
            raise ValueError(f"a frame at {frame.stamp_s} s after one at {self._stamp_s} s")
        dt_s = 0.0 if self._stamp_s is None else frame.stamp_s - self._stamp_s
        shift = self._shift(hand, commanded)
        if felt is not None and shift is None and hand is not None:
            shift = self._touched(hand, dt_s)
        self._stamp_s, self._hand = frame.stamp_s, hand
        if self._filter is None:
            return self._told(self._search(frame, dt_s, shift))
        return self._told(self._track(frame, dt_s, shift, felt))

    def _told(self, belief: StateBelief) -> StateBelief:
        """In states of the model; within, they are as the camera sees them."""
        unit = self.part.seen_state(1.0)

        def true(x: float | None) -> float | None:
            return None if x is None else x / unit

        mean, sd, correction = true(belief.mean), true(belief.sd), self.part.correction
        if correction is not None and mean is not None and sd is not None and not self._scale_told:
            opened = mean - self.part.closed_state
            sd = float(np.hypot(sd, correction.length_share_sd * opened))
        return replace(
            belief, mean=mean, sd=sd, rate=true(belief.rate), predicted=true(belief.predicted)
        )

    def _states(self) -> FloatArray:
        """The grid, over all states that the part may have."""
        c, joint = self.config.search, self.part.joint.joint
        low, high = (self.part.seen_state(q) for q in self.part.range_seen())
        if self.part.limits is None:
            most = c.most_rad if joint.kind.turns else c.most_m
            opens = 1.0 if abs(high - self.part.closed_state) >= abs(low - self.part.closed_state) \
                else -1.0  # fmt: skip
            end = self.part.closed_state + opens * most
            low, high = min(low, end), max(high, end)
        slack = c.below * (high - low)
        surface = self._likelihood.surface
        way = np.linalg.norm(surface.joint.velocity(surface.moved(low)[0]), axis=1)
        step = c.step_m / max(float(way.max()), 1e-6)
        count = int(np.clip((high - low + 2 * slack) / step, 2, c.most_states))
        return np.linspace(low - slack, high + slack, count)

    def _shift(self, hand: Hand | None, commanded: float | None) -> tuple[float, float] | None:
        """How far the part moved since the last frame, and its deviation; None: nobody knows."""
        c, last = self.config.motion, self._hand
        if hand is not None and last is not None and hand.holding and last.holding:
            moved = hand.T_world_gripper.translation() - last.T_world_gripper.translation()
            way = self.part.joint.joint.velocity(last.T_world_gripper.translation())
            lever = float(way @ way)
            if lever > 1e-6:
                return float(moved @ way) / lever, c.hand_m / float(np.sqrt(lever))
        if commanded is not None:
            slack = c.commanded_share * abs(commanded)
            return commanded, slack + 1e-4
        return None

    def _touched(self, hand: Hand, dt_s: float) -> tuple[float, float] | None:
        """As `_shift`, of a part that a hand has just taken hold of: nobody else was there."""
        c = self.config.motion
        way = self.part.joint.joint.velocity(hand.T_world_gripper.translation())
        lever = float(np.linalg.norm(way))
        return (0.0, c.touched_m / lever) if dt_s <= c.reach_s and lever > 1e-3 else None

    def _search(
        self, frame: RgbdFrame, dt_s: float, shift: tuple[float, float] | None
    ) -> StateBelief:
        """Over the whole range."""
        c = self.config
        rate = self._rate_sd()
        moved, sd = shift if shift is not None else (0.0, rate * dt_s)
        if dt_s > 0.0:
            self._grid.predict(moved, sd)
        odds = self._likelihood.log_odds(frame, self._noise, self._grid.states)
        if odds.max() < c.search.least_log_odds:
            reason = self._lost_because or "the part is not seen at any state"
            return self._unseen(frame, reason)
        self._grid.update(odds + self._colours(frame, self._grid.states))
        found = self._hypotheses(frame)
        if found.q.size == 0:
            return self._unseen(frame, "no state explains the surface that is seen")
        best = float(found.q[0]), float(found.sd[0]), float(found.probability[0])
        sd = float(np.sqrt(best[1] ** 2 + self._of_model(best[0])))
        if best[2] >= c.sure:
            self._filter = StateFilter(best[0], best[1], rate, c.motion.damping_s)
            self._probability, self._against, self._lost_because = best[2], 0, None
            return StateBelief(frame.stamp_s, "tracking", best[0], sd, 0.0, best[2], True, None)
        reason = f"{found.q.size} states explain what is seen"
        return StateBelief(
            frame.stamp_s, "searching", best[0], sd, None, best[2], True, None, None, reason
        )

    def _unseen(self, frame: RgbdFrame, reason: str) -> StateBelief:
        """By its outline, of a part whose surface is not found; nothing where that is silent."""
        stands = self._stood(frame, self._grid.states)
        if stands is None:
            return self._nothing(frame, reason)
        return self._stands(frame, stands, None)

    def _stands(self, frame: RgbdFrame, stands: Stands, predicted: float | None) -> StateBelief:
        """Follow from where the outline puts it."""
        damping_s = self.config.motion.damping_s
        self._filter = StateFilter(stands.mean, stands.sd, self._rate_sd(), damping_s)
        self._probability, self._against, self._lost_because = stands.probability, 0, None
        sd = float(np.sqrt(stands.sd**2 + self._of_model(stands.mean)))
        return StateBelief(
            frame.stamp_s, "tracking", stands.mean, sd, 0.0, stands.probability, False, None,
            predicted, self._said(stands.mean, sd), by_outline=True,
        )  # fmt: skip

    def _said(self, mean: float, sd: float) -> str:
        unit, name = (np.rad2deg(1.0), "deg") if self.part.joint.turns else (100.0, "cm")
        closed = self.part.seen_state(self.part.closed_state)
        low, high = sorted(abs(mean + off * sd - closed) * unit for off in (-2.0, 2.0))
        told = f"it can only stand between {low:.1f} and {high:.1f} {name}"
        return f"the part's surface is not seen: by its outline {told}"

    def _stood(self, frame: RgbdFrame, states: FloatArray) -> Stands | None:
        """Where its outline puts it, of a part that hardly faces the camera there.

        One that does is found by its surface, or is not there: its outline is no other's opinion.
        """
        c, stands = self.config, self._silhouette.stands(frame, states)
        if stands is None or stands.probability < c.sure:
            return None
        x, normal = self._likelihood.surface.moved(stands.mean)
        faces = facing(frame, x, normal, c.likelihood.least_cosine)
        return stands if faces.mean() < c.silhouette.most_facing else None

    def _outlined(self, frame: RgbdFrame) -> Stands | None:
        """Where its outline puts a followed part, if that is surer than the belief, and agrees.

        To be taken instead of the belief, not into it: outlines err alike in all frames.
        """
        assert self._filter is not None
        c, kalman = self.config, self._filter
        sd = float(np.sqrt(kalman.variance))
        if sd < c.silhouette.worth * self._silhouette.least_sd(kalman.mean):
            return None
        near = np.abs(self._grid.states - kalman.mean) <= c.silhouette.reach_sigmas * sd
        if near.sum() < 3:
            return None
        stands = self._stood(frame, self._grid.states[near])
        if stands is None or stands.sd >= sd:
            return None
        agrees = kalman.innovation(stands.mean, stands.sd**2) <= c.gate_nis
        return stands if agrees else None

    def _nothing(self, frame: RgbdFrame, reason: str) -> StateBelief:
        mode: Mode = "searching" if self._lost_because is None else "lost"
        return StateBelief(frame.stamp_s, mode, None, None, None, 0.0, False, None, reason=reason)

    def _hypotheses(self, frame: RgbdFrame) -> Hypotheses:
        """Peaks of the grid, refined, those that end in one place taken together."""
        c, p, q = self.config.search, self._grid.probability, self._grid.states
        higher = np.concatenate([[True], p[1:] >= p[:-1]]) & np.concatenate(
            [p[:-1] >= p[1:], [True]]
        )
        peaks = np.flatnonzero(higher & (p > 1e-6))
        peaks = peaks[np.argsort(-p[peaks])][: c.kept]
        step = float(q[1] - q[0])
        found: list[tuple[float, float, float]] = []
        ends = [self._surface.measured(frame, float(q[k]), 1.5 * step) for k in peaks]
        told = [
            (end, float(q[k]))
            for end, k in zip(ends, peaks, strict=True)
            if end is not None and self._fits(frame, end.q)
        ]
        if not told:
            return Hypotheses(np.zeros(0), np.zeros(0), np.zeros(0))
        there = np.array([end.q for end, _ in told])
        odds = self._likelihood.log_odds(frame, self._noise, there) + self._colours(frame, there)
        prior = np.log(np.interp([at for _, at in told], q, p))
        # The grid's own look at this frame is in its probabilities: peaks count it once.
        begun = np.array([at for _, at in told])
        own = self._likelihood.log_odds(frame, self._noise, begun) + self._colours(frame, begun)
        score = prior - own + odds
        for k in np.argsort(-score):
            end = told[k][0]
            sd = float(np.sqrt(end.variance))
            if all(abs(end.q - other[0]) > c.apart_sigmas * (sd + other[1]) for other in found):
                found.append((end.q, sd, float(score[k])))
        scores = np.array([score for _, _, score in found])
        weights = np.exp(scores - scores.max())
        # What is not near any peak may be it too.
        rest = float(np.clip(1.0 - self._near(np.array([f[0] for f in found]), step), 0.0, 1.0))
        weights = weights / weights.sum() * (1.0 - rest)
        return Hypotheses(np.array([f[0] for f in found]), np.array([f[1] for f in found]), weights)

    def _colours(self, frame: RgbdFrame, states: FloatArray) -> FloatArray:
        """(Q,) what colours say, nats, of a part whose depth is alike at many states."""
        if self._likelihood.slides_along_itself >= self.config.outline_along:
            return np.zeros(len(states))
        return self._likelihood.colours(frame, states)

    def _fits(self, frame: RgbdFrame, q: float) -> bool:
        """Whether what is seen at a state is the part, as far as nothing stands in the way."""
        c, shares = self.config.search, self._likelihood.shares(frame, self._noise, q)
        enough = shares.readings >= c.least_readings and shares.on >= c.least_on
        return enough and shares.behind <= c.most_behind

    def _near(self, q: FloatArray, step: float) -> float:
        """Share of the grid's probability within three steps of any of the states."""
        off = np.abs(self._grid.states[:, None] - q[None]).min(axis=1)
        return float(self._grid.probability[off <= 3.0 * step].sum())

    def _track(
        self,
        frame: RgbdFrame,
        dt_s: float,
        shift: tuple[float, float] | None,
        felt: tuple[float, float] | None,
    ) -> StateBelief:
        """From where it was."""
        assert self._filter is not None
        c, kalman = self.config, self._filter
        if shift is None:
            kalman.predict(dt_s)
        else:
            kalman.predict(dt_s, *shift)
        predicted = kalman.mean
        reach = 3.0 * float(np.sqrt(kalman.variance))
        measured = self._surface.measured(frame, predicted, reach)
        nis, reason = None, None
        if felt is not None and measured is None:
            self._feel(*felt)
        if measured is None:
            stands = self._outlined(frame)
            if stands is not None:
                return self._stands(frame, stands, predicted)
        if measured is not None:
            nis = kalman.innovation(measured.q, measured.variance)
            if nis <= c.gate_nis:
                kalman.update(measured.q, measured.variance)
                self._against = 0
            else:
                self._against += 1
                reason = "the surface is found where the belief does not expect it"
        else:
            reason = self._against_belief(frame, predicted)
            self._against += reason is not None
            reason = reason or "the part is hidden"
        if self._against >= c.patience:
            return self._lose(frame, reason or "frames contradict the belief")
        mean, sd = kalman.mean, float(np.sqrt(kalman.variance + self._of_model(kalman.mean)))
        seen = measured is not None and reason is None
        return StateBelief(
            frame.stamp_s, "tracking", mean, sd, kalman.rate, self._probability, seen, nis,
            predicted, reason,
        )  # fmt: skip

    def _feel(self, q: float, sd: float) -> None:
        """Take in what a hand tells, unless the belief is surer of another state."""
        assert self._filter is not None
        q, sd = self.part.seen_state(q), self.part.seen_state(sd)
        if self._filter.innovation(q, sd**2) <= self.config.gate_nis:
            self._filter.update(q, sd**2)

    def _lose(self, frame: RgbdFrame, reason: str) -> StateBelief:
        """Give the belief up, and look everywhere, in this very frame."""
        self._filter, self._lost_because = None, reason
        self._grid = GridFilter(self._grid.states)
        belief = self._search(frame, 0.0, None)
        if belief.mode == "tracking" and belief.seen:
            return StateBelief(
                belief.stamp_s, "tracking", belief.mean, belief.sd, belief.rate,
                belief.probability, True, None, None, f"lost ({reason}) and found again",
            )  # fmt: skip
        return belief

    def _against_belief(self, frame: RgbdFrame, q: float) -> str | None:
        """Why a part that is not found where it is believed is not just hidden; None: it may be."""
        c, shares = self.config.search, self._likelihood.shares(frame, self._noise, q)
        if shares.readings < c.least_readings:
            return None
        if shares.behind > 0.5:
            return "the camera looks through where the part should be"
        held = self._hand is not None and self._hand.holding
        if held and shares.on >= c.on_as_believed:
            return None  # an arm hides most of it: what is seen besides is where the hand has it
        states = self._grid.states[:: c.elsewhere]
        odds = self._likelihood.log_odds(frame, self._noise, states)
        best = float(states[int(odds.argmax())])
        here = float(self._likelihood.log_odds(frame, self._noise, np.array([q]))[0])
        if odds.max() - max(here, 0.0) < c.least_log_odds:
            return None
        measured = self._surface.measured(frame, best, 2.0 * abs(float(states[1] - states[0])))
        if measured is None or not self._fits(frame, measured.q):
            return None
        return "the part is seen at another state"

    def _of_model(self, q: float) -> float:
        """Variance of a state that the joint's own covariance leaves, the surface held.

        The joint's error xi moves the points by their ways along it, the state by -s xi with
        s = sum w J_q J_xi / sum w J_q^2: a consider state of Schmidt's filter, which no frame
        betters (Jazwinski, Stochastic Processes and Filtering Theory, 1970, sec. 8.4).
        """
        surface, joint = self._likelihood.surface, self.part.seen_joint
        x, normal = surface.moved(q)
        by_xi = joint.joint.motion_jacobians(np.array([q]))[0][0]  # (6, 6)
        way = np.cross(by_xi[:3].T[:, None], x[None]) + by_xi[3:].T[:, None]  # (6, S, 3)
        J_xi = np.einsum("ksi,si->sk", way, normal)
        J_q = (surface.joint.velocity(x) * normal).sum(axis=1)
        total = float(J_q @ J_q)
        if total <= 0.0:
            return 0.0
        s = J_q @ J_xi / total
        return float(s @ joint.cov @ s)

    def _rate_sd(self) -> float:
        c = self.config.motion
        return c.rate_sd_rad_s if self.part.joint.turns else c.rate_sd_m_s
