"""Surface patches: set once a cell, found again where the depth shows their plane, and only there.

Depth images are of planes, worked out pixel by pixel; the camera stands at the world's origin.
"""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import depth_planes
from akm_fg.perception.surface.patches import PatchConfig, PatchViews, patch_views
from akm_fg.records import PinholeCamera, RgbdFrame
from factors.measurements.dense_registration import dense_cost

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
NOISE = DepthNoiseModel()
FRONT = (np.array([0.2, -0.1, -1.0]), 1.0)  # normal towards the camera, distance in metres
GATE_M = 0.03


def _depth(normal, distance):
    """Depth (H, W) of the plane n . p = -distance, n the unit vector along `normal`."""
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = CAMERA.back_project(np.stack([u, v], -1), np.ones_like(u))
    return -distance / (rays @ n)


def _planes(depth, mask=None):
    rgb = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    frame = RgbdFrame(0.0, rgb, depth.astype(np.float32), CAMERA, gtsam.Pose3())
    return depth_planes(frame, NOISE, mask)


def _views(*planes, **config) -> PatchViews:
    rng = np.random.default_rng(0)
    return patch_views(range(len(planes)), planes, rng, PatchConfig(**config))


def _motions(*poses):
    R = np.array([pose.rotation().matrix() for pose in poses])
    return R, np.array([pose.translation() for pose in poses])


def _moved(plane, pose):
    """Normal and distance of a plane that moved with the part."""
    n = plane[0] / np.linalg.norm(plane[0])
    turned = pose.rotation().matrix() @ n
    return turned, plane[1] - turned @ pose.translation()


STILL = gtsam.Pose3()
TURN = gtsam.Pose3(gtsam.Rot3.Ry(0.1), np.array([0.05, 0.0, -0.04]))


def test_exact_planes_leave_nothing_after_the_true_motion():
    views = _views(_planes(_depth(*FRONT)), _planes(_depth(*_moved(FRONT, TURN))))
    R, t = _motions(STILL, TURN)
    patches = views.associate(R, t, GATE_M).patches
    assert patches.precision.shape[1] > 500
    assert patches.seen.mean() == 1.0  # two views, both needed
    cost = dense_cost(R, t, patches, 6.0, 1.0)
    assert np.abs(cost.e).max() < 2e-5  # depth in single precision
    n = FRONT[0] / np.linalg.norm(FRONT[0])
    assert (patches.normal_world.T @ n).min() > 1 - 1e-6
    wrong = _motions(STILL, TURN.compose(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, 0.005]))))
    off = dense_cost(*wrong, views.associate(*wrong, GATE_M).patches, 6.0, 1.0).e
    assert_allclose(off[0] - off[1], 0.005 * n[2], rtol=1e-2)


def test_an_observation_is_where_the_patchs_ray_meets_the_plane():
    views = _views(_planes(_depth(*FRONT)), _planes(_depth(*_moved(FRONT, TURN))))
    near = TURN.compose(gtsam.Pose3(gtsam.Rot3(), np.array([0.004, 0, 0.003])))
    seen = views.associate(*_motions(STILL, near), GATE_M)
    n, distance = _moved(FRONT, TURN)
    assert_allclose(n @ seen.patches.p_world[1], -distance, atol=2e-5)
    assert_allclose(CAMERA.project(seen.patches.p_world[1].T), seen.uv[1], atol=1e-6)


def test_patches_that_only_moved_views_show_are_taken_back_to_where_they_belong():
    left = np.zeros((CAMERA.height, CAMERA.width), bool)
    left[:, :80] = True
    moved = _planes(_depth(*_moved(FRONT, TURN)))
    views = _views(_planes(_depth(*FRONT), left), moved, moved)
    still = _motions(STILL, TURN, TURN)
    patches = views.associate(*still, GATE_M).patches
    new = ~patches.seen[0]
    assert new.sum() > 800
    assert patches.seen[1:, new].all()
    R, t = TURN.rotation().matrix(), TURN.translation()
    back = R.T @ (patches.p_world[1][:, new] - t[:, None])
    n = FRONT[0] / np.linalg.norm(FRONT[0])
    assert_allclose(n @ back, -FRONT[1], atol=5e-5)
    u = CAMERA.project(back.T)[:, 0]
    assert ((u > 70) | (u < 8)).mean() > 0.95  # where the first view shows no plane


def test_precision_is_that_of_one_reading_along_the_normal():
    straight = (np.array([0.0, 0.0, -1.0]), 1.2)
    views = _views(_planes(_depth(*straight)), _planes(_depth(*straight)))
    precision = views.associate(*_motions(STILL, STILL), GATE_M).patches.precision
    want = NOISE.sigma_m(np.array([1.2]), CAMERA.fx)[0] ** -2
    assert_allclose(precision, want, rtol=1e-3)


