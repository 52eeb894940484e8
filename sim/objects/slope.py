"""What a part needs to stay where it is left, on an object that does not stand level.

Furniture that stands askew has parts that would run off by themselves; whoever sets it up shims the
feet or chooses slides and hinges that hold. The published placement rolls objects by up to 0.05 rad
(`sim.objects.published_place`) and knows nothing of that: a sliding door of 18 kg would be half a
metre open before the robot has looked.
"""

from __future__ import annotations

import numpy as np

from akm_fg.records import FloatArray

HOLDS = 1.2  # friction over the slope's load: it holds, and a fifth more than that


def slope_load(
    weight_n: float, axis_object: FloatArray, axis_world: FloatArray, lever_m: float | None
) -> float:
    """The most that gravity adds along a joint because its object does not stand level.

    Along a rail, gravity's component is the weight times the axis' slope. About a hinge it is, at
    the worst state, the weight times the lever times the sine of the angle between axis and up.

    Args:
        weight_n: of the part.
        axis_object: (3,) unit, in the object's frame, whose z is up where it stands level.
        axis_world: (3,) the same axis as it stands, z up.
        lever_m: distance of the part's centre of mass from the hinge; None of what slides.

    Returns:
        N of what slides, N m of what turns; 0 where standing askew makes it lighter.
    """

    def share(axis: FloatArray) -> float:
        rise = min(abs(float(axis[2])), 1.0)
        return rise if lever_m is None else float(np.sqrt(1.0 - rise**2))

    more = share(axis_world) - share(axis_object)
    return max(more, 0.0) * weight_n * (1.0 if lever_m is None else lever_m)
