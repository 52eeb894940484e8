"""Mass, friction, catches and closers of furniture: what a pull at the handle has to overcome.

Together they ask for less than 25 N at the handle, which a child can pull.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim.objects.mechanisms import Catch, Closer
from sim.objects.part_spec import Hinge

CATCH_SHARE = 0.4  # of the objects, held closed by a magnet or a ball
CLOSER_SHARE = 0.2  # of the drawers, sliding doors and standing doors, pulled shut by a spring


@dataclass(frozen=True, slots=True)
class PartPhysics:
    """Of the moving part and its joint."""

    mass_kg: float
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    handle_mu: float  # sliding friction of the handle against rubber with mu 1


@dataclass(frozen=True, slots=True)
class FreeFront:
    """One that is free besides the first: its joint and what a pull has to overcome."""

    front: int  # place among the fronts of its face
    kind: Literal["prismatic", "revolute"]
    hinge: Hinge | None
    mass_kg: float
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float  # sliding friction of the handle against rubber with mu 1
    catch: Catch | None
    closer: Closer | None

    @property
    def balanced(self) -> bool:
        """Hinges that lie are."""
        return self.hinge in ("top", "bottom")


def sample_physics(area_m2: float, slides: bool, rng: np.random.Generator) -> PartPhysics:
    """Draws the part's physics from the area of its front.

    Masses are those of board of 12 to 18 kg/m^2 and what hangs on it; slides rub with 2 to 8 N,
    hinges with 0.2 to 1 N m, damped ones with up to 20 N s/m and 2 N m s/rad.
    """
    mass_kg = (2.0 if slides else 0.5) + area_m2 * rng.uniform(12.0, 18.0)
    damping = rng.uniform(3.0, 20.0) if slides else rng.uniform(0.3, 2.0)
    friction = rng.uniform(2.0, 8.0) if slides else rng.uniform(0.2, 1.0)
    return PartPhysics(mass_kg, float(damping), float(friction), float(rng.uniform(0.7, 1.0)))


def sample_catch(key: tuple[int, ...], lever_m: float | None) -> Catch | None:
    """A magnet or ball at the free edge for a share of the objects: 3 to 8 N over 5 to 12 mm.

    Args:
        key: of the object.
        lever_m: from the hinge to the free edge; None where the part slides.
    """
    rng = np.random.default_rng([*key, 41])
    if rng.random() >= CATCH_SHARE:
        return None
    force_n, peak_m, travel_m = rng.uniform(3.0, 8.0), rng.uniform(3e-4, 2e-3), rng.uniform(5, 12)
    lever = 1.0 if lever_m is None else lever_m
    return Catch(float(force_n * lever), float(peak_m / lever), float(1e-3 * travel_m / lever))


def sample_closer(key: tuple[int, ...], lever_m: float | None, lying: bool) -> Closer | None:
    """Self-closing slides, which pull over the last centimetres, and sprung hinges.

    A hinge that lies has springs to balance its door instead.

    Args:
        key: of the object.
        lever_m: from the hinge to the free edge; None where the part slides.
        lying: whether the hinge lies.
    """
    rng = np.random.default_rng([*key, 42])
    if lying or rng.random() >= CLOSER_SHARE:
        return None
    if lever_m is None:
        return Closer(float(rng.uniform(1.5, 4.0)), 0.0, float(rng.uniform(0.03, 0.08)))
    return Closer(float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.05, 0.3)), np.inf)
