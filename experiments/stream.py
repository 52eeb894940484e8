"""Does a stream of frames say what a fit of the whole recording says, and how long does it think?

    python -m experiments.stream --recordings runs/dev-recordings

Every recording of a folder (`experiments.rendered_recordings --suite furniture-dev`) goes into a
`FrameStream` frame by frame. After its last frame stand side by side: the update that `add` gave,
the stream's `posterior`, and `fit_recording` of the same frames; differences are in the latter's
standard deviations. Some recordings are played to and fro until 330 frames have gone in: frames
beyond 300 are timed as the first 30 are, and a fit of all frames so far, which a loop without a
stream would need for each, beside them. One thread; CPU time. One row a recording in
OUT/stream.jsonl, as it ends; what is there is not done again. About ten seconds a recording, two
minutes one that is played on.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

import cv2
import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.io.recording import read_recording
from akm_fg.pipeline import fit_recording
from akm_fg.posterior import ArticulationPosterior, JointPosterior
from akm_fg.records import Recording
from akm_fg.report.score import axis_angle_rad, point_line_distance_m
from akm_fg.stream.frame_stream import FrameStream
from akm_fg.stream.seen_so_far import hands_of
from experiments.pages.one_line import ends_in_one_line
from experiments.pages.tables import NoRows, markdown
from experiments.rows.json_lines import append_line, whole_lines
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share

FILE = "stream.jsonl"
LONG = 330  # frames of a recording that is played on
EARLY, LATE = 30, 300  # frames up to here, and from here on
HALF_SD, TWO_SD = 0.5, 2.0  # what the stream may differ by


@dataclass(frozen=True, slots=True)
class StreamConfig:
    """Which recordings, and which of them are played on."""

    recordings: Path
    long_every: int = 10  # one in so many is played to and fro; 0: none
    out: Path = Path("runs/stream")

    def folders(self) -> list[Path]:
        """The recordings, by name.

        Raises:
            NoRows: there are none.
        """
        found = sorted(file.parent for file in self.recordings.glob("*/recording.json"))
        if not found:
            raise NoRows(
                f"{self.recordings} has no recordings: run experiments.rendered_recordings"
            )
        return found


@dataclass(frozen=True, slots=True)
class Apart:
    """An answer against that of the whole recording, in the latter's standard deviations."""

    kind: str | None  # None: no answer
    axis_sd: float | None = None  # None where the kinds differ, or nothing moves
    pivot_sd: float | None = None
    state_sd: float | None = None  # of the last frame

    @property
    def most(self) -> float | None:
        """The largest of them."""
        known = [v for v in (self.axis_sd, self.pivot_sd, self.state_sd) if v is not None]
        return max(known, default=None)


@dataclass(frozen=True, slots=True)
class StreamRow:
    """One recording."""

    recording: str
    frames: int
    tracks: int  # in the last frame
    kind: str | None  # by the whole recording
    update: Apart  # what the last frame's update says
    posterior: Apart  # what the stream says when asked
    frame_s: list[float]  # CPU seconds of every frame
    refit_s: float  # CPU seconds of a fit of all frames from nothing


def run_trial(folder: Path, long: bool = False) -> StreamRow:
    """One recording; `long`: played to and fro."""
    recording = read_recording(folder)
    if long:
        recording = played_on(recording, LONG)
    stream, frame_s, update = FrameStream(folder.name), [], None
    masks = recording.object_masks or [None] * len(recording.frames)
    for frame, hand, mask in zip(recording.frames, hands_of(recording), masks, strict=True):
        began = time.process_time()
        update = stream.add(frame, hand, mask)
        frame_s.append(time.process_time() - began)
    began = time.process_time()
    try:
        whole = fit_recording(dataclasses.replace(recording, name=folder.name))
    except InsufficientData:
        whole = None
    refit_s = time.process_time() - began
    assert update is not None
    by_update, by_stream = Apart(None), Apart(None)
    if whole is not None:
        fit = whole.posterior
        if update.joint is not None:
            by_update = apart(update.kind, update.joint, update.state, fit)
        asked = stream.posterior().posterior
        states = asked.best.states
        last = None if states is None else float(states.mean[-1])
        by_stream = apart(asked.kind, asked.best.joint, last, fit)
    return StreamRow(
        recording=folder.name,
        frames=len(recording.frames),
        tracks=0 if whole is None else int(whole.observed.tracks.observed[-1].sum()),
        kind=None if whole is None else whole.posterior.kind,
        update=by_update,
        posterior=by_stream,
        frame_s=frame_s,
        refit_s=refit_s,
    )


def played_on(recording: Recording, frames: int) -> Recording:
    """The recording to and fro until there are so many frames; stamps go on growing."""
    n = len(recording.frames)
    order = list(islice(cycle([*range(n), *range(n - 2, 0, -1)]), frames))
    step_s = (recording.frames[-1].stamp_s - recording.frames[0].stamp_s) / (n - 1)
    clip = tuple(
        dataclasses.replace(recording.frames[k], stamp_s=step_s * number)
        for number, k in enumerate(order)
    )
    poses, masks = recording.T_world_gripper, recording.object_masks
    held = recording.grasp_frames
    return Recording(
        recording.name,
        clip,
        None if masks is None else tuple(masks[k] for k in order),
        None if poses is None else tuple(poses[k] for k in order),
        None if held is None else (held[0], frames - 1 if held[1] == n - 1 else held[1]),
    )


