"""Records a manipulation as it goes, and says what happens."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from akm_fg.cli.console.lines import tell
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.manipulation.records import Decision
from akm_fg.records import JointTruth, Look, first_hold
from akm_fg.report.wording import state
from factors.joint import Unit
from sim.episode import SimEpisode

RECORDING = "recording"  # the folder of the recording in the folder of the run


class RunRecorder:
    """Writes frames and true states as they come, and says what is decided."""

    def __init__(self, writer: RecordingWriter, world: SimEpisode, unit: Unit, number: int) -> None:
        """Begins; `number` is the part's by the simulator, for scoring alone."""
        self._writer, self._world, self._unit, self._number = writer, world, unit, number
        self._began = time.perf_counter()
        if world.calibration is not None:
            self._writer.set_calibration(world.calibration)
        self._looks: list[Look] = []
        self.truths: list[JointTruth] = []
        self.pressed_n = 0.0  # largest force of a link that is no finger on the object, as sampled

    def looked(self, look: Look) -> None:
        """Write the frame; the truth goes beside it, for scoring alone."""
        self.truths.append(self._world.world.truth(self._number))
        self.pressed_n = max(self.pressed_n, self._world.pressed_n())
        self._looks.append(look)
        self._writer.add(look.frame, T_world_gripper=look.T_world_gripper)

    def decided(self, decision: Decision) -> None:
        """Say what comes next, and why."""
        known = decision.state is not None and decision.state_sd is not None
        belief = "unknown"
        if known:
            belief = f"{state(decision.state, self._unit)} ± {state(decision.state_sd, self._unit)}"
        goes = "" if decision.commanded is None else f" to {state(decision.commanded, self._unit)}"
        self.stage(
            f"{decision.action}{goes}: {decision.why} "
            f"(state {belief}, P {decision.probability:.2f})"
        )

    def stage(self, words: str) -> None:
        """Say what comes next, and when."""
        tell(words, self._began)

    def truth(self) -> JointTruth | None:
        """The true joint, a state from closed for each look; for scoring alone."""
        if not self.truths:
            return None
        states = np.array([float(truth.states[-1]) for truth in self.truths])
        return dataclasses.replace(self.truths[0], states=states)

    def finish(self) -> None:
        """Add to the recording what is known at its end."""
        truth = self.truth()
        if truth is not None:
            self._writer.set_truth(truth)
            hold = first_hold(self._looks)
            if hold is not None:
                self._writer.set_grasp_frames(*hold)
