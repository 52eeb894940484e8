"""Would the kind be the same if positions were biased with the view, as orientations are?

The pose of a fiducial tag is read off its corners: to first order, errors of its position and of
its orientation are two linear maps of the same errors of the corners. Whatever share of these
changes slowly with the view, and whatever is noise, position and orientation err slowly in the same
proportion to their noise. For orientations that proportion is known (`orientation_bias_share`), so
it is for positions. In step with the way a bias of some noises looks like a bend of the path, and
hundreds of frames that follow it would be hundreds of pieces of evidence for a hinge.

The graph knows positions by independent noise and a share of the travel. Here the kinds' residuals
are judged again, with slow errors in them (`slow_errors`), all else as it was.
"""

from __future__ import annotations

from dataclasses import replace

from akm_fg.estimation.between_kinds.evidence import kind_probabilities
from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds
from akm_fg.estimation.given.problem import NOMINAL_POSITION_M, FitProblem
from akm_fg.estimation.sources.orientations import OrientationSource
from akm_fg.estimation.sources.slow_errors import SlowErrors, at_one_level
from akm_fg.estimation.sources.tracks import TRACKS

_LEAST_M = 1e-5  # of independent noise: printed positions are rounded


def biased_probability(fitted: FittedKinds) -> dict[str, float] | None:
    """Probability of each moving kind if positions are biased, given that the part moves.

    None where no orientations are known. (Rest is left out: what is smooth is no bias for that.)
    """
    problem = fitted.problem
    turned = next((s for s in problem.sources if isinstance(s, OrientationSource)), None)
    if turned is None:
        return None
    fits = [fit for fit in fitted.fits if fit.joint is not None]
    residuals = [fit.tracks.residual_joint[:, 0] for fit in fits]
    log_likelihoods, _ = at_one_level(_of_positions(problem, turned), residuals)
    judged = [
        replace(
            fit,
            said={
                **fit.said,
                TRACKS: replace(
                    fit.tracks, log_likelihood=0.0, log_latents=0.0, log_correlated=told
                ),
            },
        )
        for fit, told in zip(fits, log_likelihoods, strict=True)
    ]
    return kind_probabilities(judged, problem.config.prior)


def _of_positions(problem: FitProblem, turned: OrientationSource) -> SlowErrors:
    sigma_m = max(problem.local_scale * NOMINAL_POSITION_M, _LEAST_M)
    return replace(
        turned.errors,
        sigma=sigma_m,
        sigma_slow=problem.config.orientation_bias_share * sigma_m,
    )
