"""Dense masks of the moving part, against rendered truth."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest

from akm_fg.geometry.rigid_motion import RigidMotion
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation
from akm_fg.perception.moving_part.part_mask import propagate_masks
from akm_fg.perception.observe import observe_motion
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import PinholeCamera, PixelTracks, PointTracks, Recording, RgbdFrame

BODY, PART, ROBOT = 1, 2, 3
NOISE = DepthNoiseModel()


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union."""
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture(scope="module")
def observed_clips(door, drawer) -> dict:
    return {
        name: (clip, observe_motion(clip.recording))
        for name, clip in (("door", door), ("drawer", drawer))
    }


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_masks_of_the_part_overlap_the_truth(name: str, observed_clips) -> None:
    clip, observed = observed_clips[name]
    frames = [0, 3, 7, 14]
    for mask in propagate_masks(clip.recording, observed, frames, NOISE):
        label, seen = clip.labels[mask.frame], np.isfinite(clip.frames[mask.frame].depth_m)
        part, rest = (label == PART) & seen, (label != PART) & seen
        assert overlap(mask.moving, part) > 0.9, mask.frame
        assert (part & mask.moving).sum() > 0.98 * mask.moving.sum(), mask.frame
        assert (rest & mask.static).sum() > 0.99 * mask.static.sum(), mask.frame
        assert (mask.static & (label == BODY)).sum() > 0.5 * (seen & (label == BODY)).sum()
        assert not (mask.moving & mask.static).any()


def test_a_frame_in_which_the_part_is_not_tracked_gets_empty_masks(observed_clips) -> None:
    clip, observed = observed_clips["door"]
    p, cov = observed.tracks.p_world.copy(), observed.tracks.cov_world.copy()
    p[4], cov[4] = np.nan, np.nan
    blind = replace(observed, tracks=PointTracks(p, cov))
    four, five = propagate_masks(clip.recording, blind, [4, 5], NOISE)
    assert not four.moving.any() and not four.static.any()
    assert five.moving.any()


def test_a_better_motion_can_be_given(observed_clips) -> None:
    """From the true joint, with a handful of tracks left as prior."""
    clip, observed = observed_clips["door"]
    poses = [clip.scene.motion(q) for q in clip.states]
    shape = observed.moving_tracks.p_world[0]
    motion = RigidMotion(
        R_world=np.array([T.rotation().matrix() for T in poses]),
        t_world=np.array([T.translation() for T in poses]),
        shape_world=shape[np.isfinite(shape).all(axis=1)],
        known=np.ones(len(poses), bool),
        inlier=np.ones(np.isfinite(shape).all(axis=1).sum(), bool),
        scale=1.0,
    )
    keep = np.flatnonzero(observed.segmentation.moving)[::40]
    moving = np.zeros_like(observed.segmentation.moving)
    moving[keep] = True
    few = replace(observed, segmentation=replace(observed.segmentation, moving=moving))
    (mask,) = propagate_masks(clip.recording, few, [7], NOISE, motion=motion)
    assert (
        overlap(mask.moving, (clip.labels[7] == PART) & np.isfinite(clip.frames[7].depth_m)) > 0.9
    )


def test_unknown_frames_and_missing_tracks_are_refused(observed_clips) -> None:
    clip, observed = observed_clips["door"]
    with pytest.raises(ValueError, match=r"expected some of 0\.\.14"):
        propagate_masks(clip.recording, observed, [0, 15], NOISE)
    none = np.zeros_like(observed.segmentation.moving)
    nothing = replace(observed, segmentation=replace(observed.segmentation, moving=none))
    with pytest.raises(ValueError, match="0 moving tracks"):
        propagate_masks(clip.recording, nothing, [0], NOISE)