def test_what_covers_a_patch_by_more_than_the_gate_is_no_observation():
    """Something flat stands 10 cm before the right half of the second view."""
    covered = _depth(*FRONT)
    covered[:, 80:] = _depth(FRONT[0], FRONT[1] - 0.1)[:, 80:]
    views = _views(_planes(_depth(*FRONT)), _planes(covered), _planes(_depth(*FRONT)))
    seen = views.associate(*_motions(STILL, STILL, STILL), GATE_M)
    u = seen.uv[1, :, 0]
    second = seen.patches.seen[1]
    from_first = np.abs(dense_cost(*_motions(STILL, STILL, STILL), seen.patches, 6.0, 1.0).e)
    assert second[u < 70].mean() > 0.9
    assert from_first.max() < 1e-4
    on_front = (
        np.abs(seen.patches.normal_world.T @ (FRONT[0] / np.linalg.norm(FRONT[0])) - 1) < 1e-6
    )
    assert not second[(u > 90) & on_front & seen.patches.seen[0]].any()
    # A gate as wide as the step lets it in: the gate is what keeps it out.
    wide = views.associate(*_motions(STILL, STILL, STILL), 0.2)
    assert wide.patches.seen[1][wide.uv[1, :, 0] > 90].mean() > 0.9


def test_a_patch_off_the_parts_mask_or_outside_the_image_is_no_observation():
    left = np.zeros((CAMERA.height, CAMERA.width), bool)
    left[:, :80] = True
    aside = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, 0.0]))
    views = _views(
        _planes(_depth(*FRONT)),
        _planes(_depth(*FRONT), left),
        _planes(_depth(*_moved(FRONT, aside))),
        _planes(_depth(*FRONT)),
    )
    seen = views.associate(*_motions(STILL, STILL, aside, STILL), GATE_M)
    masked, moved = seen.patches.seen[1], seen.patches.seen[2]
    assert not masked[seen.uv[1, :, 0] > 80].any() and masked.any()
    outside = (seen.uv[2, :, 0] > CAMERA.width) | (seen.uv[2, :, 0] < 0)
    assert outside.sum() > 100
    assert not moved[outside].any() and moved[~outside].mean() > 0.9


def test_a_plane_of_another_normal_is_no_observation():
    """Like depth in the middle of the image, turned by half a radian."""
    other = (np.array([0.2 + 0.55, -0.1, -1.0]), 1.0)
    n = other[0] / np.linalg.norm(other[0])
    middle = np.array([0, 0, -1.0])
    distance = (n @ middle) / ((FRONT[0] / np.linalg.norm(FRONT[0])) @ middle)
    turned = _depth(other[0], distance)  # through the same point on the camera's axis
    front = _planes(_depth(*FRONT))
    near = np.s_[40:80, 60:100]
    assert np.abs(turned - _depth(*FRONT))[near].max() < 0.1
    still = _motions(STILL, STILL, STILL)
    strict = _views(front, _planes(turned), front).associate(*still, 0.2)
    loose = _views(front, _planes(turned), front, max_normal_angle_rad=0.8).associate(*still, 0.2)
    both = [(a.patches.seen[1] & a.patches.seen[0]).sum() for a in (strict, loose)]
    assert both[0] == 0
    assert both[1] > 500


def test_a_patch_that_cannot_be_found_again_is_left_out():
    left, right = (np.zeros((CAMERA.height, CAMERA.width), bool) for _ in range(2))
    left[:, :80], right[:, 80:] = True, True
    depth = _depth(*FRONT)
    none = _views(_planes(depth, left), _planes(depth, right))
    assert none.associate(*_motions(STILL, STILL), GATE_M).patches.precision.shape == (2, 0)
    once = _views(_planes(depth, left), _planes(depth, right), min_views=1)
    assert once.associate(*_motions(STILL, STILL), GATE_M).patches.precision.shape[1] > 500


def test_there_is_one_patch_a_cell():
    """Of two views of the same plane: on it, patches are as many as one view's cells."""
    views = _views(_planes(_depth(*FRONT)), _planes(_depth(*FRONT)), cell_m=0.02)
    still = _motions(STILL, STILL)
    x = views._patches(*still)[0]
    cells = np.floor(x / 0.02).astype(int)
    assert len(np.unique(cells.T, axis=0)) == x.shape[1]
    every = np.unique(np.floor(views.clouds[0].p_world / 0.02).astype(int), axis=0)
    assert len(every) <= x.shape[1] < 1.2 * len(every)


