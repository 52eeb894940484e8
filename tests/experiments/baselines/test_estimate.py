import subprocess
import sys

import numpy as np
import pytest

from experiments.baselines.estimate import joint_estimate

CENTROID = np.array([0.2, 0.0, 0.5])


def _estimate(**changes):
    given = {
        "kind": "revolute",
        "axis": np.array([0.0, 0.0, -2.0]),
        "point_on_axis": np.array([0.0, 0.0, 9.0]),
        "states": np.array([0.1, -0.1, np.nan, -0.3]),
        "part_centroid": CENTROID,
        "losses": {},
        "time_s": {},
    }
    return joint_estimate(**(given | changes))


def test_the_axis_points_so_that_the_states_grow_from_zero():
    found = _estimate()
    np.testing.assert_allclose(found.axis, [0, 0, 1])
    np.testing.assert_allclose(found.states, [0, 0.2, np.nan, 0.4])


def test_the_pivot_is_the_point_of_the_axis_nearest_to_the_part():
    np.testing.assert_allclose(_estimate().pivot, [0, 0, 0.5])
    assert _estimate(kind="prismatic").pivot is None


def test_an_axis_without_direction_or_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="no direction"):
        _estimate(axis=np.zeros(3))
    with pytest.raises(ValueError, match="helical"):
        _estimate(kind="helical")


def test_records_starts_clouds_and_peers_do_not_load_torch():
    modules = ["estimate", "config", "starts", "clouds"]
    imports = [f"experiments.baselines.{name}" for name in modules] + ["experiments.peers.ripl"]
    code = f"import sys, {', '.join(imports)}; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
