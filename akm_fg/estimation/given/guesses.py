"""Closed-form starts for the joints: screw axes of rigid motions, lines and circles of paths."""

from __future__ import annotations

import numpy as np

from akm_fg.geometry.joint_guess import JointGuess, joint_frame
from akm_fg.geometry.rigid_motion import RigidMotion
from akm_fg.records import BoolArray, FloatArray
from factors.joint import Joint, JointKind, cross
from factors.measurements.orientation_track import log_so3

# A hinge farther away than this is a drawer for every purpose of a start; metres.
MAX_RADIUS_M = 100.0
_MIN_RADIUS_M = 0.01
# Of one point's path nothing but the bend tells the hinge.
_FAR_HINGES_M = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


def guesses_from_motion(motion: RigidMotion) -> list[JointGuess]:
    """Starts of both kinds from free rigid motions (three or more tracks)."""
    centroid = motion.shape_world[motion.inlier].mean(axis=0)
    path = motion.R_world @ centroid + motion.t_world
    drawer = _straight(path, motion.known)[0]
    return [drawer, *hinges_of_motions(motion.R_world, motion.t_world, path, motion.known)]


def hinges_of_motions(
    R_world: FloatArray, t_world: FloatArray, path: FloatArray, known: BoolArray
) -> list[JointGuess]:
    """Hinges that free motions turn about.

    Args:
        R_world: (T, 3, 3) from the reference frame; where known, else anything.
        t_world: (T, 3).
        path: (T, 3) of the part's middle, or of a marker on it.
        known: (T,).
    """
    turns = np.zeros_like(t_world)
    turns[known] = log_so3(R_world[known])
    # Relative to the reference frame, which in mid-travel sees both signs.
    _, axes = np.linalg.eigh(turns.T @ turns)
    axis = axes[:, -1]
    q = _unwrapped(turns @ axis, known)
    pivots = [_pivot_of_motions(R_world[known], t_world[known], axis, path[known].mean(axis=0))]
    circle = _circle_about(axis, path[known])
    if circle is not None:
        pivots.append(circle)
    return [_guess(JointKind.REVOLUTE, axis, pivot, q, known) for pivot in pivots]


def drawer_along(path: FloatArray) -> JointGuess:
    """The drawer whose centroid walks along a path (T, 3)."""
    return _straight(path, np.ones(len(path), dtype=bool))[0]


def guesses_from_path(path: FloatArray, known: BoolArray) -> list[JointGuess]:
    """Starts of both kinds from the path (T, 3) of one point."""
    points = path[known]
    centre = points.mean(axis=0)
    drawer, directions = _straight(path, known)
    guesses = [drawer]
    if points.shape[0] < 3:
        return guesses
    normal = directions[2]
    pivots = [_circle_about(normal, points)]
    # A nearly straight path: far hinges to either side of it, in the plane of its bend.
    side = cross(normal, directions[0])
    pivots += [centre + sign * r * side for r in _FAR_HINGES_M for sign in (1.0, -1.0)]
    return guesses + [
        _guess(JointKind.REVOLUTE, normal, pivot, _angles(path, normal, pivot), known)
        for pivot in pivots
        if pivot is not None
    ]


def _straight(path: FloatArray, known: BoolArray) -> tuple[JointGuess, FloatArray]:
    """The drawer along a path, and the path's principal directions (3, 3), the longest first."""
    points = path[known]
    centre = points.mean(axis=0)
    _, _, directions = np.linalg.svd(points - centre, full_matrices=False)
    along = (path - centre) @ directions[0]
    return _guess(JointKind.PRISMATIC, directions[0], points[0], along, known), directions


def _angles(path: FloatArray, axis: FloatArray, pivot: FloatArray) -> FloatArray:
    """Continuous angles (T,) of a path about an axis line."""
    frame = joint_frame(axis, pivot)
    local = (path - pivot) @ frame[:3, :3]
    angles = np.arctan2(local[:, 1], local[:, 0])
    return _unwrapped(angles, np.isfinite(angles))


def _unwrapped(angles: FloatArray, known: BoolArray) -> FloatArray:
    """Angles (T,) without jumps of full turns: between known frames the shorter way was gone."""
    angles = angles.copy()
    angles[known] = np.unwrap(angles[known])
    return angles


def _guess(
    kind: JointKind, axis: FloatArray, origin: FloatArray, q: FloatArray, known: BoolArray
) -> JointGuess:
    """A guess with states zero in frame 0, unknown frames filled in between their neighbours."""
    t = np.arange(q.size)
    q = np.interp(t, t[known], q[known])
    return JointGuess(Joint(kind, joint_frame(axis, origin), 0.0), q - q[0])


def _pivot_of_motions(
    R_world: FloatArray, t_world: FloatArray, axis: FloatArray, centroid: FloatArray
) -> FloatArray:
    """Point that all frames leave in place across the axis: least squares of (I - R) c = t."""
    across = np.eye(3) - np.outer(axis, axis)
    A = (across @ (np.eye(3) - R_world)).reshape(-1, 3)
    b = (t_world @ across).reshape(-1)
    # Undetermined along the axis and, without rotation, everywhere: stay near the centroid.
    ridge = 1e-6 * max(float(np.abs(A).max()), 1e-9) * np.eye(3)
    offset = np.linalg.lstsq(np.vstack([A, ridge]), np.concatenate([b - A @ centroid, np.zeros(3)]))
    return centroid + _bounded(across @ offset[0])


def _bounded(offset: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(offset))
    if length > MAX_RADIUS_M:
        return offset * (MAX_RADIUS_M / length)
    return offset


def _circle_about(normal: FloatArray, points: FloatArray) -> FloatArray | None:
    """Centre of the algebraic circle (Kasa, 1976) through points projected along a normal."""
    frame = joint_frame(normal, points.mean(axis=0))
    local = (points - frame[:3, 3]) @ frame[:3, :3]
    A = np.column_stack([2 * local[:, :2], np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(A, (local[:, :2] ** 2).sum(axis=1))
    centre = _bounded(np.array([solution[0], solution[1], 0.0]))
    radius = np.sqrt(((local[:, :2] - centre[:2]) ** 2).sum(axis=1).mean())
    if rank < 3 or radius < _MIN_RADIUS_M:
        return None
    return frame[:3, 3] + frame[:3, :3] @ centre
