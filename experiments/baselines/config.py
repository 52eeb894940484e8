"""Settings of the paper's method.

Defaults are those its authors run; where the paper says something else, a flag chooses. Numbers
that the paper does not give are their published settings.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class DescentConfig:
    """Adam with a step that is halved on a plateau, and an early stop."""

    step: float  # metres, radians, or units of the axis vector
    max_iterations: int = 300
    plateau_factor: float = 0.5  # of the step, after a plateau
    plateau_patience: int = 3  # iterations without improvement before the step shrinks
    stop_patience: int = 10  # iterations without improvement before it ends


@dataclass(frozen=True, slots=True)
class CoarseConfig:
    """Joint from sparse tracks (Eq. 5)."""

    starts: int = 1000  # parallel starts of the hinge, the heuristic one included; lighter: 100
    pivot_range_m: float = 0.5  # starts: uniform, each coordinate, about the heuristic pivot
    axis_range_deg: float = 60.0  # starts: the axis turned by a uniform angle about any direction
    squared: bool = False  # mean squared distance (the paper) or mean distance (its authors)
    descent: DescentConfig = field(default_factory=lambda: DescentConfig(step=1e-2))


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """How two clouds are compared (the inner sum of Eq. 6)."""

    point_to_plane: bool = True  # False: point-to-point, as in the paper
    sample: int = 1000  # random points of each cloud, drawn anew in every iteration
    match_range_m: float = 0.1  # farther nearest neighbours are no match
    min_matches: int = 100  # a pair with fewer adds nothing to the loss


@dataclass(frozen=True, slots=True)
class FineConfig:
    """Joint from dense clouds of a few keyframes (Eq. 6)."""

    keyframes: int = 5  # farthest apart in state, the first included
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    descent: DescentConfig = field(
        default_factory=lambda: DescentConfig(step=1e-3, plateau_patience=5, stop_patience=20)
    )


@dataclass(frozen=True, slots=True)
class RelocalizationConfig:
    """State of one frame from its cloud (Eq. 7, Algorithm 3)."""

    candidates: int = 15  # evenly over the range, both ends included
    range_m: float = 0.5
    range_deg: float = 90.0
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    descent: DescentConfig = field(
        default_factory=lambda: DescentConfig(step=3e-3, plateau_patience=5, stop_patience=20)
    )
