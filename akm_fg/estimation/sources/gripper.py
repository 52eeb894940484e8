"""Gripper: where it was while it held the part, by the robot's own joints.

A first fit says where the part was in every frame, and so in which frames the gripper kept its
place in the part: those are holds, the same for all kinds. Each hold has one grasp, a variable of
the graph in GTSAM and marginalised in the Laplace approximation; its prior is flat and the same for
every kind, rigid included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import GraspConfig
from akm_fg.estimation.sources.source import (
    At,
    Contribution,
    FirstFit,
    LateSource,
    Part,
    Source,
    Term,
    information_of,
)
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray
from akm_fg.steps import Steps
from factors.joint_variables import JointVariables
from factors.measurements.grasp_pose import (
    grasp_log_normaliser,
    grasp_pose_factor,
    grasps_in_joint,
    hold_starts,
    typical_grasp,
)

if TYPE_CHECKING:
    from akm_fg.estimation.given.problem import FitProblem

GRIPPER = "gripper"
_LEAST_FRAMES = 2  # one alone says only where it is itself


@dataclass(frozen=True, slots=True)
class GripperPoses(LateSource):
    """Where the gripper was, in all frames of the input."""

    T_world_gripper: FloatArray  # (T, 4, 4); frames outside the hold are not looked at
    grasp_frames: tuple[int, int]  # first and last frame in which it holds
    noise: GraspConfig = field(default_factory=GraspConfig)

    def __post_init__(self) -> None:
        T, (first, last) = len(self.T_world_gripper), self.grasp_frames
        if self.T_world_gripper.shape != (T, 4, 4):
            raise ValueError(f"gripper poses {self.T_world_gripper.shape}, expected (T, 4, 4)")
        if not 0 <= first <= last < T:
            raise ValueError(f"grasp_frames {self.grasp_frames} outside 0..{T - 1}")

    def check(self, frames: int) -> None:
        """Refuse poses of another number of frames.

        Raises:
            ValueError: they are.
        """
        if len(self.T_world_gripper) != frames:
            raise ValueError(f"{len(self.T_world_gripper)} gripper poses, {frames} frames")

    def found(
        self, problem: FitProblem, first: FirstFit
    ) -> Steps[tuple[FitProblem, FirstFit] | None]:
        """The problem with the holds, judged by the first fit."""
        yield
        held = holds_of(self, problem.keyframes, first.guess, first.state_sd, first.as_one)
        return None if held is None else (problem.with_source(held), first)


@dataclass(frozen=True, slots=True)
class Hold:
    """Frames in which the gripper keeps its place in the part."""

    frames: NDArray[np.int_]  # (F,) of the graph
    T_world_gripper: FloatArray  # (F, 4, 4)


@dataclass(frozen=True, slots=True)
class GripperSource(Source):
    """The holds of a graph's frames."""

    holds: tuple[Hold, ...]
    noise: GraspConfig
    count_as_one: float  # frames that err together, over observations of the tracks that do
    name: ClassVar[str] = GRIPPER

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> GripperTerm:
        """The holds in one kind's graph."""
        return GripperTerm(self, guess, part.keyframes)

    def restricted(self, frames: NDArray[np.int_]) -> GripperSource | None:
        """Over some of the graph's frames."""
        holds = []
        for hold in self.holds:
            kept = np.isin(hold.frames, frames)
            if kept.sum() >= _LEAST_FRAMES:
                here = np.searchsorted(frames, hold.frames[kept])
                holds.append(Hold(here, hold.T_world_gripper[kept]))
        return replace(self, holds=tuple(holds)) if holds else None

    @property
    def own_frames(self) -> NDArray[np.int_]:
        """Those of the holds."""
        return np.unique(np.concatenate([hold.frames for hold in self.holds]))

    def moved(self, places: NDArray[np.int_]) -> GripperSource:
        """In another graph that has the holds' frames too."""
        holds = tuple(replace(hold, frames=places[hold.frames]) for hold in self.holds)
        return replace(self, holds=holds)

    def recounted(self, as_one: float) -> GripperSource:
        """Weighed for tracks of which so many observations count as one."""
        return replace(self, count_as_one=self.count_as_one / as_one)


