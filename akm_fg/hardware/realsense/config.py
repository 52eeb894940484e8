"""Settings of a RealSense camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RealSenseConfig:
    """What is asked of the camera, and how long it is waited for."""

    fps: int = 30
    depth_sizes: tuple[tuple[int, int], ...] = ((848, 480), (1280, 720))  # best first
    patience_s: float = 5.0  # without a picture
    # From exposure to arrival, at most: what arrives earlier than this after it was asked for may
    # show the scene as it was before.
    latency_s: float = 0.06
    pair_s: float = 0.02  # between colour and depth of one frame, at most
    queue: int = 4  # pictures that wait; older ones are dropped
    lens_off: float = 0.03  # relative, between calibrated and built-in focal lengths: same camera
