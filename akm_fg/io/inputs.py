"""Finds out what an input of ``fit`` is, and reads it."""

from __future__ import annotations

from pathlib import Path

from akm_fg.errors import InputError
from akm_fg.io.pose_log import read_pose_log
from akm_fg.io.read_options import ReadOptions
from akm_fg.io.recording import read_recording
from akm_fg.io.sources.registry import format_of, read_source
from akm_fg.io.tracks import TracksInput, read_tracks
from akm_fg.records import PoseTrack, Recording

RECORDING_FILE = "recording.json"
FitInput = Recording | TracksInput | PoseTrack

POSE_LOG_SUFFIXES = (".log", ".txt", ".dat", ".csv", ".tsv", ".tum", ".kitti", ".traj")
WHAT = (
    "a recording folder, tracks (.npz), a pose log ("
    + ", ".join(POSE_LOG_SUFFIXES)
    + "), or a recording that akm-fg convert reads"
)


def read_input(
    path: Path, first_frames: int | None = None, options: ReadOptions | None = None
) -> FitInput:
    """Read a recording of any known format, tracks (.npz) or a pose log (.log, .txt, .csv, ...).

    Args:
        path: of the input.
        first_frames: take so many from a recording's beginning and no more; None: all.
        options: what a person says of the input that its file does not.

    Raises:
        InputError: it does not exist, is none of these, or is broken; or frames are asked for
            from what is no recording.
    """
    path = Path(path)
    try:
        exists, is_folder = path.exists(), path.is_dir()
    except (OSError, ValueError) as e:
        raise InputError(path, "is not a usable path", WHAT) from e
    if not exists:
        raise InputError(path, "does not exist", WHAT)
    options = options or ReadOptions()
    if is_folder and (path / RECORDING_FILE).exists():
        return read_recording(path, first_frames=first_frames, conventions=options.conventions)
    if format_of(path) is not None:
        return read_source(path, options.source, options.conventions, first_frames)
    if is_folder:
        _check_is_no_run(path)
        return read_recording(path)  # says what is missing
    if first_frames is not None:
        raise InputError(path, "has no frames to choose from", "a recording with --frames")
    if path.suffix.lower() == ".npz":
        return read_tracks(path, options)
    if path.suffix.lower() in POSE_LOG_SUFFIXES:
        return read_pose_log(path, options)
    ending = f"ends in {path.suffix!r}" if path.suffix else "has no ending that says what it is"
    raise InputError(path, ending, WHAT)


def _check_is_no_run(folder: Path) -> None:
    """Raises InputError for what a fit or a run left: its recording lies elsewhere."""
    held = [name for name in ("posterior.json", "model.json") if (folder / name).is_file()]
    if (folder / "recording" / RECORDING_FILE).is_file():
        raise InputError(folder, "is the folder of a run", f"its recording, {folder / 'recording'}")
    if held:
        problem = f"holds an answer ({' and '.join(held)}), and no recording"
        raise InputError(folder, problem, WHAT)
