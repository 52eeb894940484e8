"""How likely a grasp holds: a logistic regression on what is seen of it.

Its weights are a guess that was held against simulated pulls of `furniture-dev`
(docs/decisions/0018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.grasping.closing import Closing
from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class GraspEvidence:
    """What speaks for and against one grasp."""

    closing: Closing | None  # None: of a board's edge, whose other side is not seen
    tilt_rad: float  # of the approach, from straight onto the front
    hidden: float  # share of the fingers' way that the camera could not see
    rows: float  # pixels across what is held


@dataclass(frozen=True, slots=True)
class QualityWeights:
    """Of the log odds."""

    held: float = 3.5  # where everything else is as good as can be
    uncovered: float = -1.5  # times the share of the pads without anything between
    slope: float = -1.0  # a radian
    taper: float = -0.3  # a radian
    hidden: float = -1.2
    tilt: float = -0.5  # a radian
    few_rows: float = -1.0  # times 1 / pixels across what is held: the middle is then unsure
    beside: float = -1.2  # something else between the open fingers
    edge: float = -3.5  # a board whose thickness is guessed, with room behind it or without


def holds(evidence: GraspEvidence, weights: QualityWeights) -> float:
    """Probability that the grasp holds."""
    w, c = weights, evidence.closing
    odds = w.held + w.hidden * evidence.hidden + w.tilt * abs(evidence.tilt_rad)
    odds += w.few_rows / max(evidence.rows, 1.0)
    if c is None:
        odds += w.edge
    else:
        odds += w.uncovered * (1.0 - c.covered) + w.taper * c.taper_rad
        odds += w.slope * c.slope_rad + w.beside * (c.beside > 0)
    return float(1.0 / (1.0 + np.exp(-odds)))


def features(evidence: GraspEvidence) -> FloatArray:
    """(8,) what the weights multiply, without `held`, in their order."""
    c = evidence.closing
    return np.array(
        [
            1.0 - c.covered if c else 0.0,
            c.slope_rad if c else 0.0,
            c.taper_rad if c else 0.0,
            evidence.hidden,
            abs(evidence.tilt_rad),
            1.0 / max(evidence.rows, 1.0),
            float(c.beside > 0) if c else 0.0,
            float(c is None),
        ]
    )
