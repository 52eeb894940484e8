"""A cabinet front with a door or a drawer, drawn by warping a texture, and hand-made posteriors."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.records import JointTruth, PinholeCamera, PixelTracks, Recording, RgbdFrame
from akm_fg.report.summary import Goal, PartTracks, RoundSummary, RunSummary
from factors.joint import Joint

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
HINGE = np.array([0.0, -0.2, 0.0])  # the front is the plane x = 0, seen from x < 0; z is up
HALF = 0.2  # of the square panel, metres
N_FRAMES = 12
TURN = 8  # first frame of the closed loop


def look_at(eye, target) -> gtsam.Pose3:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    return gtsam.Pose3(gtsam.Rot3(R), eye)


T_WORLD_CAM = look_at(np.array([-1.1, 0.45, 0.45]), np.zeros(3))


def move(kind: str, p: np.ndarray, q: float) -> np.ndarray:
    """Points (N, 3) of the closed part at state q."""
    if kind == "prismatic":
        return p - np.array([q, 0, 0])
    if kind == "rigid":
        return p
    return (p - HINGE) @ gtsam.Rot3.Rz(q).matrix().T + HINGE


def project(p_world: np.ndarray) -> np.ndarray:
    p_cam = (p_world - T_WORLD_CAM.translation()) @ T_WORLD_CAM.rotation().matrix()
    return CAMERA.project(p_cam)


def _paste(image, corners_world, texture) -> None:
    h, w = texture.shape[:2]
    source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    H = cv2.getPerspectiveTransform(source, project(corners_world).astype(np.float32))
    warped = cv2.warpPerspective(texture, H, (CAMERA.width, CAMERA.height))
    mask = cv2.warpPerspective(np.full((h, w), 255, np.uint8), H, (CAMERA.width, CAMERA.height))
    image[mask > 127] = warped[mask > 127]


def _square(half: float) -> np.ndarray:
    return half * np.array([[0, 1, 1], [0, -1, 1], [0, -1, -1], [0, 1, -1.0]])


def make_recording(kind: str, states: np.ndarray) -> Recording:
    return _recording(kind, tuple(states))


@cache
def _recording(kind: str, states: tuple[float, ...]) -> Recording:
    rng = np.random.default_rng(0)
    wood = rng.integers(70, 130, (16, 16, 3), dtype=np.uint8)
    panel = rng.integers(150, 235, (12, 12, 3), dtype=np.uint8)
    wood, panel = (cv2.resize(t, (200, 200), interpolation=cv2.INTER_CUBIC) for t in (wood, panel))
    depth = np.full((CAMERA.height, CAMERA.width), 1.2, np.float32)
    frames = []
    for t, q in enumerate(states):
        rgb = np.full((CAMERA.height, CAMERA.width, 3), (196, 202, 208), np.uint8)
        _paste(rgb, _square(0.3), wood)
        _paste(rgb, move(kind, _square(HALF), q), panel)
        frames.append(RgbdFrame(0.5 * t, rgb, depth, CAMERA, T_WORLD_CAM))
    return Recording("synthetic/cabinet", tuple(frames))


def make_tracks(kind: str, states: np.ndarray) -> PartTracks:
    rng = np.random.default_rng(1)
    part = np.column_stack([np.zeros(40), rng.uniform(-0.18, 0.18, (40, 2))])
    ring = rng.uniform(0.21, 0.29, (20, 1)) * np.sign(rng.normal(size=(20, 1)))
    rest = np.column_stack([np.zeros(20), ring, rng.uniform(-0.28, 0.28, (20, 1))])
    uv = np.stack([project(np.concatenate([move(kind, part, q), rest])) for q in states])
    uv += rng.normal(scale=0.2, size=uv.shape)
    visible = np.ones(uv.shape[:2], bool)
    visible[5:, 3] = False
    uv[~visible] = np.nan
    cov_px2 = np.where(visible, 0.09, np.nan)[..., None, None] * np.eye(2)
    index = np.arange(60)
    rejected = index % 13 == 0
    moving, static = (index < 40) & ~rejected, (index >= 40) & ~rejected
    return PartTracks(PixelTracks(uv, visible, cov_px2), moving, static)


def joint_posterior(kind: str, axis_sd: float = 0.01, pivot_sd: float = 0.004) -> JointPosterior:
    T = np.eye(4)
    if kind == "prismatic":  # z of the joint along -x of the world
        T[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
        cov = np.diag([axis_sd**2, axis_sd**2, 0, 0, 0, 0])
        return JointPosterior(Joint("prismatic", T, 0.0), cov)
    T[:3, :3] = gtsam.Rot3.Rx(0.01).matrix()
    T[:3, 3] = HINGE + np.array([0.003, -0.002, 0])
    cov = np.diag([axis_sd**2, axis_sd**2, 0, pivot_sd**2, pivot_sd**2, 0])
    return JointPosterior(Joint("revolute", T, 0.0), cov)


def _unit(kind: str) -> str:
    return "m" if kind == "prismatic" else "rad"


def make_states(kind: str) -> np.ndarray:
    return np.linspace(0, 0.24 if kind == "prismatic" else 0.9, N_FRAMES)


def state_posterior(kind: str) -> StatePosterior:
    true, rng = make_states(kind), np.random.default_rng(2)
    sd = np.full(N_FRAMES, 0.001 if kind == "prismatic" else 0.004)
    sd[0] = 0
    mean = true + sd * rng.normal(size=N_FRAMES)
    mean[6] = np.nan
    return StatePosterior(_unit(kind), mean, sd)


def make_posterior(kind: str, named: str | None = None, **fit) -> ArticulationPosterior:
    """`kind` is the most probable; `named` the answer if it differs ("undecided")."""
    p = {"rigid": 1e-40, "prismatic": 2e-7, "revolute": 2e-7}
    if named == "undecided":
        p = {"rigid": 0.0, "prismatic": 0.3, "revolute": 0.3}
    p[kind] = 0.0
    p[kind] = 1 - sum(p.values())
    alternatives = {"rigid": KindPosterior(None, None, Evidence(-1e4, 0.0, 0.0, 0.0))}
    for k in ("prismatic", "revolute"):
        alternatives[k] = KindPosterior(
            joint_posterior(k), state_posterior(k), Evidence(-10.0, 0.0, 0.0, 0.0)
        )
    report = dict.fromkeys((f.name for f in fields(FitReport)), 1.0)
    report |= {"tracks_used": 38, "tracks_rejected": 4, "rms_m": 0.0021}
    report |= {"keyframes_registered": (), "patches_used": 0, "patches_rms_m": None}
    report |= {"parametric": True, "warnings": (), **fit}
    return ArticulationPosterior(
        "synthetic/cabinet", named or kind, p, alternatives, FitReport(**report), {"total": 0.1}
    )


def make_truth(kind: str) -> JointTruth:
    axis = np.array([-1.0, 0, 0]) if kind == "prismatic" else np.array([0, 0, 1.0])
    return JointTruth(kind, axis, HINGE if kind == "revolute" else None, make_states(kind) + 0.1)


def make_summary(kind: str = "revolute", **changes) -> RunSummary:
    """A run that went well; `changes` replace fields."""
    states = make_states(kind)
    target = float(states[-1]) + (0.002 if kind == "prismatic" else 0.01)
    tolerance = 0.01 if kind == "prismatic" else np.radians(3)
    sd = 0.001 if kind == "prismatic" else 0.004
    fields = {
        "title": "furniture-dev/cabinet-003",
        "command": "akm-fg demo --seed 3",
        "seed": 3,
        "version": "0.1.0",
        "recording": make_recording(kind, states),
        "tracks": make_tracks(kind, states),
        "posterior": make_posterior(kind),
        "truth": make_truth(kind),
        "goal": Goal(target, tolerance, _unit(kind)),
        "rounds": (
            RoundSummary(target, 0.8 * target, 3 * sd, 1e-9),
            RoundSummary(target, target + sd, sd, 0.9991),
        ),
        "final_state_true": float(states[-1]),
        "closed_loop_frame": TURN,
        "time_s": {"explore": 12.3, "observe": 1.4, "fit": 0.012, "closed loop": 20.0},
    }
    return RunSummary(**(fields | changes))


class Scenes:
    """The makers above, for tests (pytest's importlib mode forbids importing a conftest)."""

    summary = staticmethod(make_summary)
    posterior = staticmethod(make_posterior)
    joint = staticmethod(joint_posterior)
    truth = staticmethod(make_truth)
    recording = staticmethod(make_recording)
    tracks = staticmethod(make_tracks)
    states = staticmethod(make_states)
    project = staticmethod(project)
    camera = CAMERA
    T_world_cam = T_WORLD_CAM
    hinge = HINGE


@pytest.fixture(scope="session")
def scenes() -> type[Scenes]:
    return Scenes
