from __future__ import annotations

import numpy as np
import pytest

from sim.camera.temporal_filter import TemporalFilter, TemporalFilterConfig

FB = 40.0


def run(disparities: list[float], config: TemporalFilterConfig | None = None) -> list[float]:
    """Disparities of one pixel after the filter; NaN is a hole."""
    temporal = TemporalFilter(config or TemporalFilterConfig(), FB)
    frames = [np.array([[FB / d]]) for d in disparities]
    return [float(FB / temporal.filtered(frame)[0, 0]) for frame in frames]


def test_a_small_step_is_followed_by_two_fifths_a_frame():
    np.testing.assert_allclose(run([40.0, 40.5, 40.5]), [40.0, 40.2, 40.32], rtol=1e-6)


def test_a_large_step_starts_anew():
    np.testing.assert_allclose(run([40.0, 41.0, 41.5]), [40.0, 41.0, 41.2], rtol=1e-6)


def test_a_hole_keeps_its_value_after_two_of_four_frames_and_else_stays_a_hole():
    hole = np.nan
    np.testing.assert_allclose(run([40.0, hole]), [40.0, hole])
    np.testing.assert_allclose(run([40.0, 40.0, hole]), [40.0, 40.0, 40.0], rtol=1e-6)
    long = run([40.0, 40.0, hole, hole, hole, hole, 40.0])
    np.testing.assert_allclose(long, [40.0, 40.0, 40.0, 40.0, 40.0, hole, 40.0], rtol=1e-6)


def test_frames_of_another_size_are_refused():
    temporal = TemporalFilter(TemporalFilterConfig(), FB)
    temporal.filtered(np.ones((2, 3)))
    with pytest.raises(ValueError, match="after frames"):
        temporal.filtered(np.ones((3, 2)))