def apart(
    kind: str, joint: JointPosterior | None, last: float | None, whole: ArticulationPosterior
) -> Apart:
    """How far an answer is from that of the whole recording.

    Args:
        kind: named.
        joint: of the most probable kind.
        last: state of the last frame.
        whole: by all frames.
    """
    best = whole.best
    if joint is None or best.joint is None or best.states is None or joint.kind != best.joint.kind:
        return Apart(kind)
    angle = axis_angle_rad(joint.axis, best.joint.axis)
    pivot_sd = None
    if joint.pivot is not None and best.joint.pivot is not None:
        off = point_line_distance_m(best.joint.pivot, joint.pivot, joint.axis)
        pivot_sd = off / float(best.joint.pivot_sd_m or np.nan)
    state, sd, state_sd = float(best.states.mean[-1]), float(best.states.sd[-1]), None
    if last is not None and np.isfinite([state, last]).all():
        state_sd = abs(last - state) / sd
    return Apart(kind, angle / best.joint.axis_sd_rad, pivot_sd, state_sd)


def run(config: StreamConfig) -> int:
    """Run what is missing; returns how many trials that were."""
    cv2.setNumThreads(1)
    note_run(config.out, config)
    file = config.out / FILE
    done = {row.recording for row in read_rows(config.out)}
    missing = 0
    for number, folder in enumerate(config.folders()):
        for long in (False, True):
            name = f"{folder.name}, played on" if long else folder.name
            wanted = not long or (config.long_every > 0 and number % config.long_every == 0)
            if name in done or not wanted:
                continue
            row = dataclasses.replace(run_trial(folder, long), recording=name)
            append_line(file, json.dumps(dataclasses.asdict(row)))
            missing += 1
            print(f"{name}: {line(row)}", flush=True)
    return missing


def read_rows(folder: Path) -> list[StreamRow]:
    """The rows of a folder."""
    rows = []
    for _, data in whole_lines(folder / FILE):
        given = {**data, "update": Apart(**data["update"]), "posterior": Apart(**data["posterior"])}
        rows.append(StreamRow(**given))
    return rows


def line(row: StreamRow) -> str:
    """A row in a line."""
    most = [each.most for each in (row.update, row.posterior)]
    words = ["-" if v is None else f"{v:.2f} sd" for v in most]
    ms = 1e3 * np.array(row.frame_s)
    return (
        f"{row.kind}; update {words[0]}, posterior {words[1]}; "
        f"frame {np.median(ms):.0f} ms (worst {ms.max():.0f}), refit {1e3 * row.refit_s:.0f} ms"
    )


def agreement_table(rows: Sequence[StreamRow]) -> str:
    """How often stream and whole recording agree, and how far they are apart at most."""
    lines = []
    some = [row for row in rows if row.kind is not None and row.frames < LATE]
    for name in ("posterior", "update"):
        said = [getattr(row, name) for row in some]
        alike = share([a.kind == row.kind for a, row in zip(said, some, strict=True)])
        most = [a.most for a in said if a.most is not None]
        if not most:
            raise NoRows("no recording has two answers to compare")
        near, far = share([v < HALF_SD for v in most]), max(most)
        beyond = sum(v > TWO_SD for v in most)
        percent = [
            f"{100 * s.value:.1f} ({100 * s.low:.0f} to {100 * s.high:.0f})" for s in (alike, near)
        ]
        lines.append([name, str(len(some)), *percent, f"{far:.2f}", str(beyond)])
    head = ["answer", "recordings", "same kind, %", "within half an sd, %", "farthest, sd"]
    return markdown([*head, "beyond two sd"], lines)


def speed_table(rows: Sequence[StreamRow]) -> str:
    """CPU time of a frame, early and late, and of a refit of all frames so far."""
    lines = []
    late_rows = [row for row in rows if row.frames > LATE]
    for words, some, part in (
        (f"first {EARLY}", rows, slice(0, EARLY)),
        (f"beyond {LATE}", late_rows, slice(LATE, None)),
    ):
        if not some:
            continue
        ms = 1e3 * np.concatenate([row.frame_s[part] for row in some])
        fitted = [row for row in some if (row.frames > LATE) == (part.stop is None)]
        refit = np.median([1e3 * row.refit_s for row in fitted]) if fitted else np.nan
        figures = [np.median(ms), np.quantile(ms, 0.99), ms.max(), refit]
        lines.append([words, str(ms.size), *(f"{figure:.0f}" for figure in figures)])
    head = ["frames", "timed", "median, ms", "99 %, ms", "worst, ms", "refit of all so far, ms"]
    return markdown(head, lines)


def main() -> None:
    """Run what is missing and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = StreamConfig(Path())
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--long-every", type=int, default=default.long_every)
    parser.add_argument("--out", type=Path, default=default.out)
    config = StreamConfig(**vars(parser.parse_args()))
    with ends_in_one_line("stream"):
        run(config)
    rows = read_rows(config.out)
    for table in (agreement_table, speed_table):
        try:
            print(table(rows), end="\n\n")
        except NoRows as nothing:
            print(nothing, end="\n\n")


if __name__ == "__main__":
    main()
