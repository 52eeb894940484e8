"""Whether sources that tell of the same joint agree, and what it costs if they do not.

The tracks are fitted alone first, then with the surface or the gripper. Where all agree, the
joint of all together is off that of the tracks by d with covariance C_tracks - C_together
(Hausman, Specification tests in econometrics, 1978), as two independent sources differ by C_1 +
C_2. Where it is off by more, one of them errs in a way that it does not know (a calibration,
slipping points, depth that is late); which one cannot be told from here. As in averages of
measurements that contradict each other, all variances are then multiplied by the ratio of the
squared difference to its expectation (Birge, The calculation of errors by the method of least
squares, 1932).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats
from scipy.linalg import solve_triangular

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.one_kind.joint_chart import JointChart
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.lines import line_in_joint_frame
from akm_fg.records import FloatArray
from factors.joint import Joint

_ROUNDING = 1e-9  # of a correlation: offsets and tilts of a far line say nearly the same


def with_disagreement(
    fits: Sequence[KindFit],
    alone: Sequence[KindFit],
    as_one: float,
    centroid_world: FloatArray,
    config: FitConfig | None = None,
) -> list[KindFit]:
    """The kinds with their variances multiplied where the tracks alone contradict them.

    Args:
        fits: fitted to all sources.
        alone: to the first of them.
        as_one: observations of the tracks that count as one.
        centroid_world: (3,) of the part.
        config: what is taken for chance.
    """
    config = config or FitConfig()
    first = {fit.kind: fit.tempered(as_one) for fit in alone if fit.joint is not None}
    return [
        replace(
            fit, disagreement=_ratio(fit.tempered(as_one), first[fit.kind], centroid_world, config)
        )
        if fit.kind in first
        else fit
        for fit in fits
    ]


def disagreement_warnings(fit: KindFit) -> list[str]:
    """What the user is told of sources that disagree."""
    if fit.disagreement <= 1.0:
        return []
    others = " and ".join(name for name in fit.said if name != TRACKS)
    return [
        f"tracks and {others} disagree by more than their noise (calibration, or depth and colour "
        f"that do not belong together?); bounds are {math.sqrt(fit.disagreement):.1f} times as wide"
    ]


def _ratio(
    together: KindFit, alone: KindFit, centroid_world: FloatArray, config: FitConfig
) -> float:
    """Squared difference of two joints over its expectation; one where it may be chance."""
    here, cov_alone = _line(alone, centroid_world)
    _, cov = _line(together, centroid_world)
    k = len(cov)
    variance = np.diag(cov_alone)
    if not (variance > 0).all():  # a far hinge out of the race: what tracks leave so open they
        return 1.0  # do not contradict
    sd = np.sqrt(variance)  # of offsets hundreds of metres, of tilts a thousandth
    try:
        root = np.linalg.cholesky(cov_alone / np.outer(sd, sd) + _ROUNDING * np.eye(k))
    except np.linalg.LinAlgError:  # likewise
        return 1.0
    root = sd[:, None] * root
    off = solve_triangular(root, line_apart(here, together.moving)[:k], lower=True)
    shared = solve_triangular(root, solve_triangular(root, cov, lower=True).T, lower=True)
    left, axes = np.linalg.eigh((shared + shared.T) / 2)  # of the tracks' variances, what is left
    squared = float(((axes.T @ off) ** 2 / np.clip(1 - left, config.least_new, 1.0)).sum())
    return squared / k if squared > stats.chi2.ppf(1 - config.disagreement_chance, k) else 1.0


def _line(fit: KindFit, centroid_world: FloatArray) -> tuple[Joint, FloatArray]:
    """The joint with x pointing from the part to the axis, and the line's covariance in its frame.

    Over the two tilts and, of what turns, the two offsets (metres).
    """
    chart = JointChart.at(fit.moving, centroid_world)
    T_world_joint, _ = chart.frame(np.zeros(chart.size))
    k = len(fit.moving.kind.observable)
    metres = np.array([1.0, 1.0, chart.distance, chart.distance])[:k]
    cov = chart.covariance(fit)[:k, :k] * np.outer(metres, metres)
    return replace(fit.moving, T_world_joint=T_world_joint), cov


def line_apart(here: Joint, there: Joint) -> FloatArray:
    """(4,) from one joint's axis to another's, in the tangent of the first: tilts, then offsets.

    Offsets are those of the lines where they cross the plane z = 0 of the first joint's frame.
    """
    return line_in_joint_frame(here.T_world_joint, there.axis, there.origin)[[0, 1, 3, 4]]
