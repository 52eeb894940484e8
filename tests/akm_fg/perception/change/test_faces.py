"""Planes of a face in depth images, and the joints that allow them; geometry worked by hand."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.change.depth_change import DepthChange, depth_change
from akm_fg.perception.change.face_joints import FaceJointConfig, starts_from_faces
from akm_fg.perception.change.face_planes import FaceConfig, FacePlanes, face_planes
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from akm_fg.steps import to_end

FRONT = np.array([0.0, -1.0, 0.0])  # normal of the closed face, towards the camera
TILTS = FaceJointConfig()


def faces(
    normals: np.ndarray, centres: np.ndarray, frames: tuple[int, ...] | None = None
) -> FacePlanes:
    """Planes through points; the closed face is y = 0."""
    K = len(normals)
    rng = np.random.default_rng(0)
    points = []
    for n, c in zip(normals, centres, strict=True):
        across = np.linalg.svd(n[None])[2][1:]
        points.append(c + rng.uniform(-0.1, 0.1, (20, 2)) @ across)
    return FacePlanes(
        frames or tuple(range(1, K + 1)),
        normals,
        (normals * centres).sum(axis=1),
        centres,
        tuple(points),
        FRONT,
        0.0,
    )


def swung(angles: np.ndarray, hinge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals and middles of a face, 0.3 m wide, turned about an upright hinge at its left edge."""
    R = [gtsam.Rot3.Rz(a).matrix() for a in angles]
    normals = np.array([r @ FRONT for r in R])
    centres = np.array([hinge + r @ np.array([0.15, 0.0, 0.0]) for r in R])
    return normals, centres


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_drawers_axis_points_the_way_it_goes_and_its_states_grow(way: float):
    """Out by 3, 6, 9 cm, or in from where it stood: both are states of 3, 6, 9 cm."""
    travel = np.array([0.03, 0.06, 0.09])
    planes = faces(np.tile(FRONT, (3, 1)), way * travel[:, None] * FRONT)
    (start,) = starts_from_faces(planes, 4, TILTS)
    np.testing.assert_allclose(start.guess.q, [0.0, *travel], atol=1e-12)
    np.testing.assert_allclose(start.guess.joint.T_world_joint[:3, 2], way * FRONT, atol=1e-12)
    assert start.metres_per_state == pytest.approx(way)


@pytest.mark.parametrize("turn", [0.6, -0.6])
def test_a_hinge_is_where_its_faces_meet_and_its_states_grow(turn: float):
    hinge = np.array([-0.2, 0.0, 0.0])
    angles = np.linspace(0.2, 1.0, 6) * turn
    start, *_ = starts_from_faces(faces(*swung(angles, hinge)), 7, TILTS)
    assert start.guess.kind == "revolute"
    np.testing.assert_allclose(start.guess.q[1:], np.abs(angles), atol=1e-6)
    axis, origin = start.guess.joint.T_world_joint[:3, 2], start.guess.joint.T_world_joint[:3, 3]
    np.testing.assert_allclose(axis, [0.0, 0.0, np.sign(turn)], atol=1e-6)
    np.testing.assert_allclose(origin[:2], hinge[:2], atol=1e-3)


def test_a_thin_lid_that_has_passed_edge_on_shows_its_back_and_its_states_go_on():
    """A camera that looks along the closed face's normal sees its back from a quarter turn on."""
    hinge = np.array([-0.2, 0.0, 0.0])
    angles = np.linspace(0.3, 2.3, 6)
    normals, centres = swung(angles, hinge)
    normals[normals @ FRONT < 0] *= -1
    start, *_ = starts_from_faces(faces(normals, centres), 7, TILTS)
    assert start.guess.kind == "revolute"
    np.testing.assert_allclose(start.guess.q[1:], angles, atol=1e-6)
    np.testing.assert_allclose(start.guess.joint.T_world_joint[:2, 3], hinge[:2], atol=1e-3)
    outer = start.normal_world @ FRONT
    np.testing.assert_allclose(np.abs(outer), 1.0, atol=1e-6)  # each point with its own side
    assert (outer > 0).any() and (outer < 0).any()


