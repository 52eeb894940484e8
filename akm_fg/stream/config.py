"""All tuning of a stream of frames, and of the states that are found beside a recording's graph."""

from __future__ import annotations

from dataclasses import dataclass, field

from akm_fg.estimation.stream.stream_records import IncrementalConfig
from akm_fg.stream.gripper_state import GripperStateConfig
from akm_fg.stream.surface_state import SurfaceStateConfig


def _thinking() -> IncrementalConfig:
    """A comparison with surfaces has fifty pieces: with less growth one would follow on another."""
    return IncrementalConfig(pieces_to_solve=2, growth_to_compare=0.5)


@dataclass(frozen=True, slots=True)
class StreamConfig:
    """Frames as they come: perception and the fit itself have their own tables."""

    thinking: IncrementalConfig = field(default_factory=_thinking)
    # Frames of a comparison that cost one piece of it: with fewer, several pieces are done at once.
    frames_a_piece: int = 20
    least_frames: int = 10  # before depth is asked where tracks show no motion: as many pieces
    surface_state: SurfaceStateConfig = field(default_factory=SurfaceStateConfig)
    gripper_state: GripperStateConfig = field(default_factory=GripperStateConfig)
