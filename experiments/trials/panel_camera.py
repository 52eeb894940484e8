"""What a depth camera sees of the panel of an opening: surfaces for synthetic trials.

The panel of `experiments.trials.openings`, 2 cm thick, with a bar handle, seen from the front at an
angle. Rays against the boxes' faces give exact depth; noise is that of a stereo camera: disparity
errors shared by neighbouring pixels. Fits
`akm_fg.estimation.given.surface_registration.SurfaceSource`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import gtsam
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import depth_planes
from akm_fg.perception.surface.patches import PatchViews, patch_views
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame
from akm_fg.steps import Steps
from experiments.trials.openings import PANEL_M, Opening

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
# Centre and size (metres) in the panel's frame: x across, y along its normal, z up.
BOXES = (
    (np.array([0.0, 0.01, 0.0]), np.array([PANEL_M, 0.02, PANEL_M])),
    (np.array([0.12, -0.03, 0.0]), np.array([0.02, 0.02, 0.12])),
)
DISTANCE_M, ASIDE_RAD, ABOVE_RAD = 1.1, 0.6, 0.5  # of the camera from the panel's middle
_BLUR_PX = 1.5


@dataclass(frozen=True, slots=True)
class PanelCamera:
    """Sees one opening; every frame's noise is its own. Keeps the pictures it has taken."""

    opening: Opening
    seed: int
    noise: DepthNoiseModel = field(default_factory=DepthNoiseModel)
    disparity_sigma_px: float = 0.08
    taken: dict[int, RgbdFrame] = field(default_factory=dict, compare=False, repr=False)

    @property
    def T_world_cam(self) -> gtsam.Pose3:
        """Looks at the panel's middle from in front (its -y), aside and above."""
        aside, above = np.sin(ASIDE_RAD), np.sin(ABOVE_RAD)
        away = np.array([aside, -np.sqrt(1 - aside**2 - above**2 / 2), above / np.sqrt(2)])
        eye = DISTANCE_M * away / np.linalg.norm(away)
        z = -eye / np.linalg.norm(eye)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R = gtsam.Rot3(np.stack([x, np.cross(z, x), z], axis=1))
        return self.opening.T_world_panel * gtsam.Pose3(R, eye)

    def frame(self, t: int) -> RgbdFrame:
        """Frame t; NaN beside the panel."""
        if t not in self.taken:
            self.taken[t] = self._picture(t)
        return self.taken[t]

    def _picture(self, t: int) -> RgbdFrame:
        R, p = self.opening.joint.motion(self.opening.q[t : t + 1])
        T_world_panel = gtsam.Pose3(gtsam.Rot3(R[0]), p[0]) * self.opening.T_world_panel
        depth = _depth_of_boxes((T_world_panel.inverse() * self.T_world_cam).matrix())
        rng = np.random.default_rng([self.seed, t, 7])
        white = rng.standard_normal(depth.shape)
        error = cv2.GaussianBlur(white, (0, 0), _BLUR_PX) * 2 * np.sqrt(np.pi) * _BLUR_PX
        fb = CAMERA.fx * self.noise.baseline_m
        with np.errstate(invalid="ignore"):
            noisy = fb / (fb / depth + self.disparity_sigma_px * np.asarray(error))
        grey = np.full((*depth.shape, 3), 128, dtype=np.uint8)
        return RgbdFrame(float(t), grey, noisy.astype(np.float32), CAMERA, self.T_world_cam)

    def views(
        self, frames: Sequence[int], R_world: FloatArray, t_world: FloatArray, known: BoolArray
    ) -> Steps[PatchViews]:
        """The panel in these frames; see `SurfaceSource`."""
        planes = []
        for t in frames:
            frame = self.frame(int(t))
            planes.append(depth_planes(frame, self.noise, np.isfinite(frame.depth_m)))
            yield
        return patch_views([int(t) for t in frames], planes, np.random.default_rng(self.seed))


def _depth_of_boxes(T_panel_cam: FloatArray) -> FloatArray:
    """Depth (H, W) along camera z of the nearest box, by slabs; NaN where the ray meets none."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = CAMERA.back_project(np.stack([u, v], axis=-1), np.ones_like(u)) @ T_panel_cam[:3, :3].T
    depth = np.full(u.shape, np.inf)
    for centre, size in BOXES:
        origin = T_panel_cam[:3, 3] - centre
        with np.errstate(divide="ignore"):
            a = (-size / 2 - origin) / rays
            b = (size / 2 - origin) / rays
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        hit = (enter < leave) & (enter > 0)
        depth = np.where(hit & (enter < depth), enter, depth)
    return np.where(np.isfinite(depth), depth, np.nan)
