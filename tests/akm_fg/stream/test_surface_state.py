"""A frame's state by the part's surface alone, against the rendered truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from akm_fg.estimation.config import FitConfig, SurfaceConfig
from akm_fg.estimation.sources.surface import SURFACE
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.observe import observe_motion
from akm_fg.perception.surface.known_surface import Found
from akm_fg.pipeline import fit_recording
from akm_fg.posterior import FitReport
from akm_fg.stages import ModelSettings
from akm_fg.steps import to_end
from akm_fg.stream.joint_estimate import estimate_in_steps
from akm_fg.stream.surface_state import (
    HeldSurface,
    SurfaceStateConfig,
    _found_again,
    _on_the_path,
    with_surface_states,
)

NOISE, CONFIG = DepthNoiseModel(), SurfaceStateConfig()


def estimated(clip):
    return to_end(
        estimate_in_steps(clip.recording, observe_motion(clip.recording), ModelSettings())
    )


def held(clip) -> HeldSurface:
    """The surface of a clip's likeliest kind."""
    fitted = estimated(clip).fitted
    best = fitted.posterior.best.joint.kind
    (fit,) = (fit for fit in fitted.fits if fit.kind == best)
    surface = HeldSurface.of(fit, fitted.problem.sources, CONFIG)
    assert surface is not None
    return surface


@pytest.fixture(scope="module", params=["door", "drawer"])
def surface(request):
    clip = request.getfixturevalue(request.param)
    return clip, held(clip)


def test_a_state_is_found_from_centimetres_away_within_its_deviation(surface):
    clip, here = surface
    for t in (4, 8, 13):
        start = 0.8 * clip.states[t]  # up to 4 cm at the handle
        q, sd = here.state(clip.frames[t], NOISE, start, CONFIG)
        assert abs(q - clip.states[t]) < 4 * sd
        assert sd < 0.005


@pytest.mark.parametrize(
    ("found", "read", "again"),
    [
        (130, 380, True),  # a third of all, whatever else is in its place
        (100, 380, False),
        (60, 90, True),  # depth is lost in patches, and two thirds of what is left is the part
        (60, 110, False),
        (30, 30, False),  # too few to be known by
    ],
)
def test_a_part_whose_depth_is_lost_in_patches_is_known_by_what_is_left(
    found: int, read: int, again: bool
):
    one = Found(0.1, 1.0, found, read, 1.0, np.zeros(400, dtype=bool))
    assert _found_again(one, 400, CONFIG) is again


def test_covered_or_gone_there_is_no_state(surface):
    clip, here = surface
    frame = clip.frames[8]
    for depth_m in (np.full_like(frame.depth_m, np.nan), frame.depth_m - np.float32(0.5)):
        covered = replace(frame, depth_m=depth_m)
        assert here.state(covered, NOISE, clip.states[8], CONFIG) is None


def test_a_part_that_slides_within_its_own_plane_tells_no_state(surface):
    """Its surface is there, wherever it has gone."""
    clip, here = surface
    known = here.surface
    across = np.cross(known.normal_world[0], [0.0, 0.0, 1.0])
    flat = np.broadcast_to(known.normal_world[0], known.normal_world.shape)
    joint = replace(
        estimated(clip).fitted.posterior.alternatives["prismatic"].joint.joint,
        T_world_joint=_along(across / np.linalg.norm(across), known.x_world.mean(axis=0)),
    )
    sliding = replace(here, surface=replace(known, joint=joint, normal_world=flat))
    assert sliding.state(clip.frames[0], NOISE, 0.0, CONFIG) is None


def _along(axis, origin) -> np.ndarray:
    T = np.eye(4)
    x = np.cross(axis, [0.3, 0.5, 0.8])
    x /= np.linalg.norm(x)
    T[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    T[:3, 3] = origin
    return T


def test_frames_of_a_plain_door_that_no_graph_holds_have_states_too(door):
    plain = tuple(replace(f, rgb=np.full_like(f.rgb, 120)) for f in door.frames)
    few = FitConfig(surface=SurfaceConfig(keyframes_alone=6))
    found = fit_recording(replace(door.recording, frames=plain), fit_config=few).posterior
    assert len(found.fit.keyframes_registered) == 6
    states = found.best.states
    assert np.isfinite(states.mean[door.states > 0.1]).all()
    known = np.isfinite(states.mean) & (np.arange(15) > 0)
    assert_allclose(states.mean[known], door.states[known], atol=0.02)
    beside = known & ~np.isin(np.arange(15), found.fit.keyframes_registered)
    assert beside.sum() >= 6
    off = (states.mean - door.states)[beside] / states.sd[beside]
    assert np.abs(off).max() < 5


def test_states_that_are_known_stay_as_they_are(door):
    estimate = estimated(door)
    posterior = estimate.posterior()
    frames = dict(enumerate(door.frames))
    same = with_surface_states(posterior, estimate.fitted, frames, NOISE)
    assert_array_equal(same.best.states.mean, posterior.best.states.mean)
    gone = posterior.best.states.mean.copy()
    gone[[5, 14]] = np.nan
    best = replace(posterior.best, states=replace(posterior.best.states, mean=gone))
    lacking = replace(posterior, alternatives={**posterior.alternatives, "revolute": best})
    filled = with_surface_states(lacking, estimate.fitted, frames, NOISE).best.states
    assert_allclose(filled.mean[[5, 14]], posterior.best.states.mean[[5, 14]], atol=0.004)
    assert (filled.sd[[5, 14]] >= posterior.best.states.sd[[5, 14]].min()).all()


def test_without_a_surface_nothing_is_filled_in(door):
    settings = ModelSettings(sources="tracks")
    observed = observe_motion(door.recording)
    fitted = to_end(estimate_in_steps(door.recording, observed, settings)).fitted
    assert SURFACE not in fitted.fits[0].said
    posterior = fitted.posterior
    assert with_surface_states(posterior, fitted, {0: door.frames[0]}, NOISE) is posterior
    assert isinstance(posterior.fit, FitReport)


NAN = np.nan


@pytest.mark.parametrize(
    ("mean", "number", "q", "believed"),
    [
        ([0.0, 0.1, 0.2, 0.3, NAN, NAN], 4, 0.4, True),
        ([0.0, 0.1, 0.2, 0.3, NAN, NAN], 4, -0.2, False),  # back to where it came from, at once
        ([0.0, 0.1, 0.2, 0.3, NAN, NAN, NAN], 6, 0.3, False),  # after frames that nobody knows
        ([0.0, 0.1, NAN, NAN, NAN, NAN, 0.6], 3, 0.3, True),  # between what is known
        ([0.0, 0.1, NAN, NAN, NAN, NAN, 0.6], 3, 2.0, False),
        ([0.0, 0.0, 0.0, NAN], 3, 0.02, True),  # at rest: within its deviations
        ([0.0, 0.0, 0.0, NAN], 3, 0.5, False),
    ],
)
def test_a_state_is_believed_where_the_part_may_have_gone(mean, number, q, believed):
    mean = np.array(mean)
    sd = np.full(mean.size, 0.005)
    assert _on_the_path(number, q, 0.005, mean, sd, SurfaceStateConfig()) is believed
