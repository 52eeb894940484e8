import numpy as np
import pytest

HINGE = np.array([-0.2, 0.0, 0.0])  # upright, along the front's left edge


def _box(rng, points):
    """A drawer front 0.4 x 0.4 m (normal y) with a handle, the tops of two sides behind it."""
    part = rng.choice(3, points, p=[0.6, 0.2, 0.2])
    front, handle, sides = ((part == k).nonzero()[0] for k in range(3))
    p = np.zeros((points, 3))
    p[front[:, None], [0, 2]] = rng.uniform(-0.2, 0.2, (front.size, 2))
    size = np.array([0.02, 0.03, 0.12])
    on_face = rng.uniform(-0.5, 0.5, (handle.size, 3)) * size
    face = rng.integers(0, 3, handle.size)
    on_face[np.arange(handle.size), face] = rng.choice([-0.5, 0.5], handle.size) * size[face]
    p[handle] = on_face + np.array([0.15, 0.03, 0.0])
    p[sides] = rng.uniform([0, -0.3, -0.2], [0, 0.0, 0.2], (sides.size, 3))
    p[sides, 0] = rng.choice([-0.2, 0.2], sides.size)
    return p


def _moved(kind, q, p):
    if kind == "prismatic":
        return p + np.array([0.0, q, 0.0])
    c, s = np.cos(q), np.sin(q)
    return (p - HINGE) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T + HINGE


@pytest.fixture
def seen_part():
    """seen_part(kind, q, seed, points): a noisy cloud (N, 3) of the part at state q."""

    def cloud(kind, q, seed, points=1500, noise_m=0.0005):
        rng = np.random.default_rng(seed)
        return _moved(kind, q, _box(rng, points)) + noise_m * rng.normal(size=(points, 3))

    return cloud


@pytest.fixture
def true_axis():
    return {"revolute": np.array([0.0, 0.0, 1.0]), "prismatic": np.array([0.0, 1.0, 0.0])}


@pytest.fixture
def true_pivot():
    return HINGE


@pytest.fixture
def angle_deg():
    return lambda a, b: float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