def test_too_many_patches_get_larger_cells():
    views = _views(_planes(_depth(*FRONT)), _planes(_depth(*FRONT)), max_patches=200)
    count = views.associate(*_motions(STILL, STILL), GATE_M).patches.precision.shape[1]
    assert 100 < count <= 200


def test_a_view_without_any_plane_is_left_out():
    nothing = _planes(np.full((CAMERA.height, CAMERA.width), np.nan))
    front = _planes(_depth(*FRONT))
    views = patch_views([3, 5, 9], [front, nothing, front], np.random.default_rng(0))
    assert views.frames == (3, 9) and len(views.planes) == len(views.clouds) == 2


@pytest.mark.parametrize("seed", [0, 1])
def test_one_seed_sets_the_same_patches(seed):
    planes = [_planes(_depth(*FRONT)), _planes(_depth(*_moved(FRONT, TURN)))]
    a, b = (
        patch_views([0, 1], planes, np.random.default_rng(seed), points_per_frame=300).associate(
            *_motions(STILL, TURN), GATE_M
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(a.patches.p_world, b.patches.p_world)
    assert 100 < a.patches.precision.shape[1] <= 600


def test_a_view_that_shows_what_lies_behind_the_part_sees_through_it():
    """The second view's part is gone from its place but for a strip; the third is covered."""
    front, behind = _depth(*FRONT), _depth(FRONT[0], FRONT[1] + 0.2)
    strip = np.where(np.arange(CAMERA.width) < 40, front, behind)
    before = _depth(FRONT[0], FRONT[1] - 0.2)
    views = _views(_planes(front), _planes(strip), _planes(before), _planes(front))
    seen_through = views.associate(*_motions(*[STILL] * 4), GATE_M).seen_through
    assert seen_through[0] == seen_through[3] == 0
    assert 0.6 < seen_through[1] < 0.9
    assert np.isnan(seen_through[2])  # nothing of it can be judged


def test_a_patch_that_would_show_its_back_is_seen_nowhere_and_judges_nothing():
    over = gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.array([0.0, 0.0, 2.0]))
    there = _planes(_depth(*FRONT))
    views = _views(there, there, _planes(_depth(FRONT[0], FRONT[1] + 0.2)))
    seen = views.associate(*_motions(STILL, STILL, over), GATE_M)
    assert seen.patches.seen[0].all() and not seen.patches.seen[2].any()
    assert np.isnan(seen.seen_through[2])


def _halves(left, right):
    """Depth of one plane in the left half of the image and of another in the right half."""
    return np.where(np.arange(CAMERA.width) < CAMERA.width // 2, left, right)


def test_what_was_there_before_the_part_came_is_not_the_part():
    """In the right half a wall stands where a false motion would put the part: 25 cm nearer."""
    near = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.25]))
    front, nearer = _depth(*FRONT), _depth(*_moved(FRONT, near))
    still, moved = _planes(_halves(front, nearer)), _planes(nearer)
    false = _views(still, still).associate(*_motions(STILL, near), GATE_M).was_there
    assert np.isnan(false[0]) and false[1] > 0.95
    true = _views(_planes(front), moved).associate(*_motions(STILL, near), GATE_M).was_there
    assert np.isnan(true[0]) and true[1] == 0


def test_what_a_part_that_came_nearer_has_covered_is_not_the_part():
    """A surface 25 cm behind the front; of drawers that close it is theirs."""
    back = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.25]))
    planes = _planes(_depth(*FRONT)), _planes(_depth(*_moved(FRONT, back)))
    views = _views(*planes)
    assert views.associate(*_motions(STILL, back), GATE_M).was_there[1] == 0
    opened = replace(views, came_nearer=True)
    assert opened.associate(*_motions(STILL, back), GATE_M).was_there[1] == 1


def test_of_many_patches_so_many_are_looked_for_all_over_the_part():
    views = _views(*[_planes(_depth(*FRONT))] * 2)
    every = views.associate(*_motions(STILL, STILL), GATE_M)
    some = views.associate(*_motions(STILL, STILL), GATE_M, 100)
    assert every.patches.precision.shape[1] > 200
    assert some.patches.precision.shape[1] == 100
    for axis in (0, 1):
        spans = [np.ptp(seen.uv[0, :, axis]) for seen in (every, some)]
        assert spans[1] > 0.9 * spans[0]
    more = views.associate(*_motions(STILL, STILL), GATE_M, 10**6)
    assert more.patches.precision.shape == every.patches.precision.shape
