"""What was understood of a source, for a person to see a mistake before a fit."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from akm_fg.records import PinholeCamera

SCHEMA = "akm-fg/convert/1"


@dataclass(frozen=True, slots=True)
class Understood:
    """Of one source; lengths in metres, angles in degrees."""

    input: str
    format: str
    frames: int
    seconds: float
    rate_hz: float
    colour: str
    depth: str
    camera: PinholeCamera
    bend_px: float  # how far removing distortion moves pixels, at most
    reduction: int  # colour was made so many times coarser
    aligned: bool  # depth was moved to the colour's pixels
    apart_ms: tuple[float, float]  # depth from colour: median, largest
    left_out: dict[str, int]  # pictures, by reason
    depth_unit_m: float
    depth_unit_from: str
    depth_m: tuple[float, float]  # 5 % and 95 % of what is seen
    known: float  # share of pixels with depth
    poses: str
    moves: tuple[float, float]  # of the camera: metres, degrees from the first frame
    axes: str
    axes_from: str
    gravity: str
    notes: tuple[str, ...]

    def lines(self) -> list[tuple[str, str]]:
        """Name and words of each line of a table."""
        c = self.camera
        picture = f"{self.frames} frames of {c.width}x{c.height}, {self.seconds:.2f} s"
        rate = f", {self.rate_hz:.1f} Hz" if self.rate_hz == self.rate_hz else ""
        lens = f"fx {c.fx:.1f}, fy {c.fy:.1f}, cx {c.cx:.1f}, cy {c.cy:.1f} px"
        lens += f"; distortion of up to {self.bend_px:.1f} px removed" if self.bend_px else ""
        lens += f"; colour reduced {self.reduction}-fold" if self.reduction > 1 else ""
        near, far = self.depth_m
        seen = f"{near:.2f} to {far:.2f} m, known in {100 * self.known:.0f} % of the pixels"
        left = ", ".join(f"{n} {why}" for why, n in self.left_out.items() if n)
        metres, degrees = self.moves
        still = "stands still" if metres == degrees == 0 else f"moves by {metres:.3f} m"
        rows = [
            ("format", self.format),
            ("frames", picture + rate + (f"; left out: {left}" if left else "")),
            ("colour", self.colour),
            ("depth", self.depth + ("; moved to the colour's pixels" if self.aligned else "")),
            ("stamps", "depth {:.1f} ms from colour, {:.1f} at most".format(*self.apart_ms)),
            ("lens", lens),
            ("unit", f"{self.depth_unit_m:g} m ({self.depth_unit_from})"),
            ("seen", seen),
            ("camera", f"{still}; {self.poses}"),
            ("axes", f"{self.axes} ({self.axes_from})"),
            ("gravity", self.gravity),
        ]
        return rows + [("note", note) for note in self.notes]

    def as_json(self) -> dict[str, Any]:
        """The fields by name, and the schema."""
        return {"schema": SCHEMA, **asdict(self)}
