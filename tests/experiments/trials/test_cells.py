import numpy as np
import pytest

from experiments.trials.cells import Cell, cell_named, grid_cells, table_cells


def test_a_cell_is_found_again_by_its_name():
    for cell in grid_cells():
        assert cell_named(cell.name) == cell


def test_the_grid_has_every_combination_once_and_the_twelve_first():
    grid = grid_cells()
    assert len(grid) == len(set(grid)) == 3 * 3 * 3 * 6
    assert grid[:12] == table_cells()
    assert {cell.condition for cell in table_cells()} == {"clean", "drifting"}


def test_openings_are_what_the_cell_says_and_the_same_every_time():
    cell = Cell("door", 15.0, noise_mm=10.0, points=10, frames=5, condition="drifting")
    opening, again = cell.opening(3), cell.opening(3)
    assert opening.tracks.p_world.shape == (5, 10, 3)
    assert opening.wild.sum() == 2
    assert opening.kind == "revolute" and opening.q.max() <= np.deg2rad(15)
    np.testing.assert_allclose(opening.tracks.cov_world[0, 0], 1e-4 * np.eye(3))
    np.testing.assert_array_equal(opening.tracks.p_world, again.tracks.p_world)


def test_cells_share_no_random_numbers():
    a, b = (Cell("drawer", travel).opening(0) for travel in (5.0, 15.0))
    assert np.abs(a.rest_world - b.rest_world).max() > 0.01


@pytest.mark.parametrize(
    "name", ["door 15 deg", "window 15 deg, 3 mm, 40 points, 20 frames, clean"]
)
def test_other_names_are_refused(name):
    with pytest.raises(ValueError, match="names no cell"):
        cell_named(name)


def test_other_parts_and_conditions_are_refused():
    with pytest.raises(ValueError, match="door or drawer"):
        Cell("door", 15.0, condition="foggy")
