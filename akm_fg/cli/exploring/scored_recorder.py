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
from sim.robot.contacts import contacts


class ScoredRecorder(Recorder):
    """Records attempts as they go, the true states beside every frame."""

    def __init__(self, folder: Path, world: SimEpisode, result: Callable[[], None]) -> None:
        super().__init__(folder, world.calibration, result)
        self._world = world
        self.truths: list[JointTruth] = []
        self.largest_state = 0.0  # true, of all attempts, m or rad: how far it was opened
        self.pressed_n = 0.0  # largest force seen of a link that is no finger, on the object

    def begun(self, number: int, attempt: Attempt) -> None:
        """See Recorder."""
        self.truths = []
        super().begun(number, attempt)

    def looked(self, look: Look) -> None:
        """Write the frame; the truth goes beside it."""
        truth = self._world.truth()
        self.truths.append(truth)
        self.largest_state = max(self.largest_state, abs(float(truth.states[-1])))
        self.pressed_n = max(self.pressed_n, self._pressed_n())
        super().looked(look)

    def truth(self) -> JointTruth:
        """The true joint, a state for each look of the last attempt; for scoring alone."""
        if not self.truths:
            return self._world.truth()
        states = np.array([float(truth.states[-1]) for truth in self.truths])
        return dataclasses.replace(self.truths[0], states=states)

    def _finish(self, writer: RecordingWriter) -> None:
        writer.set_truth(self.truth())
        super()._finish(writer)

    def _pressed_n(self) -> float:
        world, fingers = self._world.world, set(self._world.arm.gripper.joints)
        touching = contacts(world.client, world.robot_id, world.object_id)
        return sum(contact.force_n for contact in touching if contact.link not in fingers)
