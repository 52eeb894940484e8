"""A cabinet rendered by rays on rectangles: images whose depth and motion are known exactly.

World: z up, floor at z = 0, the cabinet's front in the plane x = 0 facing +x, a wall behind.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from experiments.trials.openings import make_opening, score_opening

BACKGROUND, BODY, PART, ROBOT = 0, 1, 2, 3
BASELINE_M, DISPARITY_SD_PX, NOISE_BLUR_PX = 0.095, 0.08, 1.5


def texture(seed: int, contrast: float, base: tuple[int, int, int]) -> np.ndarray:
    """A wood-like image (512, 512, 3) of noise at several scales, 2 mm a texel."""
    rng = np.random.default_rng(seed)
    noise = np.zeros((512, 512))
    for sigma in (1.5, 4, 12):
        layer = cv2.GaussianBlur(rng.normal(size=noise.shape), (0, 0), sigma, 2 * sigma)
        noise += layer / layer.std()
    return np.clip(np.array(base) + contrast * noise[..., None] / 3**0.5, 0, 255).astype(np.float32)


@dataclass(frozen=True)
class Quad:
    """A rectangle in the x-y plane of its own frame, centred at the origin."""

    T_world_quad: gtsam.Pose3
    half: tuple[float, float]  # metres
    label: int
    texture: np.ndarray


def look_at(eye: np.ndarray, target: np.ndarray) -> gtsam.Pose3:
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])), eye)


def box(low: tuple, high: tuple, label: int, image: np.ndarray) -> list[Quad]:
    """The six faces of an axis-aligned box, each with another cut of the texture."""
    low_, high_ = np.array(low, float), np.array(high, float)
    centre, half = (low_ + high_) / 2, (high_ - low_) / 2
    quads = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        R = np.zeros((3, 3))
        R[a, 0] = R[b, 1] = R[axis, 2] = 1
        for side in (-1, 1):
            at = centre.copy()
            at[axis] += side * half[axis]
            cut = np.roll(image, 37 * (3 * side + axis), axis=(0, 1))
            quads.append(Quad(gtsam.Pose3(gtsam.Rot3(R), at), (half[a], half[b]), label, cut))
    return quads


@dataclass(frozen=True)
class Cabinet:
    """What stands in the scene; `joint` moves the front panel by q metres or radians."""

    joint: str = "revolute"
    contrast: float = 32.0
    wall: bool = True
    floor: bool = True
    eye: tuple[float, float, float] = (1.3, 0.35, 0.95)
    target: tuple[float, float, float] = (0.0, 0.0, 0.33)
    size: tuple[int, int] = (320, 240)
    focal_px: float = 340.0
    hinge: tuple[float, float, float] = field(default=(0.02, -0.28, 0.0))

    @property
    def camera(self) -> PinholeCamera:
        w, h = self.size
        return PinholeCamera(w, h, self.focal_px, self.focal_px, (w - 1) / 2, (h - 1) / 2)

    @property
    def T_world_cam(self) -> gtsam.Pose3:
        return look_at(np.array(self.eye), np.array(self.target))

    def motion(self, q: float) -> gtsam.Pose3:
        """Where the part's points of state 0 go."""
        if self.joint == "prismatic":
            return gtsam.Pose3(gtsam.Rot3(), np.array([q, 0, 0]))
        T = gtsam.Pose3(gtsam.Rot3(), np.array(self.hinge))
        return T * gtsam.Pose3(gtsam.Rot3.Rz(-q), np.zeros(3)) * T.inverse()

    @lru_cache(maxsize=4)  # noqa: B019  a handful of scenes a session
    def quads(self) -> tuple[tuple[Quad, ...], tuple[Quad, ...]]:
        """The resting quads and those of the part."""
        rest = box(
            (-0.45, -0.3, 0.0), (0.0, 0.3, 0.7), BODY, texture(1, self.contrast, (150, 110, 70))
        )
        if self.floor:
            rest += box((-0.5, -2, -0.1), (3, 2, 0.0), BACKGROUND, texture(2, 15, (120, 120, 115)))
        if self.wall:
            rest += box(
                (-0.6, -2, -0.1), (-0.5, 2, 2.5), BACKGROUND, texture(3, 6, (200, 200, 190))
            )
        wood = texture(4, self.contrast, (170, 130, 90))
        part = box((0.0, -0.28, 0.05), (0.02, 0.28, 0.65), PART, wood)
        part += box((0.02, 0.2, 0.28), (0.055, 0.22, 0.42), PART, texture(5, 10, (60, 60, 65)))
        if self.joint == "prismatic":
            part += box((-0.3, -0.25, 0.1), (0.0, 0.25, 0.4), PART, wood)
        return tuple(rest), tuple(part)

    def at(self, q: float, robot_y: float | None = None) -> list[Quad]:
        """All quads with the part at q, and a robot's forearm in front at robot_y."""
        rest, part = self.quads()
        T = self.motion(q)
        quads = list(rest) + [replace(p, T_world_quad=T * p.T_world_quad) for p in part]
        if robot_y is not None:
            dark = texture(6, 8, (40, 40, 45))
            quads += box((0.4, robot_y - 0.05, 0), (0.5, robot_y + 0.05, 1.2), ROBOT, dark)
        return quads


