from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from akm_fg.manipulation.config import HoldConfig
from akm_fg.manipulation.felt_state import can_be_felt_for, felt_state
from factors.joint import Joint, JointKind

CONFIG = HoldConfig()
GRASP = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.1, 0.4]))


def part(kind: JointKind) -> SimpleNamespace:
    joint = Joint(kind, np.eye(4), 0.0)
    contacts = (SimpleNamespace(T_part_grasp=GRASP),)
    return SimpleNamespace(
        joint=SimpleNamespace(joint=joint),
        contacts=contacts,
        T_world_part=lambda q: gtsam.Pose3(),
    )


@pytest.mark.parametrize("kind", [JointKind.REVOLUTE, JointKind.PRISMATIC])
def test_what_a_hand_has_felt_is_known_to_the_hand_with_the_joints_own_share_on_top(kind):
    some = part(kind)
    q, sd = felt_state(some, 0.2, GRASP, GRASP, CONFIG)
    assert q == pytest.approx(0.2)
    assert can_be_felt_for(some, q, float(np.hypot(sd, 0.3 * sd)), CONFIG)
    assert not can_be_felt_for(some, q, 1.2 * sd, CONFIG)


def test_a_hand_that_closed_farther_on_tells_a_state_farther_on():
    some = part(JointKind.PRISMATIC)  # along z
    hand = gtsam.Pose3(GRASP.rotation(), GRASP.translation() + np.array([0.01, 0.0, 0.02]))
    assert felt_state(some, 0.2, GRASP, hand, CONFIG)[0] == pytest.approx(0.22)
