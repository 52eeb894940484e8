"""Tuning of motion segmentation."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.geometry.rigid_motion import RigidMotionConfig


@dataclass(frozen=True, slots=True)
class MotionSegmentationConfig:
    """Tests and clusters."""

    systematic_m: float = 0.0015  # error that is not in the covariances, each axis: calibration
    min_observations: int = 3  # fewer say nothing about motion
    false_alarm: float = 0.01  # of one track as a seed; the evidence of all together decides
    min_moving: int = 6  # tracks; a rigid motion takes three, and three must confirm it
    min_motion_m: float = 0.004  # rms displacement of the part: below, calibration drift can do it
    spectral_tracks: int = 250  # eigenvectors cost the cube of this
    hand_slip_m: float = 0.005  # how much the fingers may shift on the handle
    min_with_hand: int = 4  # tracks that a motion takes which the hand confirms
    neighbours: int = 7  # sets the local scale of affinities (Zelnik-Manor, Perona, 2004)
    outlier_sigmas: float = 5.0  # a residual counts no more than this
    max_per_freedom: float = 2.5  # chi-square per degree of freedom of a track that is explained
    max_noise_scale: float = 3.0  # how much worse than claimed the noise may turn out to be
    min_log_ratio: float = 5.0  # natural log of the likelihood ratio that decides a track
    rigid_motion: RigidMotionConfig = field(default_factory=RigidMotionConfig)
    refits: int = 3  # of the motion, each to the tracks that the one before explains
