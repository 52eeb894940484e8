"""Antipodal grasps about a contact: what sticks out between the fingers, or a board's free edge."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import gtsam
import numpy as np

from akm_fg.arm.body.description import ArmDescription
from akm_fg.arm.body.hand import HandCollisions
from akm_fg.grasping.board_edge import EdgeConfig, edge_poses
from akm_fg.grasping.closing import Closing, ClosingConfig, FingerShape, closing
from akm_fg.grasping.local_cloud import LocalCloud, local_cloud
from akm_fg.grasping.quality import GraspEvidence, QualityWeights, holds
from akm_fg.interfaces import GraspCandidate
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class AntipodalConfig:
    """What is sampled, and what is kept."""

    fingers: FingerShape = field(default_factory=FingerShape)
    closing: ClosingConfig = field(default_factory=ClosingConfig)
    edges: EdgeConfig = field(default_factory=EdgeConfig)
    weights: QualityWeights = field(default_factory=QualityWeights)
    turns: int = 12  # of the fingers' opening about the approach, over half a turn
    along_m: tuple[float, ...] = (0.0, -0.008, 0.008)  # from the contact, along the gripper's x
    # Of the approach, about the gripper's x (round a bar) and y (along it: both pads stay on it,
    # and low handles near the robot's base are reached from above alone).
    tilts_rad: tuple[tuple[float, float], ...] = (
        (0.0, 0.0),
        (0.35, 0.0),
        (-0.35, 0.0),
        (0.0, 0.35),
        (0.0, -0.35),
        (0.0, 0.7),
        (0.0, -0.7),
        (0.0, 1.05),
        (0.0, -1.05),
    )
    best: int = 16  # of the turns and places are tilted
    deep: float = 0.5  # of its width, a thing is taken behind its outer side
    depth_m: tuple[float, float] = (0.005, 0.012)  # at least and at most
    around_m: float = 0.16  # half side of the cube that hand and fingers keep clear of
    shape_m: float = 0.06  # radius about the contact in which things are closed on
    voxel_m: float = 0.005
    voxel_points: int = 2
    slack_m: float = 0.01  # behind what is seen, a place is hidden
    same_m: float = 0.012  # grasps nearer than this and
    same_rad: float = 0.3  # turned by less are one
    most: int = 30


@dataclass(frozen=True, slots=True)
class ScoredGrasp:
    """A grasp with what speaks for and against it."""

    T: FloatArray  # (4, 4)
    quality: float
    width_m: float
    evidence: GraspEvidence


class AntipodalSampler:
    """A `GraspSampler` for the Franka hand that needs no weights."""

    def __init__(
        self, config: AntipodalConfig | None = None, description: ArmDescription | None = None
    ) -> None:
        """Tuning, and the hand; without a description, that of the installed PyBullet's data."""
        self.config = config or AntipodalConfig()
        self._description = description

    def sample(
        self,
        frame: RgbdFrame,
        mask: BoolArray,
        p_world_contact: FloatArray,
        normal_world: FloatArray,
        *,
        at_edge: bool = False,
    ) -> tuple[GraspCandidate, ...]:
        """See `akm_fg.interfaces.GraspSampler`."""
        return tuple(
            GraspCandidate(gtsam.Pose3(found.T), found.quality, found.width_m)
            for found in self.scored(frame, mask, p_world_contact, normal_world, at_edge=at_edge)
        )

    def scored(
        self,
        frame: RgbdFrame,
        mask: BoolArray,
        p_world_contact: FloatArray,
        normal_world: FloatArray,
        *,
        at_edge: bool = False,
    ) -> list[ScoredGrasp]:
        """The same with what speaks for each."""
        c = self.config
        normal = _unit(normal_world)
        cloud = local_cloud(frame, mask, p_world_contact, c.around_m)
        hand = HandCollisions(cloud.voxels(c.voxel_m, c.voxel_points), c.voxel_m, self._description)
        # A board that seems to end in an arm's shadow, or at the next one, looks like a bar.
        ways = [self._edges, self._around] if at_edge else [self._around, self._edges]
        for way in ways:
            kept = self._clear(way(cloud, p_world_contact, normal), hand)
            if kept:
                return kept
        return []

    def _clear(self, found: Iterable[ScoredGrasp], hand: HandCollisions) -> list[ScoredGrasp]:
        """The best in which the open hand touches nothing that is seen, no two alike."""
        kept: list[ScoredGrasp] = []
        for scored in sorted(found, key=lambda one: -one.quality):
            if len(kept) == self.config.most:
                break
            if not self._known(scored, kept) and hand.free(scored.T):
                kept.append(scored)
        return kept

    def _around(
        self, cloud: LocalCloud, p_world: FloatArray, normal: FloatArray
    ) -> Iterator[ScoredGrasp]:
        """Grasps of what sticks out at the contact, both ways up."""
        c = self.config
        points = cloud.near(p_world, c.shape_m)
        flat: list[tuple[float, FloatArray, Closing]] = []
        for angle in np.arange(c.turns) * np.pi / c.turns:
            for along in c.along_m:
                T = _approach(p_world, normal, float(angle))
                T[:3, 3] += along * T[:3, 0]
                between = _closing(points, T, cloud.pixel_m, c)
                if between is not None:
                    flat.append((self._score(T, between, 0.0, cloud).quality, T, between))
        flat.sort(key=lambda one: -one[0])
        for _, T, between in flat[: c.best]:
            depth = float(np.clip(c.deep * between.width_m, *c.depth_m))
            held = T.copy()
            held[:3, 3] = T[:3, :3] @ [0.0, between.y_m, between.z_m + depth] + T[:3, 3]
            for about_x, about_y in c.tilts_rad:
                for turn in (0.0, np.pi):
                    tilted = held.copy()
                    tilted[:3, :3] = held[:3, :3] @ _about(0, about_x) @ _about(1, about_y)
                    tilted[:3, :3] = tilted[:3, :3] @ _about(2, turn)
                    yield self._score(tilted, between, abs(about_x) + abs(about_y), cloud)

    def _edges(
        self, cloud: LocalCloud, p_world: FloatArray, normal: FloatArray
    ) -> Iterator[ScoredGrasp]:
        """Grasps of a board's free edge near the contact, both ways up."""
        c = self.config
        points = cloud.near(p_world, c.shape_m)
        for T, tilt in edge_poses(points, p_world, normal, cloud.pixel_m, c.edges):
            for turn in (0.0, np.pi):
                turned = T.copy()
                turned[:3, :3] = T[:3, :3] @ _about(2, turn)
                yield self._score(turned, None, tilt, cloud)

    def _score(
        self, T: FloatArray, between: Closing | None, tilt: float, cloud: LocalCloud
    ) -> ScoredGrasp:
        c = self.config
        width = between.width_m if between else c.edges.board_m
        places = _finger_places(c.fingers) @ T[:3, :3].T + T[:3, 3]
        hidden = float(cloud.hidden(places, c.slack_m).mean())
        evidence = GraspEvidence(between, tilt, hidden, width / max(cloud.pixel_m, 1e-6))
        return ScoredGrasp(T, holds(evidence, c.weights), width, evidence)

    def _known(self, one: ScoredGrasp, kept: list[ScoredGrasp]) -> bool:
        """Whether there is a grasp like it already."""
        c = self.config
        for other in kept:
            off = np.linalg.norm(one.T[:3, 3] - other.T[:3, 3])
            turn = np.trace(one.T[:3, :3].T @ other.T[:3, :3])
            if off < c.same_m and np.arccos(np.clip((turn - 1) / 2, -1, 1)) < c.same_rad:
                return True
        return False


