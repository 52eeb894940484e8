"""How the fine stage's keyframes come back to the recording; both run in test_surface_gain."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("torch")

from experiments.baselines.estimate import joint_estimate
from experiments.trials.paper_on_recordings import refined

COARSE = joint_estimate(
    "prismatic", np.array([0, 0, 1.0]), np.zeros(3), np.arange(6) / 10, np.zeros(3), {}, {}
)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_states_of_keyframes_count_from_the_recordings_first_frame(sign):
    """Clouds of frames 1, 3, 5 only: the first cloud is at the coarse state 0.1, not at zero."""

    def fine(coarse, clouds, states, seed):
        assert list(clouds) == ["one", "three", "five"]
        assert_allclose(states, [0.1, 0.3, 0.5])
        return joint_estimate(
            "prismatic",
            np.array([0, 0.02, sign]),
            np.zeros(3),
            np.array([0, 0.21, 0.41]),
            np.zeros(3),
            {"fine": 0.0},
            {"fine": 1.0},
        )

    clouds = {5: "five", 1: "one", 3: "three"}
    found = refined(COARSE, clouds, seed=0, refine=fine)
    assert_allclose(found.states[1::2], sign * 0.1 + np.array([0, 0.21, 0.41]))
    assert found.states[0] == 0 and np.isnan(found.states[[2, 4]]).all()
