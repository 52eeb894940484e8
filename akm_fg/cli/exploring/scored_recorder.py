"""A recorder that knows the simulator's truth, for scoring alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from akm_fg.cli.exploring.recorder import Recorder
from akm_fg.exploration.records import Attempt
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.records import JointTruth, Look
from sim.episode import SimEpisode


class ScoredRecorder(Recorder):
    """Records attempts as they go, the true states beside every frame."""

    def __init__(self, folder: Path, world: SimEpisode, result: Callable[[], None]) -> None:
        super().__init__(folder, world.calibration, result)
        self._world = world
        self.truths: list[tuple[JointTruth, ...]] = []  # of every part, by look
        self.largest_state = 0.0  # true, of all attempts, m or rad: how far it was opened
        self.pressed_n = 0.0  # largest force seen of a link that is no finger, on the object

    def begun(self, number: int, attempt: Attempt) -> None:
        """See Recorder."""
        self.truths = []
        super().begun(number, attempt)

    def looked(self, look: Look) -> None:
        """Write the frame; the truth goes beside it."""
        truths = self.parts_truth()
        self.truths.append(truths)
        farthest = max(abs(float(truth.states[-1])) for truth in truths)
        self.largest_state = max(self.largest_state, farthest)
        self.pressed_n = max(self.pressed_n, self._world.pressed_n())
        super().looked(look)

    def truth(self) -> JointTruth:
        """The true joint, a state for each look of the last attempt; for scoring alone.

        Where several parts open it is that of the one that went farthest in the attempt.
        """
        if not self.truths:
            return self._world.truth()
        states = np.array([[float(t.states[-1]) for t in truths] for truths in self.truths])
        part = int(np.ptp(states, axis=0).argmax())
        return dataclasses.replace(self.truths[0][part], states=states[:, part])

    def parts_truth(self) -> tuple[JointTruth, ...]:
        """Every part's true joint and its state now; for scoring alone."""
        return tuple(self._world.truth(part) for part in range(self._world.world.parts))

    def _finish(self, writer: RecordingWriter) -> None:
        writer.set_truth(self.truth())
        super()._finish(writer)