def render(
    camera: PinholeCamera, T_world_cam: gtsam.Pose3, quads: list[Quad]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise-free rgb (H, W, 3), depth (H, W) with inf for nothing, labels (H, W)."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = camera.back_project(np.stack([u, v], -1), np.ones_like(u))
    depth = np.full(u.shape, np.inf)
    rgb, labels = np.full((*u.shape, 3), 90.0, np.float32), np.full(u.shape, BACKGROUND)
    for quad in quads:
        T = quad.T_world_quad.inverse() * T_world_cam
        R, t = T.rotation().matrix(), T.translation()
        d = rays @ R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            z = -t[2] / d[..., 2]
        a, b = t[0] + z * d[..., 0], t[1] + z * d[..., 1]
        hit = (z > 0) & (z < depth) & (np.abs(a) <= quad.half[0]) & (np.abs(b) <= quad.half[1])
        if not hit.any():
            continue
        xy = np.where(hit, np.stack([a, b]), 0).astype(np.float32) / 0.002 + 256
        colours = cv2.remap(quad.texture, xy[0], xy[1], cv2.INTER_LINEAR, None, cv2.BORDER_WRAP)
        rgb[hit] = colours[hit]
        depth[hit], labels[hit] = z[hit], quad.label
    return rgb, depth, labels


@dataclass(frozen=True)
class Clip:
    """A rendered recording with what is true about it."""

    scene: Cabinet
    states: np.ndarray  # (T,)
    recording: Recording
    depth: np.ndarray  # (T, H, W) noise-free
    labels: np.ndarray  # (T, H, W)

    @property
    def frames(self) -> tuple[RgbdFrame, ...]:
        return self.recording.frames

    def true_points(self, uv: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (T, N, 3) of pixels (N, 2) in frames `starts`, and labels (N,)."""
        n, camera = len(uv), self.scene.camera
        points, labels = np.full((len(self.states), n, 3), np.nan), np.zeros(n, int)
        for i in range(n):
            s = int(starts[i])
            col, row = np.rint(uv[i]).astype(int)
            labels[i] = self.labels[s, row, col]
            one = PinholeCamera(
                1, 1, camera.fx, camera.fy, camera.cx - uv[i, 0], camera.cy - uv[i, 1]
            )
            _, z, _ = render(one, self.scene.T_world_cam, self.scene.at(self.states[s]))
            p = self.scene.T_world_cam.transformFrom(camera.back_project(uv[i], z[0, 0]))
            back = self.scene.motion(self.states[s]).inverse()
            for t, q in enumerate(self.states):
                T = self.scene.motion(q) * back if labels[i] == PART else gtsam.Pose3()
                points[t, i] = T.transformFrom(p)
        return points, labels

    def true_pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (T, N, 2) of world points, and whether each is seen (within 8 mm of depth)."""
        camera, T_cam = self.scene.camera, self.scene.T_world_cam.inverse()
        p_cam = points @ T_cam.rotation().matrix().T + T_cam.translation()
        uv = camera.project(p_cam)
        u = np.clip(np.rint(uv[..., 0]).astype(int), 0, camera.width - 1)
        v = np.clip(np.rint(uv[..., 1]).astype(int), 0, camera.height - 1)
        z = self.depth[np.arange(len(uv))[:, None], v, u]
        return uv, np.abs(z - p_cam[..., 2]) < 0.008


def depth_noise(rng: np.random.Generator, depth: np.ndarray, focal_px: float) -> np.ndarray:
    """Noise of a stereo camera: grows with depth squared, shared by neighbouring pixels."""
    white = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), NOISE_BLUR_PX)
    return white / white.std() * DISPARITY_SD_PX * depth**2 / (focal_px * BASELINE_M)


def photograph(
    camera: PinholeCamera, T_world_cam: gtsam.Pose3, quads: list[Quad], rng: np.random.Generator
) -> RgbdFrame:
    """One frame of quads that stand still, with a stereo camera's noise and lost edges."""
    rgb, depth, _ = render(camera, T_world_cam, quads)
    noisy = np.where(np.isfinite(depth), depth, np.nan)
    noisy = noisy + depth_noise(rng, np.nan_to_num(noisy, nan=1.0), camera.fx)
    edge = cv2.Laplacian(np.nan_to_num(depth, posinf=9).astype(np.float32), cv2.CV_32F)
    noisy[(np.abs(edge) > 0.05) & (rng.random(depth.shape) < 0.3)] = np.nan
    image = np.clip(rgb + rng.normal(scale=2.0, size=rgb.shape), 0, 255).astype(np.uint8)
    return RgbdFrame(0.0, image, noisy.astype(np.float32), camera, T_world_cam)