def _approach(p_world: FloatArray, normal: FloatArray, angle: float) -> FloatArray:
    """(4, 4) at a point, z against the normal, y turned about it."""
    aside = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(aside) < 0.1:
        aside = np.cross([1.0, 0.0, 0.0], normal)
    x = _unit(aside)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(-normal, x), -normal]) @ _about(2, angle)
    T[:3, 3] = p_world
    return T


def _closing(
    points: FloatArray, T: FloatArray, pixel_m: float, config: AntipodalConfig
) -> Closing | None:
    p_gripper = (points - T[:3, 3]) @ T[:3, :3]
    return closing(p_gripper, pixel_m, config.fingers, config.closing)


def _finger_places(fingers: FingerShape) -> FloatArray:
    """(M, 3) where the open fingers' inner sides are, in the gripper's frame."""
    x, y, z = np.meshgrid(
        [-fingers.pad_half_m, 0.0, fingers.pad_half_m],
        [-0.75 * fingers.open_half_m, 0.75 * fingers.open_half_m],
        [-fingers.tip_m, 0.0, fingers.tip_m],
    )
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def _about(axis: int, angle: float) -> FloatArray:
    """(3, 3) a turn about x (0), y (1) or z (2)."""
    turn = (gtsam.Rot3.Rx, gtsam.Rot3.Ry, gtsam.Rot3.Rz)[axis]
    return np.asarray(turn(float(angle)).matrix())


def _unit(v: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(v))
    if not np.isfinite(length) or length < 1e-9:
        raise ValueError(f"normal {v}, expected a direction")
    return np.asarray(v / length)
