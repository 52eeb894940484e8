"""What speaks against an answer: camera, depth, gripper and part held against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InsufficientData
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.other_view import stands_still
from akm_fg.perception.rig.camera_motion import StillCamera
from akm_fg.perception.rig.depth_against_colour import depth_unit_doubts, lag_doubts
from akm_fg.perception.rig.gripper_place import motion_doubts, place_doubts
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, Doubt, Recording, RgbdFrame


class RigDoubts:
    """Of one recording or stream; what was compared once is remembered."""

    def __init__(self, config: PerceptionConfig) -> None:
        """Nothing is compared yet."""
        self._config = config
        self._still: StillCamera | None = None

    def of_input(
        self,
        clip: Recording,
        numbers: NDArray[np.int_],
        object_mask: BoolArray,
        noise: DepthNoiseModel,
    ) -> list[Doubt]:
        """About what was put in, whatever the answer.

        Args:
            clip: the frames that are kept.
            numbers: of these, growing; the first is 0.
            object_mask: (H, W) in the first frame.
            noise: of the depth, as it was found to be.
        """
        rig = self._config.rig
        still = self._compared_with(clip.frames[0], object_mask, noise)
        motion = still.motion(dict(zip(numbers.tolist(), clip.frames, strict=True)))
        found = depth_unit_doubts(clip.frames[0], rig.depth)
        found += [] if motion is None else [motion.doubt()]
        found += place_doubts(clip, object_mask, rig.gripper)
        every_frame = numbers[-1] == numbers.size - 1
        if every_frame and motion is None and stands_still(clip.frames):
            found += lag_doubts(clip.frames, rig.depth)
        return found

    def prepare(
        self,
        number: int,
        frame: RgbdFrame,
        first: RgbdFrame,
        object_mask: BoolArray,
        noise: DepthNoiseModel,
    ) -> None:
        """Compare a frame with the first as it comes, so that `of_input` need not.

        Args:
            number: of the frame.
            frame: the frame.
            first: the first one.
            object_mask: (H, W) in the first frame.
            noise: of the depth, as it was found to be.
        """
        self._compared_with(first, object_mask, noise).shift(number, frame)

    def _compared_with(
        self, first: RgbdFrame, object_mask: BoolArray, noise: DepthNoiseModel
    ) -> StillCamera:
        if self._still is None:
            camera = self._config.rig.camera
            corners = camera.corners
            corners = replace(corners, edge_m=self._times_noisier(noise) * corners.edge_m)
            self._still = StillCamera(first, object_mask, noise, replace(camera, corners=corners))
        return self._still

    def of_answer(
        self,
        clip: Recording,
        numbers: NDArray[np.int_],
        posterior: ArticulationPosterior,
        noise: DepthNoiseModel,
    ) -> list[Doubt]:
        """About an answer; as `of_input`, with the posterior over all frames.

        Args:
            clip: the frames that are kept.
            numbers: of these.
            posterior: over all frames.
            noise: of the depth, as it was found to be.
        """
        rig, best = self._config.rig, posterior.best
        found = rig.camera.few_tracks(clip.frames, posterior.fit.tracks_used)
        if posterior.fit.tracks_used < rig.least_tracks:
            found += self._of_depth_alone(posterior, noise)
        if best.joint is None or best.states is None:
            return found
        q = best.states.mean[numbers]
        return found + motion_doubts(clip, best.joint.joint, q, rig.gripper)

    def _times_noisier(self, noise: DepthNoiseModel) -> float:
        """Than the settings assume."""
        return noise.disparity_sigma_px / self._config.observe.noise.disparity_sigma_px

    def _of_depth_alone(
        self, posterior: ArticulationPosterior, noise: DepthNoiseModel
    ) -> list[Doubt]:
        """About an answer that rests on surfaces, and on next to no point that was followed."""
        found = []
        if posterior.kind == "helical":  # a plain door slides along its axis unseen
            found.append(
                Doubt(
                    f"depth and {posterior.fit.tracks_used} points do not tell a screw from a "
                    "hinge; expected texture on the part, or light"
                )
            )
        patches, least = posterior.fit.patches_used, self._config.rig.least_patches
        if posterior.kind != "rigid" and patches < least:
            found.append(
                Doubt(
                    f"only {posterior.fit.tracks_used} points could be followed and {patches} "
                    f"patches of surface found again; expected {self._config.rig.least_tracks} "
                    f"points or {least} patches: texture, light, or a closer camera"
                )
            )
        scale = self._times_noisier(noise)
        if scale > 1:
            found.append(
                Doubt(
                    f"depth is {scale:.1f} times as noisy as assumed, and only "
                    f"{posterior.fit.tracks_used} points could be followed; expected texture on "
                    "the part, or light, or less noise"
                )
            )
        return found


def told_with(error: InsufficientData, doubts: list[Doubt]) -> InsufficientData:
    """The error, with what may be behind it."""
    return type(error)("; ".join([str(error), *(doubt.text for doubt in doubts)]))