@dataclass(frozen=True)
class Chest:
    """A chest of drawers, its front in the plane x = 0.62 facing the robot at the origin."""

    rows: int = 3
    handles: bool = True
    contrast: float = 20.0
    bar_m: float = 0.012
    reach_m: float = 0.04  # from the fronts to the middle of the bars
    over_m: float = -0.003  # of the fronts beyond the carcass, on the camera's side
    step_m: float = 0.0  # of every other front, to the camera's side
    eye: tuple[float, float, float] = (-0.05, 0.45, 1.0)

    front_x = 0.62
    height_m = 0.72
    half_width_m = 0.26

    @property
    def bars(self) -> np.ndarray:
        """(rows, 3) middles of the bars, from below."""
        z = (np.arange(self.rows) + 0.6) * self.height_m / self.rows
        x = self.front_x - self.reach_m
        return np.column_stack([np.full(self.rows, x), np.zeros(self.rows), z])

    def quads(self) -> list[Quad]:
        w, x, t = self.half_width_m, self.front_x, self.bar_m / 2
        wood, metal = texture(4, self.contrast, (170, 130, 90)), texture(5, 10, (60, 60, 65))
        quads = box((x + 0.02, -w, 0.0), (x + 0.5, w, self.height_m), BODY, 0.6 * wood)
        quads += box((-2, -2, -0.1), (3, 2, 0.0), BACKGROUND, texture(2, 15, (120, 120, 115)))
        quads += box((1.3, -2, -0.1), (1.4, 2, 2.5), BACKGROUND, texture(3, 6, (200, 200, 190)))
        step = self.height_m / self.rows
        for i, (bx, _, bz) in enumerate(self.bars):
            low, high = i * step + 0.003, (i + 1) * step - 0.003
            left, right = -w + 0.003, w + self.over_m
            shift = self.step_m * (i % 2)
            board = box((x, left + shift, low), (x + 0.02, right + shift, high), PART, wood)
            in_shade = [replace(side, texture=0.5 * side.texture) for side in board[-2:]]
            quads += board[:-2] + in_shade  # below and above, between the fronts
            if self.handles:
                quads += box((bx - t, -0.07, bz - t), (bx + t, 0.07, bz + t), PART, metal)
                for y in (-0.06, 0.06):
                    quads += box((bx, y - 0.005, bz - t), (x, y + 0.005, bz + t), PART, metal)
        return quads

    @lru_cache(maxsize=8)  # noqa: B019  a handful of scenes a session
    def frame(self, seed: int = 0) -> RgbdFrame:
        camera = PinholeCamera(480, 440, 480.0, 480.0, 239.5, 219.5)
        T = look_at(np.array(self.eye), np.array([self.front_x, 0.0, 0.4 * self.height_m]))
        return photograph(camera, T, self.quads(), np.random.default_rng(seed))


@pytest.fixture(scope="session")
def make_chest():
    """The class of chests of drawers: make_chest(rows=2).frame(seed)."""
    return Chest


@lru_cache(maxsize=16)
def film(scene: Cabinet, last: float, n: int, robot: bool = False, seed: int = 0) -> Clip:
    """n frames in which the part goes from 0 to `last`; a robot's arm may pass in front."""
    rng = np.random.default_rng(seed)
    states = np.linspace(0, last, n)
    frames, depths, labels = [], [], []
    for i, q in enumerate(states):
        y = -0.5 + 1.0 * i / (n - 1) if robot else None
        rgb, depth, label = render(scene.camera, scene.T_world_cam, scene.at(q, y))
        noisy = np.where(np.isfinite(depth), depth, np.nan)
        noisy = noisy + depth_noise(rng, np.nan_to_num(noisy, nan=1.0), scene.focal_px)
        noisy[label == ROBOT] = np.nan
        edge = cv2.Laplacian(np.nan_to_num(depth, posinf=9).astype(np.float32), cv2.CV_32F)
        noisy[(np.abs(edge) > 0.05) & (rng.random(depth.shape) < 0.3)] = np.nan
        image = np.clip(rgb + rng.normal(scale=2.0, size=rgb.shape), 0, 255).astype(np.uint8)
        frames.append(
            RgbdFrame(0.1 * i, image, noisy.astype(np.float32), scene.camera, scene.T_world_cam)
        )
        depths.append(depth)
        labels.append(label)
    return Clip(scene, states, Recording("clip", tuple(frames)), np.array(depths), np.array(labels))


