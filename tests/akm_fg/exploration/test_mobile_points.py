"""What moved is told by its tracks, and of a plain part by its surface."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.exploration.mobile_points import PANEL_M, mobile_tracks
from akm_fg.exploration.records import Contact
from akm_fg.exploration.stopping import StopConfig, by_threshold
from akm_fg.records import PointTracks
from factors.joint import Joint

NORMAL = np.array([-1.0, 0.0, 0.0])
CONTACT = Contact(np.array([0.6, 0.0, 0.5]), np.zeros(2), NORMAL, 0, 0.5)
ALONG = np.array([[0.0, 0.0, -1.0, 0.0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # z: NORMAL


def seen(tracks: int, q: list[float] | None) -> Any:
    """A fit over three frames: so many tracks that went 6 cm, and the states by the surface."""
    way = np.array([0.0, 0.03, 0.06])[:, None, None] * NORMAL
    p = np.zeros((3, tracks, 3)) + way
    moving = PointTracks(p, np.tile(np.eye(3) * 1e-6, (3, tracks, 1, 1)))
    joint = states = None
    if q is not None:
        joint = SimpleNamespace(joint=Joint("prismatic", ALONG, 0.0))
        states = SimpleNamespace(mean=np.array(q))
    best = SimpleNamespace(joint=joint, states=states)
    return SimpleNamespace(
        observed=SimpleNamespace(moving_tracks=moving), posterior=SimpleNamespace(best=best)
    )


def test_where_points_were_followed_they_tell():
    fit = seen(2, [0.0, 0.05, 0.1])
    assert mobile_tracks(fit, CONTACT) is fit.observed.moving_tracks


@pytest.mark.parametrize(("q", "opened"), [([0.0, 0.04, 0.08], True), ([0.0, 0.02, 0.04], False)])
def test_a_plain_part_goes_as_its_surface_says(q, opened):
    found = mobile_tracks(seen(0, q), CONTACT)
    assert found.p_world.shape == (3, 4, 3)
    went = found.p_world[2] - found.p_world[0]
    assert_allclose(went, np.tile(q[2] * NORMAL, (4, 1)), atol=1e-12)
    apart = np.linalg.norm(found.p_world[0] - CONTACT.p_world, axis=1)
    assert_allclose(apart, PANEL_M * np.sqrt(2))
    assert by_threshold(found, 0.1, StopConfig()) == opened


def test_frames_that_do_not_show_it_and_what_rests_tell_nothing():
    hidden = mobile_tracks(seen(0, [0.0, 0.08, np.nan]), CONTACT)
    assert hidden.observed.tolist() == [[True] * 4, [True] * 4, [False] * 4]
    assert by_threshold(hidden, 0.1, StopConfig())
    assert not by_threshold(mobile_tracks(seen(0, None), CONTACT), 0.1, StopConfig())
