"""The recursive filters that others have written well: the one place that knows filterpy.

A grid of states for a start from anywhere (`filterpy.discrete_bayes`), and a Gaussian over state
and rate (`filterpy.kalman.UnscentedKalmanFilter`) from there on.
"""

from __future__ import annotations

import numpy as np
from filterpy.discrete_bayes import normalize, predict, update
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

from akm_fg.records import FloatArray


class GridFilter:
    """Probabilities of states on an even grid."""

    def __init__(self, states: FloatArray) -> None:
        """All alike at first; `states` (Q,) grow evenly."""
        self.states = states
        self.probability: FloatArray = normalize(np.ones(states.size))

    def predict(self, shift: float, sd: float) -> None:
        """The part moved by `shift`, give or take `sd`; at the grid's ends it stays."""
        if self.states.size < 2:
            return
        step = float(self.states[1] - self.states[0])
        reach = max(int(np.ceil(3.0 * sd / step)), 1)
        offsets = np.arange(-reach, reach + 1) * step
        kernel = normalize(np.exp(-0.5 * (offsets / max(sd, 0.3 * step)) ** 2))
        moved = predict(self.probability, round(shift / step), kernel, mode="constant")
        self.probability = normalize(np.maximum(moved, 1e-300))

    def update(self, log_likelihood: FloatArray) -> None:
        """Take in how well each state (Q,) explains what is seen."""
        likelihood = np.exp(log_likelihood - log_likelihood.max())
        self.probability = normalize(np.maximum(update(likelihood, self.probability), 1e-300))


class StateFilter:
    """A Gaussian over a joint's state and its rate.

    The rate decays: x' = (q + g dt r, d r) with d = exp(-dt / damping), g = damping (1 - d) / dt.
    """

    def __init__(self, q: float, sd: float, rate_sd: float, damping_s: float) -> None:
        self._damping_s, self._rate_sd = damping_s, rate_sd
        points = JulierSigmaPoints(n=2, kappa=1.0)
        self._filter = UnscentedKalmanFilter(2, 1, 1.0, _state_of, self._moved, points)
        self._filter.x = np.array([q, 0.0])
        self._filter.P = np.diag([sd**2, rate_sd**2])

    @property
    def mean(self) -> float:
        """Of the state."""
        return float(self._filter.x[0])

    @property
    def rate(self) -> float:
        """Mean of the rate."""
        return float(self._filter.x[1])

    @property
    def variance(self) -> float:
        """Of the state."""
        return float(self._filter.P[0, 0])

    def predict(self, dt_s: float, shift: float | None = None, shift_sd: float = 0.0) -> None:
        """Go on by a time.

        Args:
            dt_s: since the last frame.
            shift: how far the part moved, where that is known otherwise; None: by its rate.
            shift_sd: standard deviation of that.
        """
        if shift is not None:
            x, P = self._filter.x.copy(), self._filter.P.copy()
            x[0] += shift
            x[1] = 0.0
            P[0, 0] += shift_sd**2
            P[0, 1] = P[1, 0] = 0.0
            P[1, 1] = self._rate_sd**2
            self._filter.x, self._filter.P = x, P
            return
        decay = float(np.exp(-dt_s / self._damping_s))
        # White noise that keeps the rate's deviation: what a second of unknown motion may bring.
        rate_var = self._rate_sd**2 * (1.0 - decay**2)
        self._filter.Q = np.array([[rate_var * dt_s**2 / 3.0, rate_var * dt_s / 2.0],
                                   [rate_var * dt_s / 2.0, rate_var]])  # fmt: skip
        self._filter.predict(dt=dt_s)

    def innovation(self, q: float, variance: float) -> float:
        """Normalised innovation squared of a measured state."""
        return (q - self.mean) ** 2 / (self.variance + variance)

    def update(self, q: float, variance: float) -> None:
        """Take in a measured state."""
        kalman = self._filter
        kalman.sigmas_f = kalman.points_fn.sigma_points(kalman.x, kalman.P)
        kalman.update(np.array([q]), R=np.array([[variance]]))
        kalman.P = 0.5 * (kalman.P + kalman.P.T)

    def _moved(self, x: FloatArray, dt: float) -> FloatArray:
        decay = float(np.exp(-dt / self._damping_s))
        return np.array([x[0] + self._damping_s * (1.0 - decay) * x[1], decay * x[1]])


def _state_of(x: FloatArray) -> FloatArray:
    return x[:1]
