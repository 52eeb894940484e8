from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `baseline`)")

from experiments.baselines.clouds import part_cloud  # noqa: E402
from experiments.baselines.config import FineConfig, RegistrationConfig  # noqa: E402
from experiments.baselines.estimate import joint_estimate  # noqa: E402
from experiments.baselines.fine import fine_estimate  # noqa: E402
from experiments.baselines.relocalize import relocalize  # noqa: E402

STATES = {"revolute": np.deg2rad([0, 8, 15.0]), "prismatic": np.array([0, 0.08, 0.15])}
KINDS = ("revolute", "prismatic")


def _joint(kind, axis, pivot, states):
    return joint_estimate(kind, axis, pivot, states, np.zeros(3), {}, {})


@pytest.fixture
def perturbed(true_axis, true_pivot):
    """A joint 3 degrees, 2 cm and a tenth of its states off."""
    tilt = {
        "revolute": [0.0, np.tan(np.deg2rad(3)), 0.0],
        "prismatic": [np.tan(np.deg2rad(3)), 0, 0],
    }
    return {
        kind: _joint(
            kind, true_axis[kind] + tilt[kind], true_pivot + np.array([0.02, 0, 0]), 1.1 * states
        )
        for kind, states in STATES.items()
    }


@pytest.mark.parametrize("kind", KINDS)
def test_the_fine_stage_improves_a_perturbed_start(
    kind, perturbed, seen_part, true_axis, true_pivot, angle_deg
):
    clouds = [part_cloud(seen_part(kind, q, i)) for i, q in enumerate(STATES[kind])]
    start = perturbed[kind]
    found = fine_estimate(start, clouds, start.states, 0)
    assert found.kind == kind
    assert angle_deg(found.axis, true_axis[kind]) < 0.6 * angle_deg(start.axis, true_axis[kind])
    error, before = (np.abs(j.states - STATES[kind]).max() for j in (found, start))
    assert error < 0.5 * before
    if kind == "revolute":
        assert np.linalg.norm(np.cross(found.pivot - true_pivot, true_axis[kind])) < 0.005


def test_clouds_too_far_apart_leave_the_coarse_joint(perturbed, seen_part):
    start = perturbed["prismatic"]
    clouds = [part_cloud(seen_part("prismatic", q, 0)) for q in (0.0, 2.0)]
    found = fine_estimate(start, clouds, np.array([0.0, 0.1]), 0)
    assert found.losses["fine"] == float("inf")
    np.testing.assert_allclose(found.axis, start.axis, atol=1e-6)


def test_point_to_point_is_another_loss(perturbed, seen_part):
    start = perturbed["prismatic"]
    clouds = [part_cloud(seen_part("prismatic", q, i)) for i, q in enumerate(STATES["prismatic"])]
    short = replace(FineConfig().descent, max_iterations=1)
    losses = [
        fine_estimate(
            start,
            clouds,
            start.states,
            0,
            FineConfig(registration=RegistrationConfig(point_to_plane=plane), descent=short),
        ).losses["fine"]
        for plane in (True, False)
    ]
    assert losses[1] > 1.5 * losses[0]  # distances along the surface count too


@pytest.mark.parametrize(("kind", "state"), [("revolute", np.deg2rad(33.0)), ("prismatic", 0.27)])
def test_relocalization_finds_a_state_between_its_candidates(
    kind, state, seen_part, true_axis, true_pivot
):
    joint = _joint(kind, true_axis[kind], true_pivot, STATES[kind])
    clouds = [part_cloud(seen_part(kind, q, i)) for i, q in enumerate(STATES[kind])]
    current = part_cloud(seen_part(kind, state, 9))
    found = relocalize(joint, clouds, STATES[kind], current, 0)
    assert abs(found.candidate - state) > 0.01  # so that refinement has something to do
    assert abs(found.state - state) < 5e-3
    assert relocalize(joint, clouds, STATES[kind], current, 0).state == found.state


def test_numbers_of_clouds_and_states_must_agree(perturbed, seen_part):
    cloud = part_cloud(seen_part("prismatic", 0.0, 0))
    with pytest.raises(ValueError, match="one state each"):
        fine_estimate(perturbed["prismatic"], [cloud], np.zeros(1), 0)
    with pytest.raises(ValueError, match="one state each"):
        relocalize(perturbed["prismatic"], [cloud], np.zeros(2), cloud, 0)
