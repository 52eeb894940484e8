"""A rig that errs: camera and arm are a little elsewhere than whoever uses them believes.

The picture is made by the true camera and the arm has its true joint angles; frames carry the
believed calibration, and the measured angles are off. Errors are drawn once a seed and stay for all
frames. How large they may be is known (`RigErrors.calibration`), how large they are is not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.arm.body.model import N_ARM
from akm_fg.records import CalibrationErrors, FloatArray, PinholeCamera, RgbdFrame

CAMERA_STREAM, ARM_STREAM = 61, 62  # of random numbers, beside the seed


@dataclass(frozen=True, slots=True)
class RigErrors:
    """Standard deviations of what is not known of a rig; all of them 0 is a perfect one."""

    place_m: float = 1e-3  # of a hand-eye calibration, each axis
    place_rad: float = float(np.radians(0.1))  # each axis
    focal: float = 0.002  # relative, fx and fy alike
    depth_scale: float = 0.01  # the D455's data sheet: within 2 %, taken as 95 %
    depth_bias_m: float = 1e-3
    # Of each joint's zero: the hand is off by about a millimetre, as Franka's data sheet allows.
    joint_rad: float = float(np.radians(0.05))

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if not 0 <= value < np.inf:
                raise ValueError(f"{one.name} is {value}, expected a number no less than 0")

    def calibration(self) -> CalibrationErrors:
        """What a recording says of its camera."""
        cov = np.diag([self.place_rad**2] * 3 + [self.place_m**2] * 3)
        return CalibrationErrors(cov, self.focal, self.depth_scale, self.depth_bias_m)

    def drawn(self, seed: int) -> DrawnRig:
        """The errors of one rig."""
        rng = np.random.default_rng([seed, ARM_STREAM])
        offsets_rad = self.joint_rad * rng.normal(size=N_ARM)
        return DrawnRig(drawn_camera(self.calibration(), seed), offsets_rad)


PERFECT = RigErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """Errors of one camera: what is believed of it, and measured by it, from what is true.

    True are the place T_world_cam Exp(eta), focal lengths 1 + focal times those believed, and the
    depth (1 + scale) times the measured one, plus the bias.
    """

    eta: tuple[float, ...] = (0.0,) * 6  # rad, m; rotation first
    focal: float = 0.0
    depth_scale: float = 0.0
    depth_bias_m: float = 0.0

    def believed_place(self, T_world_cam: gtsam.Pose3) -> gtsam.Pose3:
        """Where a camera is taken to stand that stands at `T_world_cam`."""
        return T_world_cam * gtsam.Pose3.Expmap(np.array(self.eta)).inverse()

    def believed_camera(self, camera: PinholeCamera) -> PinholeCamera:
        """What a camera is taken for."""
        return replace(camera, fx=self.believed_px(camera.fx), fy=self.believed_px(camera.fy))

    def believed_px(self, focal_px: float) -> float:
        """What a focal length is taken for."""
        return focal_px / (1 + self.focal)

    def measured_depth(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) for the depth that a camera without scale and bias measures."""
        return ((depth_m - self.depth_bias_m) / (1 + self.depth_scale)).astype(np.float32)

    def seen(self, frame: RgbdFrame) -> RgbdFrame:
        """What whoever uses the camera gets for the frame of a perfect one."""
        return replace(
            frame,
            camera=self.believed_camera(frame.camera),
            depth_m=self.measured_depth(frame.depth_m),
            T_world_cam=self.believed_place(frame.T_world_cam),
        )


def drawn_camera(errors: CalibrationErrors, seed: int) -> CameraErrors:
    """The errors of one camera, out of those that it may have."""
    rng = np.random.default_rng([seed, CAMERA_STREAM])
    eta = rng.multivariate_normal(np.zeros(6), errors.cov_world_cam)
    sds = np.array([errors.focal_sd, errors.depth_scale_sd, errors.depth_bias_sd_m])
    focal, scale, bias_m = (sds * rng.normal(size=3)).tolist()
    return CameraErrors(tuple(eta.tolist()), focal, scale, bias_m)


@dataclass(frozen=True, slots=True)
class DrawnRig:
    """The errors of one camera and one arm."""

    camera: CameraErrors
    joint_offsets_rad: FloatArray  # (7,) measured less true angles
