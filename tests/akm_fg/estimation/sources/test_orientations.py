"""What orientations say, and what a few that are wrong may not change of it."""

import gtsam
import numpy as np

from akm_fg.estimation.between_kinds.all_kinds import fit_in_steps
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.path_problem import problem_of_poses
from akm_fg.estimation.sources.orientations import ORIENTATIONS
from akm_fg.records import PoseTrack
from akm_fg.steps import to_end


def _door(seed: int, wrong_rad: float, frames: int = 60, noise_rad: float = 0.01) -> PoseTrack:
    """Half a metre from the hinge; orientations err alike over some frames, every tenth is wrong.

    The noise is of first order, each frame 0.8 of the last: nine frames tell as much as one.
    """
    rng = np.random.default_rng(seed)
    q = np.linspace(0.0, 1.0, frames)
    p = 0.5 * np.column_stack([np.cos(q), np.sin(q), np.zeros(frames)])
    noise, white = np.zeros((frames, 3)), rng.normal(size=(frames, 3))
    for t in range(1, frames):
        noise[t] = 0.8 * noise[t - 1] + 0.6 * white[t]
    noise *= noise_rad
    noise[5::10] += wrong_rad * rng.choice([-1.0, 1.0], size=(len(noise[5::10]), 3))
    R = [gtsam.Rot3.Rz(a).retract(e).matrix() for a, e in zip(q, noise, strict=True)]
    return PoseTrack(p + 0.001 * rng.normal(size=p.shape), np.array(R))


def _variance_ratio(poses: PoseTrack) -> float:
    fitted = to_end(fit_in_steps(problem_of_poses("door", poses, FitConfig()), 0.0))
    (hinge,) = (fit for fit in fitted.fits if fit.kind == "revolute")
    return hinge.said[ORIENTATIONS].variance_fixed


def test_wrong_orientations_do_not_hide_that_the_others_err_together():
    """They are rejected: else they would make the noise look white (0.8 of what is claimed)."""
    for seed in range(3):
        clean, wrong = (_variance_ratio(_door(seed, off)) for off in (0.0, 0.08))
        assert clean > 2.5
        assert wrong > 1.1
