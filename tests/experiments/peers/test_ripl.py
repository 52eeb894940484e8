import sys

import gtsam
import numpy as np
import pytest

from akm_fg.errors import MissingDependency
from experiments.peers.ripl import (
    PYTHON,
    PartMotion,
    RiplConfig,
    estimate_of_twist,
    estimate_openings,
    farthest_twist,
    part_motion,
)
from experiments.trials.openings import make_opening

# Answers like the peer: the twist to the frame that moved farthest, and for the second opening
# that it failed.
ECHO = """
import sys
import numpy as np
data = np.load(sys.argv[2])
assert int(data["count"]) == 2
theta = np.linspace(0, 1, len(data["T_world_part_0"]))
np.savez(sys.argv[3], twist_0=data["prior_0"], theta_0=theta, seconds_0=0.5, error_1="singular")
"""


def _angle_deg(a, b):
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _pivot_error_m(estimate, opening):
    return np.linalg.norm(np.cross(estimate.pivot - opening.T_world_joint[:3, 3], opening.axis))


def _interpreter(folder, code):
    """A stand-in for the peer's python that runs this code with the runner's arguments."""
    (folder / "code.py").write_text(code)
    script = folder / "python"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{folder / "code.py"}" "$@"\n')
    script.chmod(0o755)
    return RiplConfig(python=script)


def test_without_its_environment_the_error_says_how_to_make_it(tmp_path):
    config = RiplConfig(python=tmp_path / "absent")
    with pytest.raises(MissingDependency, match="make peer"):
        estimate_openings([make_opening(0).tracks], 0, config)


def test_the_poses_are_those_of_the_part_in_its_first_frame():
    opening = make_opening(0, "revolute", noise_m=0.0)
    motion = part_motion(opening.tracks, np.random.default_rng(0))
    p = opening.tracks.p_world
    local = p[0] - p[0].mean(axis=0)
    for T_world_part, observed in zip(motion.T_world_part, p, strict=True):
        np.testing.assert_allclose(local @ T_world_part[:3, :3].T + T_world_part[:3, 3], observed)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_true_twist_gives_the_true_joint(kind):
    opening = make_opening(1, kind, noise_m=0.0, steady=True)
    motion = part_motion(opening.tracks, np.random.default_rng(0))
    twist = farthest_twist(motion.T_world_part)
    theta = opening.q / opening.q[-1]
    found = estimate_of_twist(-twist, 3.0 - theta, motion, 0.1, RiplConfig())
    assert found.kind == kind
    assert _angle_deg(found.axis, opening.axis) < 1e-5
    np.testing.assert_allclose(found.states, opening.q, atol=1e-9)
    if kind == "revolute":
        assert _pivot_error_m(found, opening) < 1e-9


def test_frames_without_a_pose_have_no_state():
    T_world_part = np.array([gtsam.Pose3.Expmap([0, 0, q, 0, 0.1 * q, 0]).matrix() for q in (0, 1)])
    motion = PartMotion(T_world_part, np.array([0, 2]), 3)
    found = estimate_of_twist(
        np.array([0, 0, 1.0, 0, 0.1, 0]), np.array([0, 1.0]), motion, 0.1, RiplConfig()
    )
    np.testing.assert_allclose(found.states, [0, np.nan, 1])


def test_inputs_and_results_travel_through_files_and_a_failure_is_none(tmp_path):
    openings = [make_opening(seed, "revolute", steady=True) for seed in range(2)]
    tracks = [opening.tracks for opening in openings]
    found, failed = estimate_openings(tracks, 0, _interpreter(tmp_path, ECHO))
    assert failed is None
    assert found.kind == "revolute" and found.time_s == {"total": 0.5}
    assert _angle_deg(found.axis, openings[0].axis) < 5


def test_a_peer_that_dies_is_reported_with_what_it_said(tmp_path):
    config = _interpreter(tmp_path, "raise SystemExit('no such thing')")
    with pytest.raises(RuntimeError, match="no such thing"):
        estimate_openings([make_opening(0).tracks], 0, config)


@pytest.mark.slow
@pytest.mark.skipif(not PYTHON.exists(), reason="the peer is not installed (`make peer`)")
def test_the_peer_opens_doors_and_drawers():
    """Twenty openings each, 40 points, 20 frames, 3 mm; medians, limits twice what was measured."""
    doors = [make_opening(seed, "revolute", travel=np.deg2rad(15)) for seed in range(20)]
    drawers = [make_opening(seed, "prismatic", travel=0.15) for seed in range(20)]
    found = estimate_openings([opening.tracks for opening in doors + drawers], 0)
    pairs = list(zip(found, doors + drawers, strict=True))
    assert all(f is not None and f.kind == o.kind for f, o in pairs)
    errors = [_angle_deg(f.axis, o.axis) for f, o in pairs]
    assert np.median(errors[:20]) < 3.5 and np.median(errors[20:]) < 0.9
    assert np.median([_pivot_error_m(f, o) for f, o in pairs[:20]]) < 0.013