@dataclass(frozen=True)
class Strip:
    """A wall seen face on, of which the right half slides to the right within its own plane."""

    textured: bool
    size: tuple[int, int] = (160, 120)

    def filmed(self) -> tuple[Recording, np.ndarray]:
        """Six frames 1 cm (3 pixels) apart, and where the sliding half starts in each."""
        w, h = self.size
        camera = PinholeCamera(w, h, 300.0, 300.0, (w - 1) / 2, (h - 1) / 2)
        rng = np.random.default_rng(0)
        rest, slide = (
            np.kron(rng.integers(60, 200, (h // 4, w // 2)), np.ones((4, 4))) for _ in range(2)
        )
        edges = 80 + 3 * np.arange(6)
        frames = []
        for edge in edges:
            gray = rest[:, :w].copy()
            gray[:, edge:] = slide[:, : w - edge]
            if not self.textured:
                gray[:] = 128
            gray = gray + rng.normal(scale=2.0, size=gray.shape)
            depth = 1.0 + 0.001 * rng.standard_normal((h, w))
            rgb = np.repeat(np.clip(gray, 0, 255)[..., None], 3, axis=2).astype(np.uint8)
            frames.append(RgbdFrame(0.0, rgb, depth.astype(np.float32), camera, gtsam.Pose3()))
        return Recording("strip", tuple(frames)), edges

    def observed(self, recording: Recording, edges: np.ndarray) -> ObservedMotion:
        """A few tracks at the far ends of either half: the prior reaches no farther."""
        camera = recording.frames[0].camera
        v = np.linspace(10, 110, 6)
        uv = np.empty((6, 12, 2))
        for t, edge in enumerate(edges):
            uv[t, :6] = np.stack([np.full(6, 8.0), v], axis=-1)
            uv[t, 6:] = np.stack([np.full(6, edge + 40.0), v], axis=-1)
        p = camera.back_project(uv, np.ones(uv.shape[:2]))
        cov = np.broadcast_to(1e-6 * np.eye(3), (*p.shape, 3)).copy()
        moving = np.arange(12) >= 6
        segmentation = MotionSegmentation(moving, ~moving, np.zeros(12, bool), 0.0, 0.02, 1.0)
        pixels = PixelTracks(uv, np.ones((6, 12), bool), np.full((6, 12, 1, 1), 0.01) * np.eye(2))
        mask = np.ones(recording.frames[0].depth_m.shape, bool)
        return ObservedMotion(PointTracks(p, cov), pixels, segmentation, mask)


def test_a_textured_panel_that_slides_in_its_plane_is_told_by_its_texture() -> None:
    strip = Strip(textured=True)
    recording, edges = strip.filmed()
    (mask,) = propagate_masks(recording, strip.observed(recording, edges), [3], NOISE)
    slides = np.arange(160)[None] >= edges[3]
    assert mask.moving[:, edges[3] + 3 :].mean() > 0.9
    assert mask.static[:, : edges[3] - 3].mean() > 0.9
    assert (mask.moving & ~slides).sum() < 0.02 * mask.moving.sum()
    assert (mask.static & slides).sum() < 0.02 * mask.static.sum()


def test_a_plain_panel_that_slides_in_its_plane_is_known_only_near_tracks() -> None:
    strip = Strip(textured=False)
    recording, edges = strip.filmed()
    (mask,) = propagate_masks(recording, strip.observed(recording, edges), [3], NOISE)
    track = edges[3] + 40
    assert mask.moving[10:110, track - 2 : track + 3].mean() > 0.9
    assert mask.static[10:110, 6:11].mean() > 0.9
    assert not mask.moving[:, : edges[3]].any()
    between = slice(30, edges[3] + 15)
    assert not mask.moving[:, between].any() and not mask.static[:, between].any()


@dataclass(frozen=True)
class SimClip:
    """A recording of the simulator with the true mask of the part in every frame."""

    recording: Recording
    part: np.ndarray  # (T, H, W)


def film_in_simulator(name: str, last: float, n: int) -> SimClip:
    """The part is set to its states directly; the robot stands still."""
    from sim.bullet import p
    from sim.camera.camera import CameraConfig
    from sim.episode import open_world

    frames, part = [], []
    with open_world(name, seed=2, camera_config=CameraConfig().scaled(0.5)) as episode:
        world = episode.world
        for q in np.linspace(0.0, last, n):
            where = {"physicsClientId": world.client}
            p.resetJointState(world.object_id, world.part_joint, q, **where)
            frames.append(episode.camera.capture())
            seen = episode.camera.exact()[1]
            # Where the exact depth changes when the part is taken away, the part is seen.
            p.resetJointState(world.object_id, world.part_joint, 100.0, **where)
            without = episode.camera.exact()[1]
            part.append(np.nan_to_num(without, nan=50.0) - seen > 1e-4)
    return SimClip(Recording(name, tuple(frames)), np.array(part))


@pytest.fixture(scope="module")
def simulated_drawer() -> Iterator[SimClip]:
    pytest.importorskip("pybullet")
    yield film_in_simulator("drawer", 0.2, 8)


def test_masks_of_a_simulated_drawer_overlap_the_truth(simulated_drawer: SimClip) -> None:
    clip = simulated_drawer
    observed = observe_motion(clip.recording)
    for mask in propagate_masks(clip.recording, observed, [0, 4, 7], NOISE):
        frame = clip.recording.frames[mask.frame]
        truth = clip.part[mask.frame] & np.isfinite(frame.depth_m)
        # The drawer's inside slides within its planes where few tracks are: part of it stays open.
        assert overlap(mask.moving, truth) > 0.7, mask.frame
        assert (mask.moving & truth).sum() > 0.99 * mask.moving.sum(), mask.frame
        assert (mask.static & truth).sum() < 0.03 * mask.static.sum(), mask.frame
