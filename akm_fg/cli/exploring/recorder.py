"""Records the attempts of an exploration as they go, and says what happens."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from akm_fg.cli.console.lines import tell
from akm_fg.exploration.records import Attempt
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.records import CalibrationErrors, Look, first_hold


def attempt_name(number: int) -> str:
    """The folder of the recording of an attempt, counted from 0, in the folder of the run."""
    return f"attempt-{number + 1:02d}"


class Recorder:
    """Records attempts as they go, and says what happens. Knows no truth."""

    def __init__(
        self, folder: Path, calibration: CalibrationErrors | None, result: Callable[[], None]
    ) -> None:
        """Writes nothing yet.

        Args:
            folder: of the run.
            calibration: what is not known of the camera.
            result: called when an attempt has ended, to keep what is known.
        """
        self._run_folder, self._calibration, self._result = folder, calibration, result
        self._began = time.perf_counter()
        self._looks: list[Look] = []  # of an attempt; the first is kept until it touches something
        self._writer: RecordingWriter | None = None

    def begun(self, number: int, attempt: Attempt) -> None:
        """Say what is tried."""
        self._looks, self._writer = [], None
        self._number = number
        folder = self._folder()
        if folder.exists():  # of an attempt that was interrupted
            shutil.rmtree(folder)
        way = attempt.hypothesis.way
        self.stage(
            f"attempt {number + 1}: {attempt.contact.what} on front {attempt.contact.front}, "
            f"pull {way} (probability {attempt.probability:.2f})"
        )

    def looked(self, look: Look) -> None:
        """Write the frame."""
        self._looks.append(look)
        if len(self._looks) == 1:
            return
        if self._writer is None:
            self._writer = RecordingWriter(self._folder())
            self._add(self._looks[0])
            if self._calibration is not None:
                self._writer.set_calibration(self._calibration)
        self._add(look)

    def _folder(self) -> Path:
        return self._run_folder / attempt_name(self._number)

    def _add(self, look: Look) -> None:
        assert self._writer is not None
        self._writer.add(look.frame, T_world_gripper=look.T_world_gripper)

    def stretched(self, attempt: Attempt) -> None:
        """Say what is known now."""
        stretch = attempt.stretches[-1]
        if stretch.bounds is None:
            return
        axis_deg = np.rad2deg(stretch.bounds.axis_rad)
        pivot = "" if stretch.bounds.pivot_m is None else f", {100 * stretch.bounds.pivot_m:.1f} cm"
        likely = max(stretch.kind_probability, key=stretch.kind_probability.__getitem__)
        self.stage(
            f"  {100 * stretch.travel_m:.0f} cm: {likely} {stretch.kind_probability[likely]:.3f}, "
            f"axis within {axis_deg:.1f} deg{pivot} (95 %)"
        )

    def ended(self, number: int, attempt: Attempt) -> None:
        """Close the recording."""
        if self._writer is not None:
            attempt.recording = attempt_name(number)
            self._finish(self._writer)
        self.stage(f"  {attempt.outcome.replace('_', ' ')}: {attempt.reason}")
        self._result()

    def _finish(self, writer: RecordingWriter) -> None:
        hold = first_hold(self._looks)
        if hold is not None:
            writer.set_grasp_frames(*hold)

    def stage(self, words: str) -> None:
        """Say what comes next, and when."""
        tell(words, self._began)
