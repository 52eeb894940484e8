"""Rows of pose logs that jump away and come back."""

import gtsam
import numpy as np
import pytest

from akm_fg.estimation.fit import fit_poses
from akm_fg.estimation.given.jumps import jumping_rows
from akm_fg.records import PoseTrack


def _log(rows=80, noise_m=0.001, noise_rad=0.005, seed=0, steps=None):
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 0.4, rows) if steps is None else steps
    p = np.column_stack([s, np.zeros_like(s), np.ones_like(s)])
    p = p + noise_m * rng.normal(size=p.shape)
    R = [gtsam.Rot3.Expmap(noise_rad * rng.normal(size=3)).matrix() for _ in s]
    return PoseTrack(p, np.array(R))


@pytest.mark.parametrize("rows", [[20], [20, 21, 22], [5, 40, 41, 70]])
def test_rows_that_jump_by_ten_centimetres_are_found_and_no_others(rows):
    poses = _log()
    poses.p_world[rows] += [0.0, 0.1, 0.0]
    assert np.flatnonzero(jumping_rows(poses)).tolist() == rows


def test_a_flipped_orientation_is_a_jump():
    poses = _log()
    poses.R_world_part[33] = poses.R_world_part[33] @ gtsam.Rot3.Rx(np.pi).matrix()
    assert np.flatnonzero(jumping_rows(poses)).tolist() == [33]


@pytest.mark.parametrize(
    "steps",
    [
        np.concatenate([np.zeros(40), np.linspace(0, 0.5, 8), np.full(40, 0.5)]),  # a quick pull
        np.concatenate([np.linspace(0, 0.4, 20), np.linspace(0.4, 0, 20)]),  # there and back
        np.concatenate([np.zeros(30), np.full(30, 0.3)]),  # a step is no jump: it stays
    ],
    ids=["quick pull", "there and back", "step"],
)
def test_motion_is_no_jump(steps):
    assert not jumping_rows(_log(steps=steps, noise_m=0.0005)).any()
    assert not jumping_rows(_log(steps=steps, noise_m=0.0, noise_rad=0.0)).any()


def test_jumps_are_left_out_and_counted_and_their_states_unknown():
    poses = _log()
    poses.p_world[[11, 50]] += [0.0, 0.3, 0.0]
    posterior = fit_poses(poses)
    assert posterior.kind == "prismatic"
    assert posterior.fit.rows_left_out == 2
    assert any("2 of 80 rows jump away" in text for text in posterior.fit.warnings)
    assert np.flatnonzero(np.isnan(posterior.best.states.mean)).tolist() == [11, 50]


def test_where_too_many_rows_jump_no_kind_is_named():
    poses = _log()
    poses.p_world[4::8] += [0.0, 0.3, 0.0]
    posterior = fit_poses(poses)
    assert posterior.fit.rows_left_out == 10
    assert posterior.kind == "undecided"
