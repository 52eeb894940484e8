"""Which views of a surface belong together: patches that both see tie them, and tracks do."""

import numpy as np
from numpy.testing import assert_array_equal

from akm_fg.estimation.given.surface_registration import tied_views

NONE = np.zeros(5, dtype=bool)


def _seen(*ranges: tuple[int, int]) -> np.ndarray:
    seen = np.zeros((len(ranges), 300), dtype=bool)
    for row, (a, b) in zip(seen, ranges, strict=True):
        row[a:b] = True
    return seen


def test_views_with_patches_in_common_are_tied_also_through_others():
    seen = _seen((0, 100), (80, 180), (160, 260), (80, 150), (100, 200))
    assert tied_views(seen, NONE).all()


def test_views_of_another_surface_are_not_however_many_they_are():
    seen = _seen((0, 100), (0, 100), (100, 300), (100, 300), (100, 300))
    assert_array_equal(tied_views(seen, NONE), [True, True, False, False, False])


def test_a_few_patches_in_common_are_chance():
    seen = _seen((0, 100), (0, 100), (91, 291), (95, 295), (0, 100))
    assert_array_equal(tied_views(seen, NONE), [True, True, False, False, True])


def test_tracks_tie_views_that_share_no_patch():
    seen = _seen((0, 100), (100, 200), (200, 300), (0, 100), (0, 100))
    tracked = np.array([True, True, False, False, False])
    assert_array_equal(tied_views(seen, tracked), [True, True, False, True, True])