def test_a_box_that_turns_its_side_to_the_camera_goes_on_turning():
    """From the third plane on it is the side at a right angle to the face that is the largest."""
    hinge = np.array([-0.2, 0.0, 0.0])
    angles = np.array([0.1, 0.2, 0.45, 0.7, 0.95, 1.2])
    normals, centres = swung(angles, hinge)
    for k in range(2, 6):
        R = gtsam.Rot3.Rz(angles[k]).matrix()
        normals[k], centres[k] = R @ [-1.0, 0.0, 0.0], hinge + R @ [-0.02, 0.1, 0.0]
    starts = starts_from_faces(faces(normals, centres), 7, TILTS)
    found = [s.guess for s in starts if s.guess.kind == "revolute"]
    (right,) = (g for g in found if np.allclose(g.q[1:], angles, atol=1e-6))
    np.testing.assert_allclose(right.joint.T_world_joint[:2, 3], hinge[:2], atol=0.02)


def test_one_face_that_is_warped_does_not_tilt_the_hinge():
    """Of seven faces one is tilted by 0.05 rad, ten deviations: least squares would follow it."""
    hinge = np.array([-0.2, 0.0, 0.0])
    normals, centres = swung(np.linspace(0.15, 0.6, 7), hinge)
    across = np.cross(normals[6], [0.0, 0.0, 1.0])
    normals[6] = gtsam.Rot3.Expmap(0.05 * across).matrix() @ normals[6]
    start, *_ = starts_from_faces(faces(normals, centres), 8, TILTS)
    axis = start.guess.joint.T_world_joint[:3, 2]
    assert np.linalg.norm(np.cross(axis, [0.0, 0.0, 1.0])) < 0.01


CAMERA = PinholeCamera(640, 480, 600.0, 600.0, 319.5, 239.5)


def opened_door(angle: float) -> DepthChange:
    """Noise-free: a wall 1 m away, and in it a door from x = -0.2 to 0.2 m, hinged on the left."""
    x = ((np.arange(640) - CAMERA.cx) / CAMERA.fx)[None].repeat(480, axis=0)
    frames = []
    for t in (0.0, np.tan(angle)):
        z = (1.0 - 0.2 * t) / (1.0 + t * x)  # the door's plane: z = 1 - t (x z + 0.2)
        on = (x * z >= -0.2) & (x * z <= -0.2 + 0.4 * np.cos(np.arctan(t)))
        depth = np.where(on, z, 1.0).astype(np.float32)
        rgb = np.zeros((480, 640, 3), np.uint8)
        frames.append(RgbdFrame(t, rgb, depth, CAMERA, gtsam.Pose3()))
    everywhere = np.ones((480, 640), bool)
    recording = Recording("door", tuple(frames))
    return to_end(depth_change(recording, everywhere, DepthNoiseModel()))


@pytest.mark.parametrize("angle_deg", [8.0, 15.0, 35.0])
def test_the_plane_of_a_door_is_its_own_where_the_wall_beside_the_hinge_is_near_it(
    angle_deg: float,
):
    """Left of the hinge the wall is within the gate of the door's plane, and would bend it."""
    angle = np.deg2rad(angle_deg)
    found = face_planes(opened_door(angle), [1], FaceConfig())
    assert found is not None and found.frames == (1,)
    np.testing.assert_allclose(found.normal_0, [0.0, 0.0, -1.0], atol=1e-4)
    assert found.offset_0 == pytest.approx(-1.0, abs=1e-4)
    normal = np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    off = np.arccos(min(float(found.normal[0] @ normal), 1.0))
    assert np.rad2deg(off) < 0.05
    hinge = np.array([-0.2, 0.0, 1.0])
    assert found.offset[0] == pytest.approx(float(normal @ hinge), abs=3e-4)
