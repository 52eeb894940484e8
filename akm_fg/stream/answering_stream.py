"""Frames go in one by one; what they mean is asked now and then, and nothing in between.

An exploration pulls in short stretches and asks after each. What an answer needs of every single
frame is worked out when the frame comes, while the arm moves, and is there when it is asked for:
the points that are followed, whether the camera stands still, the planes of the moving surface.
"""

from __future__ import annotations

from importlib import import_module

from akm_fg.estimation.fit import one_blas_thread
from akm_fg.records import CalibrationErrors, RgbdFrame
from akm_fg.stages import ModelSettings, RecordingFit, Stages
from akm_fg.stream.seen_so_far import Hand, SeenSoFar


class AnsweringStream:
    """What `FrameStream.posterior` says, without a state of every frame as it comes.

    Args:
        name: of the posterior, and in messages.
        settings: how the frames are modelled.
        stages: who masks, tracks and estimates.
        calibration: what is not known of the camera.
    """

    def __init__(
        self,
        name: str = "stream",
        settings: ModelSettings | None = None,
        stages: Stages | None = None,
        calibration: CalibrationErrors | None = None,
    ) -> None:
        """No frame yet."""
        one_blas_thread()  # looks through all libraries once: not in the first frame's time
        import_module("sklearn.cluster")  # a second: not when something moves for the first time
        self._seen = SeenSoFar(name, settings, stages, calibration)

    def add(self, frame: RgbdFrame, hand: Hand | None = None) -> None:
        """Take in the next frame.

        Args:
            frame: later than the last one.
            hand: the gripper at that time, where it is known.

        Raises:
            TracksLost: no object is seen in the first frame; the next one is the first again.
        """
        self._seen.watch(frame, hand)
        self._seen.prepare()

    def posterior(self) -> RecordingFit:
        """What was seen and what it means: what `fit_recording` says of the same frames.

        Raises:
            TracksLost: nothing on the object could be followed and depth shows no motion.
            NoMotionObserved: nothing moved beyond the noise.
            AxisUnobservable: no moving kind can be fitted.
        """
        return self._seen.answer()
