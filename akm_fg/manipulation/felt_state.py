"""What a hand's own place says of a part's state, and how well a state must be known for a hand.

A hand that has closed on something where the handle should be, holds the handle: of its way off the
grasp that was meant, what lies along the part's way is a change of the state. How deep the handle
is between the fingers nobody knows better than to what a hand feels for.
"""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.manipulation.config import HoldConfig
from akm_fg.model.records import ModelPart
from akm_fg.planning.move_length import LEVEL

# By which the joint's own covariance, on top, may widen what was felt as far as it can be.
SLACK = 0.1


def felt_state(
    part: ModelPart,
    q: float,
    T_world_grasp: gtsam.Pose3,
    T_world_hand: gtsam.Pose3,
    config: HoldConfig,
) -> tuple[float, float]:
    """State and standard deviation, m or rad, by a hand that has just closed.

    Args:
        part: of the model.
        q: state for which the grasp was meant.
        T_world_grasp: that grasp.
        T_world_hand: where the hand closed.
        config: how far a hand feels.
    """
    way = part.joint.joint.velocity(T_world_grasp.translation())
    lever = max(float(np.linalg.norm(way)), 1e-6)
    off = T_world_hand.translation() - T_world_grasp.translation()
    return q + float(way @ off) / lever**2, config.most_feel_m / LEVEL / lever


def can_be_felt_for(part: ModelPart, q: float, sd: float, config: HoldConfig) -> bool:
    """Whether a state is known as well as a hand can feel for the handle there."""
    held = [contact.T_part_grasp.translation() for contact in part.contacts]
    p_part = held[0] if held else part.surface.p_world.mean(axis=0)
    p_world = part.T_world_part(q).transformFrom(p_part)
    lever = float(np.linalg.norm(part.joint.joint.velocity(p_world)))
    return LEVEL * sd * lever <= (1.0 + SLACK) * config.most_feel_m
