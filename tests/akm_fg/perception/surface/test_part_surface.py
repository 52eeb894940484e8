"""The moving part's surface in keyframes of a rendered recording, its true motion being known."""

import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.observe import observe_motion
from akm_fg.perception.surface.part_surface import PartSurface
from akm_fg.steps import to_end
from factors.measurements.dense_registration import dense_cost

PART = 2
FRAMES = (0, 5, 10, 14)


@pytest.fixture(scope="module")
def surface(door):
    return PartSurface(door.recording, observe_motion(door.recording), DepthNoiseModel())


@pytest.fixture(scope="module")
def motions(door):
    poses = [door.scene.motion(q) for q in door.states]
    R = np.array([pose.rotation().matrix() for pose in poses])
    return R, np.array([pose.translation() for pose in poses])


def _views(surface, motions, frames=FRAMES, known=None):
    known = np.ones(len(motions[0]), dtype=bool) if known is None else known
    return to_end(surface.views(frames, *motions, known))


def test_clouds_lie_on_the_part_in_every_keyframe(surface, motions, door):
    views = _views(surface, motions)
    assert views.frames == FRAMES
    for cloud, frame in zip(views.clouds, FRAMES, strict=True):
        assert cloud.frame == frame
        u, v = cloud.uv.astype(int).T
        assert (door.labels[frame][v, u] == PART).mean() > 0.98
        assert len(u) > 0.5 * (door.labels[frame] == PART).sum() / 4  # every second pixel each way


def test_patches_are_found_again_under_the_true_motion_within_their_noise(surface, motions):
    views = _views(surface, motions)
    at = [m[list(FRAMES)] for m in motions]
    patches = views.associate(*at, 0.03).patches
    assert patches.precision.shape[1] > 1000
    assert patches.seen.mean() > 0.8
    d2 = dense_cost(*at, patches, 6.0, 1.0).d2[patches.seen]
    assert 0.005 < np.median(d2) < 0.455  # smoothed readings: under the median of a chi-square


def test_frames_of_unknown_motion_are_not_seen(surface, motions):
    known = np.ones(len(motions[0]), dtype=bool)
    known[[3, 4, 5, 6]] = False
    assert _views(surface, motions, known=known).frames == (0, 10, 14)


def test_the_same_seed_gives_the_same_patches(surface, motions):
    at = [m[[0, 14]] for m in motions]
    a, b = (_views(surface, motions, (0, 14)).associate(*at, 0.03) for _ in range(2))
    np.testing.assert_array_equal(a.patches.p_world, b.patches.p_world)
