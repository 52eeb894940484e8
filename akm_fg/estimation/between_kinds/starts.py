"""Where the graph of each kind starts, and which kinds are still in the race."""

from __future__ import annotations

import math
from dataclasses import dataclass

from akm_fg.estimation.given.motion_fit import (
    MotionFit,
    bent_drawer,
    evaluate,
    fit_to_motions,
    refined,
)
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.geometry.joint_guess import JointGuess
from factors.joint import Joint, JointKind
from factors.motion_information import MotionInformation


@dataclass(frozen=True, slots=True)
class Start:
    """One kind's start."""

    guess: JointGuess
    nats_behind: float  # log likelihood behind the best kind's, with each kind's own noise level
    worth_it: bool = True  # False for a screw that explains no more than the hinge it contains


def starts_of_part(problem: FitProblem, motions: MotionInformation) -> list[Start]:
    """One start a moving kind, already fitted to the part's free motions."""
    drawer = min(
        (_fit(guess, problem, motions) for guess in _of(JointKind.PRISMATIC, problem)),
        key=lambda fit: fit.twice_cost,
    )
    hinge = _hinge(drawer, problem, motions)
    at_hinge = Joint(JointKind.HELICAL, hinge.guess.joint.T_world_joint, 0.0)
    screw = _fit(JointGuess(at_hinge, hinge.guess.q), problem, motions)
    fits = [drawer, hinge, screw]
    n = sum(source.readings for source in problem.sources)
    least = min(fit.twice_cost for fit in fits)
    behind = [0.5 * n * math.log1p(max(fit.twice_cost - least, 0.0) / n) for fit in fits]
    gain = (hinge.twice_cost - screw.twice_cost) / 2
    worth = [True, True, gain > problem.config.screw_gain]
    return [Start(f.guess, b, w) for f, b, w in zip(fits, behind, worth, strict=True)]


def _hinge(drawer: MotionFit, problem: FitProblem, motions: MotionInformation) -> MotionFit:
    prior, centroid = problem.config.prior, problem.centroid_world
    bent = evaluate(bent_drawer(drawer, motions, centroid), motions, centroid, prior)
    screws = [
        evaluate(guess, motions, centroid, prior) for guess in _of(JointKind.REVOLUTE, problem)
    ]
    nearest = min(screws, key=lambda fit: fit.twice_cost, default=bent)
    # The bent drawer converges from nearly everywhere short of large turns.
    start = nearest if nearest.twice_cost < problem.config.much_nearer * bent.twice_cost else bent
    return refined(start, motions, centroid, prior)


def _of(kind: JointKind, problem: FitProblem) -> list[JointGuess]:
    return [guess for guess in problem.guesses if guess.kind is kind]


def _fit(guess: JointGuess, problem: FitProblem, motions: MotionInformation) -> MotionFit:
    return fit_to_motions(guess, motions, problem.centroid_world, problem.config.prior)
