"""Scenes for the factors' tests: parts whose joint, states and points are known exactly."""

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest

from factors.joint import Joint
from factors.measurements.track_cost import TrackObservations

# Where derivatives are checked: states and rotation of the joint frame.
STATES = {
    "zero": np.zeros(4),
    "near zero": np.array([0.0, 1e-9, -1e-7, 1e-5]),
    "generic": np.array([0.0, 0.3, -0.8, 1.7]),
    "pi": np.array([0.0, np.pi, -np.pi, np.pi / 2]),
}
FRAME_TURNS = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-9, -2e-7, 1e-6]),
    "generic": np.array([0.4, -0.9, 0.6]),
    "pi": np.pi * np.array([0.6, 0.0, 0.8]),
}
PITCH_M_PER_RAD = {"revolute": 0.0, "prismatic": 0.0, "helical": 0.07}


@dataclass(frozen=True)
class Scene:
    """A part seen in T frames."""

    kind: str
    T_world_joint: np.ndarray  # (4, 4)
    q: np.ndarray  # (T,)
    x_joint: np.ndarray  # (N, 3)
    p_world: np.ndarray  # (T, N, 3)
    cov_world: np.ndarray  # (T, N, 3, 3)

    @property
    def joint(self) -> Joint:
        return Joint(self.kind, self.T_world_joint, self.pitch)

    @property
    def pitch(self) -> float:
        """Metres per radian; 0 of a joint that is not helical."""
        return PITCH_M_PER_RAD[self.kind]

    @property
    def tracks(self) -> TrackObservations:
        return TrackObservations.from_points(self.p_world, self.cov_world)


def place(
    kind: str,
    T_world_joint: np.ndarray,
    q: float,
    x_joint: np.ndarray,
    pitch: float | None = None,
) -> np.ndarray:
    """World points (N, 3) of joint-frame points at state q, by GTSAM's own group operations.

    `pitch` (metres per radian) is that of the kind's scenes where none is given.
    """
    S = Joint(kind, np.eye(4), PITCH_M_PER_RAD[kind] if pitch is None else pitch).unit_twist
    T = gtsam.Pose3(T_world_joint).compose(gtsam.Pose3.Expmap(q * S))
    return np.array([T.transformFrom(x) for x in x_joint])


def _build(
    kind: str = "revolute",
    case: str = "generic",
    sigma: float = 0.003,
    points: int = 6,
    isotropic: bool = False,
    q: np.ndarray | None = None,
    seed: int = 0,
) -> Scene:
    """Noise of `sigma` metres; 0 leaves the points exact (their covariances stay at 3 mm)."""
    rng = np.random.default_rng(seed)
    states = STATES[case] if q is None else q
    turn = gtsam.Rot3.Expmap(FRAME_TURNS[case])
    T_world_joint = gtsam.Pose3(turn, np.array([0.2, -0.5, 0.9])).matrix()
    x_joint = rng.uniform([0.0, -0.3, -0.3], [0.6, 0.3, 0.3], (points, 3))
    p = np.array([place(kind, T_world_joint, s, x_joint) for s in states])
    shape = (*p.shape[:2], 3, 3)
    root = np.eye(3) + (0 if isotropic else 0.2) * rng.normal(size=shape)
    unit = root @ root.swapaxes(-1, -2)
    p = p + sigma * np.einsum("tnij,tnj->tni", np.linalg.cholesky(unit), rng.normal(size=p.shape))
    return Scene(kind, T_world_joint, states, x_joint, p, unit * (sigma or 0.003) ** 2)


@pytest.fixture
def scene():
    """Factory of scenes: scene(kind=..., case=..., ...)."""
    return _build


def _chained(s: Scene, q: np.ndarray) -> np.ndarray:
    by_xi, by_state, by_pitch = s.joint.motion_jacobians(q)
    J = np.zeros((q.size, 6, 6 + q.size + s.joint.kind.has_pitch))
    J[:, :, :6] = by_xi
    for t in range(q.size):
        J[t, :, 6 + t] = by_state[t]
    if s.joint.kind.has_pitch:
        J[:, :, -1] = by_pitch
    return J.reshape(6 * q.size, -1)


@pytest.fixture
def chained():
    """chained(scene, q): derivative (6 T, d) of the part's motions by the joint's numbers."""
    return _chained


@pytest.fixture
def world_points():
    """place(kind, T_world_joint, q, x_joint[, pitch])."""
    return place


@pytest.fixture(params=["revolute", "prismatic", "helical"])
def kind(request):
    return request.param


@pytest.fixture(params=list(STATES))
def case(request):
    return request.param