@pytest.fixture(params=["revolute", "prismatic"])
def kind(request):
    return request.param


@pytest.fixture(scope="session")
def opening():
    """Factory: opening(seed, kind, travel, ...)."""
    return make_opening


@pytest.fixture(scope="session")
def score():
    """score(posterior, opening)."""
    return score_opening


@pytest.fixture(scope="session")
def door() -> Clip:
    return film(Cabinet("revolute"), np.deg2rad(35), 15)


@pytest.fixture(scope="session")
def drawer() -> Clip:
    return film(Cabinet("prismatic"), 0.2, 15)


@pytest.fixture(scope="session")
def still() -> Clip:
    return film(Cabinet("revolute"), 0.0, 12)


@pytest.fixture(scope="session")
def fit_of():
    """The fit of a clip with all defaults, made once a session: fit_of(clip, sources)."""
    from akm_fg.pipeline import fit_recording  # half of the tests here need nothing of it

    made = {}

    def fit(clip: Clip, sources: str = "both"):
        key = id(clip), sources
        if key not in made:  # the clip is kept too, or another might come to have its id
            made[key] = clip, fit_recording(clip.recording, sources=sources)
        return made[key][1]

    return fit


@pytest.fixture(scope="session")
def door_behind_robot() -> Clip:
    return film(Cabinet("revolute"), np.deg2rad(30), 15, robot=True)


@pytest.fixture(scope="session")
def make_clip():
    """The function that films other scenes: make_clip(Cabinet fields, last, n)."""

    def make(last: float, n: int, robot: bool = False, seed: int = 0, **fields) -> Clip:
        return film(Cabinet(**fields), last, n, robot, seed)

    return make


@pytest.fixture(scope="session")
def depth_noise_image():
    """The renderer's depth noise: depth_noise_image(rng, depth, focal_px)."""
    return depth_noise


@pytest.fixture(scope="session")
def fitted_door(door):
    """The door's recording with its fit."""
    from akm_fg.model.build import FittedRecording
    from akm_fg.pipeline import fit_recording

    return FittedRecording.of(door.recording, fit_recording(door.recording))


@pytest.fixture(scope="session")
def door_model(fitted_door):
    from akm_fg.model.build import build_model

    return build_model(fitted_door)


@pytest.fixture(scope="session")
def drawer_model(drawer):
    from akm_fg.model.build import FittedRecording, build_model
    from akm_fg.pipeline import fit_recording

    return build_model(FittedRecording.of(drawer.recording, fit_recording(drawer.recording)))


@pytest.fixture(scope="session")
def walk() -> Recording:
    """A camera that goes round a cabinet that stands still."""
    frames = []
    for i, y in enumerate((-0.5, -0.2, 0.1, 0.4)):
        scene = Cabinet("revolute", eye=(1.3 - 0.1 * i, y, 0.9 + 0.05 * i))
        rgb, depth, _ = render(scene.camera, scene.T_world_cam, scene.at(0.0))
        image = np.clip(rgb, 0, 255).astype(np.uint8)
        known = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
        frames.append(RgbdFrame(0.1 * i, image, known, scene.camera, scene.T_world_cam))
    return Recording("walk", tuple(frames))


@pytest.fixture(scope="session")
def render_view():
    """Noise-free depth (H, W) of the closed door's cabinet: render_view(camera, T_world_cam)."""

    def view(camera: PinholeCamera, T_world_cam: gtsam.Pose3) -> np.ndarray:
        return render(camera, T_world_cam, Cabinet("revolute").at(0.0))[1]

    return view


ASIDE = np.array([0.0, 0.7, 0.0])  # from the cabinet with the door to the one with the drawer


@pytest.fixture(scope="session")
def drawer_aside(drawer_model):
    """The drawer's model, of a cabinet that stands beside the door's."""
    from akm_fg.model.records import Surface

    def moved(surface: Surface) -> Surface:
        return replace(surface, p_world=surface.p_world + ASIDE)

    (part,) = drawer_model.parts
    best = part.posterior.best
    T = np.array(part.joint.T_world_joint)
    T[:3, 3] += ASIDE
    joint = replace(best.joint, joint=replace(best.joint.joint, T_world_joint=T))
    alternatives = {str(part.joint.kind): replace(best, joint=joint)}
    posterior = replace(part.posterior, alternatives=alternatives)
    part = replace(part, posterior=posterior, surface=moved(part.surface))
    return replace(
        drawer_model, parts=(part,), static=moved(drawer_model.static), sources=("aside",)
    )


@pytest.fixture(scope="session")
def two_part_model(door_model, drawer_aside):
    """A door, part-0, and a drawer beside it, part-1."""
    from akm_fg.model.merge import with_found

    return with_found(door_model, drawer_aside, [0.0])
