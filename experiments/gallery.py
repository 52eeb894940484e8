"""Pictures for the documentation's gallery: what `akm-fg fit` answers, good and failed.

    python -m experiments.gallery

One row of `CASES` an answer, good and failed ones, from suites on which things are tuned: they
show what answers look like, not how often they are right (docs/experiments.md). Recordings are
rendered as by `experiments.rendered_recordings` and kept in --recordings; the same seed renders the
same. Writes NAME.jpg (the closed part, and the answer drawn into the frame at the end) and NAME.txt
(what the fit says, and the truth) to --out. About fifteen seconds a case.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.io.recording import read_recording
from akm_fg.io.recording_reader import read_truth
from akm_fg.pipeline import InputFit, observe_and_fit
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import JointTruth, Recording
from akm_fg.report.overlay import Image, OverlayConfig, draw_frame
from akm_fg.report.pictures import band_magnification, shown_frames
from akm_fg.report.score import score
from akm_fg.report.summary import PartTracks, RunSummary
from experiments.rendered_recordings import RecordingConfig, record

OUT = Path("docs/start/gallery")
RECORDINGS = Path("runs/gallery")
WIDTH_PX = 480  # of each of the two frames of a picture
QUALITY = 82  # of the JPEG


@dataclass(frozen=True, slots=True)
class Case:
    """One answer of the gallery."""

    name: str  # of its files
    object_name: str
    config: RecordingConfig = field(default_factory=RecordingConfig)


CASES = (
    Case("door", "furniture-dev/door-001"),
    Case("drawer", "furniture-dev/drawer-001"),
    Case("thin-lid", "household-dev/thing-001"),
    Case("round-door", "household-dev/thing-016"),
    Case("tray", "household-dev/thing-013"),
    Case("steep-flap", "furniture-dev/door-003"),
    Case("small-travel", "furniture-dev/door-003", RecordingConfig(travel_deg=(0.8, 0.8))),
    Case("plain-flap", "household-dev/thing-008"),
    Case("dark-lid", "household-dev/thing-005"),
    Case("glossy-bin", "household-dev/thing-007"),
    Case("plain-laptop", "household-dev/thing-015"),
)


def answer(recording: Recording, truth: JointTruth | None, name: str) -> tuple[Image, str]:
    """A recording's picture and its text."""
    try:
        fit = observe_and_fit(recording, name)
    except InsufficientData as error:
        shown = (0, len(recording.frames) - 1)
        return _side_by_side([recording.frames[i].rgb for i in shown]), f"refused: {error}\n"
    lines = fit.posterior.summary().splitlines()
    if truth is not None:
        lines += _truth_in_words(fit.posterior, truth)
    return _picture(recording, fit, truth), "\n".join(lines) + "\n"


def _truth_in_words(posterior: ArticulationPosterior, truth: JointTruth) -> list[str]:
    """What is true, and how far off the answer is."""
    scale, unit = (100.0, "cm") if truth.kind == "prismatic" else (math.degrees(1), "deg")
    lines = [f"truth: {truth.kind}, opened by {scale * np.ptp(truth.states):.1f} {unit}"]
    errors, off = score(posterior, truth), []
    if errors.axis_error_rad is not None:
        off.append(f"axis {math.degrees(errors.axis_error_rad):.2g} deg")
    if errors.pivot_error_m is not None:
        off.append(f"pivot {100 * errors.pivot_error_m:.2g} cm")
    if errors.last_state_error is not None:
        off.append(f"last state {scale * abs(errors.last_state_error):.2g} {unit}")
    return [*lines, *(["off by: " + ", ".join(off)] if off else [])]


def _picture(recording: Recording, fit: InputFit, truth: JointTruth | None) -> Image:
    tracks = None
    if fit.observed is not None:
        parts = fit.observed.segmentation
        tracks = PartTracks(fit.observed.pixels, parts.moving, parts.static)
    summary = RunSummary(
        title=fit.posterior.name,
        command="",
        seed=0,
        version="",
        recording=recording,
        tracks=tracks,
        posterior=fit.posterior,
        truth=truth,
    )
    config, index = OverlayConfig(), shown_frames(summary)[0]
    best = fit.posterior.best
    q = float("nan") if best.states is None else float(best.states.mean[index])
    drawn = draw_frame(
        recording.frames[index],
        index,
        tracks,
        best.joint,
        q,
        truth,
        config,
        band_magnification(summary, config),
    )
    return _side_by_side([recording.frames[0].rgb, drawn])


def _side_by_side(images: Sequence[Image]) -> Image:
    height, width = images[0].shape[:2]
    size = (WIDTH_PX, round(WIDTH_PX * height / width))
    resized = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
    return np.asarray(np.concatenate(resized, axis=1), dtype=np.uint8)


def run_case(case: Case, recordings: Path, out: Path) -> str:
    """Render if need be, fit, write; returns the text."""
    folder = recordings / case.name
    if not folder.exists():
        record(case.object_name, case.config, folder)
    truth = read_truth(folder)
    picture, text = answer(read_recording(folder), truth, case.name)
    out.mkdir(parents=True, exist_ok=True)
    quality = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    cv2.imwrite(str(out / f"{case.name}.jpg"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), quality)
    (out / f"{case.name}.txt").write_text(f"{case.object_name}\n{text}", encoding="utf-8")
    return text


def main(argv: list[str] | None = None) -> int:
    """Write what is asked for; says what was answered."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=[case.name for case in CASES], nargs="*")
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args(argv)
    arguments.recordings.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        if not arguments.only or case.name in arguments.only:
            print(run_case(case, arguments.recordings, arguments.out), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
