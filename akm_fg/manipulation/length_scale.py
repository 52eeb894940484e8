"""The camera's scale of lengths, learned from a hand that holds what the camera sees.

A camera whose depth or focal length is off by a share s sees every way of a sliding part as
(1 + s) times what it is: no picture shows it. The hand's own way, by its joint angles, does: while
it holds the part,

    q_camera(t) - q_camera(t_0) = (1 + s) (h(t) - h(t_0)) + e,   e ~ N(0, 2 sd^2 + hand^2),

with h the way of the hand along the joint. Of each hold the longest way counts, once: its frames
share the errors of the first and last. States counted from closed are divided by 1 + s.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from factors.joint import Joint


@dataclass(frozen=True, slots=True)
class LengthScaleConfig:
    """How exactly the hand tells a way."""

    hand_m: float = 0.001  # pads give, at either end
    hand_share: float = 0.002  # of the way: encoders off by 0.05 deg
    least_m: float = 0.03  # shorter ways tell nothing
    gate_sigmas: float = 3.0  # of the calibration and the hand, beyond which the hand has slipped


class LengthScale:
    """What is known of the scale.

    Args:
        joint: of the part; of one that turns, states are angles and have no scale.
        sd: of s, as the calibration has it; 0: the camera is taken for exact.
        config: tuning.
    """

    def __init__(self, joint: Joint, sd: float, config: LengthScaleConfig | None = None) -> None:
        self._joint, self._config = joint, config or LengthScaleConfig()
        self._exact = joint.kind.turns or sd <= 0.0
        self._prior_sd = 0.0 if self._exact else sd
        self._holds: list[tuple[float, float]] = []  # of each that ended: s and its sd
        self._begun: tuple[float, FloatArray] | None = None
        self._longest: tuple[float, float, float] | None = None  # way, s, its sd

    @property
    def mean(self) -> float:
        """Of s."""
        return self._posterior()[0]

    @property
    def sd(self) -> float:
        """Of s."""
        return self._posterior()[1]

    def held(self, q_camera: float, sd: float, T_world_hand: gtsam.Pose3) -> None:
        """A frame in which the hand holds the part, and the camera sees it."""
        if self._exact:
            return
        here = T_world_hand.translation()
        if self._begun is None:
            self._begun = q_camera, here
            return
        q0, start = self._begun
        way = float(self._joint.velocity(start) @ (here - start))
        c = self._config
        if abs(way) < c.least_m or (self._longest and abs(way) < abs(self._longest[0])):
            return
        off = float(np.hypot(np.hypot(np.sqrt(2.0) * sd, c.hand_m) / abs(way), c.hand_share))
        s = (q_camera - q0) / way - 1.0
        if abs(s) > c.gate_sigmas * np.hypot(self._prior_sd, off):
            # No calibration is so far off: the hand has slipped along what it holds.
            self._begun, self._longest = (q_camera, here), None
            return
        self._longest = way, s, off

    def let_go(self) -> None:
        """The hold ended, or the fingers slipped."""
        if self._longest is not None:
            self._holds.append(self._longest[1:])
        self._begun = self._longest = None

    def true_state(self, q_camera: float, sd: float, closed: float) -> tuple[float, float]:
        """State and standard deviation with the scale taken out."""
        s, s_sd = self._posterior()
        q = (q_camera - closed) / (1.0 + s)
        return closed + q, float(np.hypot(sd, s_sd * q))

    def _posterior(self) -> tuple[float, float]:
        if self._exact:
            return 0.0, 0.0
        told = [*self._holds, *([self._longest[1:]] if self._longest else [])]
        information, weighted = self._prior_sd**-2, 0.0
        for s, sd in told:
            information += sd**-2
            weighted += s * sd**-2
        return weighted / information, float(information**-0.5)