def holds_of(
    gripper: GripperPoses,
    keyframes: NDArray[np.int_],
    guess: JointGuess,
    state_sd: FloatArray,
    as_one: float,
) -> GripperSource | None:
    """Where the gripper held, judged by a fit to the camera's data; None where that is nowhere.

    Args:
        gripper: its poses in all frames.
        keyframes: (K,) frames in the graph.
        guess: the fitted joint; rigid as a prismatic joint that stays at zero.
        state_sd: (K,) standard deviations of its states.
        as_one: observations of the tracks that count as one.
    """
    first, last = gripper.grasp_frames
    held = np.flatnonzero((keyframes >= first) & (keyframes <= last))
    if held.size < _LEAST_FRAMES:
        return None
    poses, noise = gripper.T_world_gripper[keyframes[held]], gripper.noise
    grasps = grasps_in_joint(guess.joint, guess.q[held], poses)
    turn, slide = _state_noise(guess, grasps, float(np.median(state_sd[held])))
    starts = hold_starts(
        grasps,
        math.hypot(noise.sigma_rot_rad, turn),
        math.hypot(noise.sigma_trans_m, slide),
        noise.dof,
    )
    holds = tuple(
        Hold(held[a:b], poses[a:b])
        for a, b in pairwise([*starts.tolist(), held.size])
        if b - a >= _LEAST_FRAMES
    )
    return GripperSource(holds, noise, noise.frames_as_one / as_one) if holds else None


def _state_noise(guess: JointGuess, grasps: FloatArray, sd: float) -> tuple[float, float]:
    """What the states' noise adds to the grasps', radians and metres."""
    if not guess.kind.turns:
        return 0.0, sd
    lever = float(np.median(np.hypot(grasps[:, 0, 3], grasps[:, 1, 3])))
    return sd, sd * math.hypot(lever, guess.joint.pitch)


class GripperTerm(Term):
    """The holds in one kind's graph, each with its grasp."""

    name = GRIPPER

    def __init__(
        self, source: GripperSource, guess: JointGuess, keyframes: NDArray[np.int_]
    ) -> None:
        self._source, self._guess, self._keyframes = source, guess, keyframes

    @property
    def own(self) -> Mapping[int, int]:
        """One grasp a hold."""
        return {_grasp_key(i): 6 for i in range(len(self._source.holds))}

    def insert(self, values: gtsam.Values) -> None:
        """The grasps that the frames of each hold agree on under the guess."""
        noise = self._source.noise
        for i, hold in enumerate(self._source.holds):
            q = self._guess.q[hold.frames]
            each = grasps_in_joint(self._guess.joint, q, hold.T_world_gripper)
            start = typical_grasp(each, noise.sigma_rot_rad, noise.sigma_trans_m)
            values.insert(_grasp_key(i), gtsam.Pose3(start))

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """One a hold; nothing moved: a prismatic joint with no state free."""
        noise = self._source.noise
        return [
            grasp_pose_factor(
                variables.kind,
                variables.joint_key,
                _grasp_key(i),
                [variables.state_keys[t] for t in hold.frames],
                hold.T_world_gripper,
                noise.sigma_rot_rad,
                noise.sigma_trans_m,
                noise.dof,
                variables.pitch_key,
                self._source.count_as_one,
            )
            for i, hold in enumerate(self._source.holds)
        ]

    def contribution(self, at: At, freedom: float) -> Contribution:
        """What the holds say, their grasps marginalised."""
        factors = self.factors(at.variables, 1.0)
        information, held, own_log_det = information_of(factors, at, self.own)
        error = sum(factor.error(at.values) for factor in factors)
        ends = (self._keyframes[hold.frames[[0, -1]]] for hold in self._source.holds)
        return Contribution(
            information=information,
            held=held,
            log_likelihood=self._log_normaliser() - error,
            own_variables=sum(self.own.values()),
            own_log_det=own_log_det,
            variance_fixed=self._variance_ratio(),
            report={"holds": tuple((int(first), int(last)) for first, last in ends)},
        )

    def _variance_ratio(self) -> float:
        """Of the claimed noise: one in `frames_as_one` counts, whatever the graph counts.

        The weighted Gauss-Newton information of p-dimensional Student-t noise is (dof + p + 2) /
        (dof + p) times the Fisher information (Lange, Little and Taylor, 1989).
        """
        noise = self._source.noise
        return noise.frames_as_one / self._source.count_as_one * (noise.dof + 8) / (noise.dof + 6)

    def _log_normaliser(self) -> float:
        noise = self._source.noise
        frames = sum(hold.frames.size for hold in self._source.holds)
        one = grasp_log_normaliser(frames, noise.sigma_rot_rad, noise.sigma_trans_m, noise.dof)
        return one / self._source.count_as_one


def _grasp_key(hold: int) -> int:
    """Key of T_joint_grasp of a hold."""
    return int(gtsam.symbol("g", hold))
