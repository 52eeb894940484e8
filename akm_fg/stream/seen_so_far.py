"""All that was seen of an object so far, and what it means: what a recording and a stream share.

Frames are looked at as they come; the joint is estimated from the frames that are kept (see
`akm_fg.perception.kept_frames`), at the end of a recording or in between, in one go or in steps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.calibrated import calibrated, length_error
from akm_fg.errors import AxisUnobservable, InsufficientData, TracksLost
from akm_fg.estimation.fit import one_blas_thread
from akm_fg.perception.observe import MotionObserver
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.rig.depth_against_colour import depth_unit_doubts
from akm_fg.perception.rig.unseen import unseen_doubts
from akm_fg.perception.surface.remembered_planes import RememberedPlanes
from akm_fg.perception.tracking.track_store import SeenPoints
from akm_fg.posterior import ArticulationPosterior, doubted
from akm_fg.records import (
    BoolArray,
    CalibrationErrors,
    CameraCorrection,
    Doubt,
    Recording,
    RgbdFrame,
)
from akm_fg.stages import JointEstimator, ModelSettings, RecordingFit, Sources, Stages
from akm_fg.steps import Steps, to_end
from akm_fg.stream.gripper_state import with_gripper_states
from akm_fg.stream.hand_path import with_hand_path
from akm_fg.stream.joint_estimate import JointEstimate, estimate_in_steps
from akm_fg.stream.kinds_by_hand import with_kinds_by_hand
from akm_fg.stream.rig_doubts import RigDoubts, told_with
from akm_fg.stream.surface_state import with_surface_states
from factors.joint import JointKind


@dataclass(frozen=True, slots=True)
class Hand:
    """The gripper at the time of a frame."""

    T_world_gripper: gtsam.Pose3
    holding: bool  # something was between the closed fingers


class SeenSoFar:
    """Watches frames, and tells their posterior.

    Args:
        name: of the posterior, and in messages.
        settings: how the frames are modelled.
        stages: who masks, tracks and estimates.
        calibration: what is not known of the camera, for the posterior to hold.
    """

    def __init__(
        self,
        name: str,
        settings: ModelSettings | None = None,
        stages: Stages | None = None,
        calibration: CalibrationErrors | None = None,
    ) -> None:
        self.name, self.settings = name, settings or ModelSettings()
        self.stages = stages = stages or Stages()
        self._observer = MotionObserver(
            self.settings.perception.observe,
            self.settings.seed,
            stages.segmenter,
            stages.tracker,
        )
        self._hands: list[Hand | None] = []
        self._grasp: tuple[int, int] | None = None  # first stretch of frames in which it holds
        self._watching_s = 0.0
        self._rig = RigDoubts(self.settings.perception)
        self._calibration = calibration
        self._planes = RememberedPlanes()

    @property
    def frames(self) -> int:
        """Frames so far."""
        return len(self._observer.store)

    @property
    def numbers(self) -> NDArray[np.int_]:
        """(K,) of the frames whose images are kept, growing."""
        return self._observer.kept.numbers

    @property
    def points(self) -> int:
        """Points that were followed so far."""
        return self._observer.store.points

    def watch(
        self, frame: RgbdFrame, hand: Hand | None = None, object_mask: BoolArray | None = None
    ) -> SeenPoints:
        """Look at the next frame.

        Args:
            frame: of a camera that stands still, or whose pose in every frame is known.
            hand: the gripper at that time, where it is known.
            object_mask: (H, W) the object in it, where that is known.

        Raises:
            TracksLost: no object is seen in the first frame; the next one is the first again.
        """
        began, number = time.perf_counter(), self.frames
        first, last = (number, number - 1) if self._grasp is None else self._grasp
        held = hand is not None and hand.holding and last == number - 1
        at = hand.T_world_gripper.translation() if held and hand is not None else None
        try:
            seen = self._observer.watch(frame, object_mask, at)
        except TracksLost as error:
            doubts = depth_unit_doubts(frame, self.settings.perception.rig.depth)
            raise told_with(error, doubts) from error
        if not self._hands:
            self._take_measured_noise()
        self._hands.append(hand)
        if held:
            self._grasp = first, number
        self._watching_s += time.perf_counter() - began
        return seen

    def prepare(self) -> None:
        """What an answer will want of the newest frame, whatever comes after it."""
        began = time.perf_counter()
        kept, seen = self._observer.kept.frames, self._observer
        with one_blas_thread():
            if len(kept) > 1:
                noise = seen.config.noise
                self._rig.prepare(self.frames - 1, kept[-1], kept[0], seen.object_mask, noise)
            self._planes.prepare(kept)
        self._watching_s += time.perf_counter() - began

    def _take_measured_noise(self) -> None:
        """What the first frame shows of the depth's noise is believed by all that comes after."""
        perception = self.settings.perception
        observe = replace(perception.observe, noise=self._observer.config.noise)
        perception = replace(perception, observe=observe)
        self.settings = replace(self.settings, perception=perception)

    def estimate_in_steps(self, sources: Sources | None = None) -> Steps[JointEstimate]:
        """The joint from what was seen until the first step, over the frames that are kept.

        Args:
            sources: what is asked; as the settings say if not given.

        Raises:
            InsufficientData: see `answer`.
        """
        clip, numbers = self._clip(), self.numbers
        settings = self._settings_of(clip)
        settings = replace(settings, sources=sources or settings.sources)
        observed = yield from self._observer.observed_in_steps(numbers)
        yield
        return (yield from estimate_in_steps(clip, observed, settings, self._planes))

    def answer(self) -> RecordingFit:
        """What was seen so far and what it means, over all frames.

        Raises:
            TracksLost: nothing on the object could be followed and depth shows no motion.
            NoMotionObserved: nothing moved beyond the noise.
            AxisUnobservable: no moving kind can be fitted.
        """
        began = time.perf_counter()
        with one_blas_thread():
            given = self.stages.estimator
            try:
                fit = self._estimated() if given is None else self._given(given)
            except InsufficientData as error:
                doubts = [*self._doubts_of_input(), *self._unseen()]
                raise told_with(error, doubts) from error
            except np.linalg.LinAlgError as error:
                open_ = f"{self.name}: the data leave a joint or state open ({error})"
                raise told_with(AxisUnobservable(open_), self._doubts_of_input()) from error
            fit = self._calibrated(*self._checked(fit))
        fit_s = time.perf_counter() - began
        watching_s = self._watching_s
        times = {"total": watching_s + fit_s, "perception": watching_s, "fit": fit_s}
        return replace(fit, posterior=replace(fit.posterior, time_s=times))

    def _calibrated(self, fit: RecordingFit, free: bool) -> RecordingFit:
        """With what is not known of the camera, and what the hand that holds tells."""
        if self._calibration is None:
            return fit
        first, config = self._observer.kept.frames[0], self.settings.fit
        posterior = calibrated(fit.posterior, self._calibration, first.T_world_cam, first.camera)
        held = self._held_hands() if config.hand_path is not None else {}
        slide = posterior.alternatives.get(str(JointKind.PRISMATIC))
        length_sd = 0.0
        if slide is not None and slide.joint is not None:
            T_cam_joint = first.T_world_cam.inverse().matrix() @ slide.joint.T_world_joint
            length_sd = length_error(T_cam_joint, self._calibration, first.camera)
        if config.hand_path is not None:
            posterior = with_kinds_by_hand(posterior, held, length_sd, config, free)
        joint = posterior.best.joint
        if joint is None:
            return replace(fit, posterior=posterior)
        seen = fit.posterior.alternatives[str(joint.kind)].joint
        assert seen is not None
        if config.hand_path is not None:
            told = with_hand_path(posterior, seen, held, length_sd, config.hand_path)
            if told is not None:
                return RecordingFit(fit.observed, told.posterior, told.correction, told.carried)
        slides = 0.0 if joint.turns else length_sd
        correction = CameraCorrection(gtsam.Pose3(), seen.cov, 0.0, slides)
        return replace(fit, posterior=posterior, correction=correction)

    def _held_hands(self) -> dict[int, gtsam.Pose3]:
        """T_world_gripper by the frames of the first stretch in which it holds."""
        first, last = (0, -1) if self._grasp is None else self._grasp
        held = range(first, last + 1)
        return {k: hand.T_world_gripper for k in held if (hand := self._hands[k])}

    def _doubts_of_input(self) -> list[Doubt]:
        seen, clip = self._observer, self._clip()
        return self._rig.of_input(clip, self.numbers, seen.object_mask, seen.config.noise)

    def _unseen(self) -> list[Doubt]:
        """Why nothing may have been found, if the camera does not see the object."""
        share = self.settings.perception.rig.without_depth
        return unseen_doubts(self._clip().frames, self._observer.object_mask, share)

    def _checked(self, fit: RecordingFit) -> tuple[RecordingFit, bool]:
        """With what speaks against it; whether nothing of that takes its ground away."""
        noise, posterior = self._observer.config.noise, fit.posterior
        doubts = self._doubts_of_input()
        doubts += self._rig.of_answer(self._clip(), self.numbers, posterior, noise)
        free = not any(doubt.decides for doubt in doubts)
        return replace(fit, posterior=doubted(posterior, doubts)), free

    def _estimated(self) -> RecordingFit:
        """By the default estimator; frames that are not kept get their states beside the graph."""
        estimate = to_end(self.estimate_in_steps())
        numbers, store = self.numbers, self._observer.store
        if numbers.size < self.frames:
            points = store.point_tracks().select(estimate.members)
            fitted = estimate.fitted.over_frames(points, numbers)
            observed = self._of_all_frames(estimate.observed)
            estimate = replace(estimate, fitted=fitted, observed=observed)
        images = dict(zip(numbers.tolist(), self._observer.kept.frames, strict=True))
        noise = self.settings.perception.observe.noise
        posterior = with_surface_states(
            estimate.posterior(), estimate.fitted, images, noise, self.settings.stream.surface_state
        )
        return RecordingFit(estimate.observed, self._by_hand(posterior))

    def _by_hand(self, posterior: ArticulationPosterior) -> ArticulationPosterior:
        """With states of frames in which the part is hidden, where the gripper's poses are used."""
        grasp = self.settings.fit.grasp
        if grasp is None or self._grasp is None:
            return posterior
        hands = {k: T.translation() for k, T in self._held_hands().items()}
        return with_gripper_states(posterior, hands, grasp, self.settings.stream.gripper_state)

    def _given(self, estimator: JointEstimator) -> RecordingFit:
        """By another estimator; frames that are not kept have no state."""
        clip, numbers = self._clip(), self.numbers
        fit = estimator(clip, self._observer.observed(numbers), self._settings_of(clip))
        if numbers.size == self.frames:
            return fit
        posterior = fit.posterior.over_frames(numbers, self.frames)
        return RecordingFit(self._of_all_frames(fit.observed), posterior)

    def _of_all_frames(self, observed: ObservedMotion) -> ObservedMotion:
        store = self._observer.store
        return replace(observed, tracks=store.point_tracks(), pixels=store.pixel_tracks())

    def _clip(self) -> Recording:
        """The frames that are kept."""
        kept = self._observer.kept
        hands = [self._hands[k] for k in kept.numbers]
        known = [hand.T_world_gripper for hand in hands if hand is not None]
        poses = tuple(known) if len(known) == len(hands) else None
        first, last = (0, -1) if self._grasp is None else self._grasp
        held = np.flatnonzero((kept.numbers >= first) & (kept.numbers <= last))
        grasp_frames = (int(held[0]), int(held[-1])) if held.size else None
        return Recording(self.name, kept.frames, None, poses, grasp_frames)

    def _settings_of(self, clip: Recording) -> ModelSettings:
        """With the stamps of the frames that are kept, where the states' motion needs any."""
        states = self.settings.states
        if states is None or states.stamps_s is None:
            return self.settings
        stamps_s = np.array([frame.stamp_s for frame in clip.frames])
        return replace(self.settings, states=replace(states, stamps_s=stamps_s))


def hands_of(recording: Recording) -> list[Hand | None]:
    """The gripper at the time of each frame; None where it is not known."""
    poses = recording.T_world_gripper
    if poses is None:
        return [None] * len(recording.frames)
    first, last = recording.grasp_frames or (0, -1)
    return [Hand(pose, first <= t <= last) for t, pose in enumerate(poses)]
