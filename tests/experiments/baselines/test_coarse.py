import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `baseline`)")

from experiments.baselines.coarse import coarse_alternatives, coarse_estimate  # noqa: E402
from experiments.baselines.config import CoarseConfig  # noqa: E402
from experiments.baselines.kinematics import joint_motion  # noqa: E402
from experiments.trials.openings import make_opening  # noqa: E402
from factors.joint import Joint, JointKind  # noqa: E402

FEW = CoarseConfig(starts=30)


def _pivot_error_m(estimate, opening):
    return np.linalg.norm(np.cross(estimate.pivot - opening.T_world_joint[:3, 3], opening.axis))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_motion_is_that_of_the_factors(kind):
    opening = make_opening(0, kind)
    T, q = opening.T_world_joint, np.array([0.0, 0.4, -1.0, 3.1])
    R_joint, t_joint = Joint(kind, np.eye(4), 0.0).displacement(q)
    R = T[:3, :3] @ R_joint @ T[:3, :3].T
    t = t_joint @ T[:3, :3].T + T[:3, 3] - R @ T[:3, 3]
    double = [torch.tensor(v, dtype=torch.float64) for v in (7 * T[:3, 2], T[:3, 3], q)]
    found = joint_motion(JointKind(kind), *double)
    np.testing.assert_allclose(found[0], R, atol=1e-12)
    np.testing.assert_allclose(found[1], t, atol=1e-12)


def test_a_door_without_noise_is_recovered(angle_deg):
    opening = make_opening(0, "revolute", noise_m=0.0, frames=10)
    found = coarse_estimate(opening.tracks.p_world, 0, FEW)
    assert found.kind == "revolute"
    # The early stop leaves it this far off: 0.25 deg, 2 mm and 4 mrad.
    assert angle_deg(found.axis, opening.axis) < 0.5
    assert _pivot_error_m(found, opening) < 4e-3
    np.testing.assert_allclose(found.states, opening.q, atol=8e-3)


def test_a_drawer_without_noise_is_recovered(angle_deg):
    opening = make_opening(0, "prismatic", noise_m=0.0, frames=10)
    found = coarse_estimate(opening.tracks.p_world, 0, FEW)
    assert found.kind == "prismatic" and found.pivot is None
    assert angle_deg(found.axis, opening.axis) < 0.05
    np.testing.assert_allclose(found.states, opening.q, atol=1e-4)


def test_the_lower_loss_decides_the_kind_and_the_same_seed_gives_the_same_joint():
    opening = make_opening(1, "revolute", travel=0.3, frames=10)
    first, again = (coarse_estimate(opening.tracks.p_world, 7, FEW) for _ in range(2))
    assert first.kind == min(first.losses, key=first.losses.get)
    assert first.losses == again.losses
    np.testing.assert_array_equal(first.axis, again.axis)


def test_lost_observations_do_not_count(angle_deg):
    """Any finite stand-in for them (the origin, say) would throw the joint far off."""
    opening = make_opening(2, "revolute", noise_m=0.0, frames=10)
    p = opening.tracks.p_world + 1.0
    lost = np.random.default_rng(0).random(p.shape[:2]) < 0.3
    lost[4] = True  # a whole frame
    p[lost] = np.nan
    found = coarse_alternatives(p, 0, FEW)["revolute"]
    assert angle_deg(found.axis, opening.axis) < 1.5
    known = np.arange(10) != 4
    np.testing.assert_allclose(found.states[known], opening.q[known], atol=0.02)
    assert np.isnan(found.states[4])


def test_the_joint_is_that_of_the_start_with_the_loss_reported():
    p = make_opening(0, "revolute", travel=0.26).tracks.p_world
    alone, found = (coarse_alternatives(p, 0, CoarseConfig(starts=n))["revolute"] for n in (1, 10))
    assert found.losses["revolute"] < alone.losses["revolute"]  # a random start won
    joint = [torch.tensor(v) for v in (found.axis, found.pivot, found.states[1:])]
    R, t = (v.numpy() for v in joint_motion(JointKind.REVOLUTE, *joint))
    moved = np.einsum("tij,nj->tni", R, p[0]) + t[:, None]
    loss = np.linalg.norm(moved - p[1:], axis=-1).mean()
    assert found.losses["revolute"] == pytest.approx(loss, abs=1e-6)


@pytest.mark.parametrize("squared", [False, True])
def test_the_loss_is_the_mean_distance_or_its_square(squared):
    """Two points of which one is 3 mm across the motion off in frame 1, the other not."""
    p = np.zeros((2, 2, 3))
    p[:, 1, 2] = 1.0
    p[1, :, 0] = 0.1
    p[1, 0, 1] = 0.003
    config = CoarseConfig(starts=1, squared=squared)
    found = coarse_alternatives(p, 0, config)["prismatic"]
    # The best translation lies anywhere between the points (mean distance) or midway (squared).
    expected = 0.0015**2 if squared else 0.0015
    assert found.losses["prismatic"] == pytest.approx(expected, rel=0.02)


def test_too_little_data_are_refused():
    with pytest.raises(ValueError, match="two frames at least"):
        coarse_estimate(np.zeros((1, 5, 3)), 0, FEW)
    unseen = np.zeros((3, 5, 3))
    unseen[0] = np.nan
    with pytest.raises(ValueError, match="no point of the first frame"):
        coarse_estimate(unseen, 0, FEW)
