"""Recordings on disk: everything that reads and writes them, under one name."""

from akm_fg.io.recording_depth import DEPTH_UNIT_M, as_stored
from akm_fg.io.recording_reader import SCHEMA, read_recording, read_truth
from akm_fg.io.recording_writer import RecordingWriter, write_recording

__all__ = [
    "DEPTH_UNIT_M",
    "SCHEMA",
    "RecordingWriter",
    "as_stored",
    "read_recording",
    "read_truth",
    "write_recording",
]
