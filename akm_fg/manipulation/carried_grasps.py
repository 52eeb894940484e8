"""Grasps of a part at the state it is in: those that held before, carried along the joint.

A grasp that held at state q_0 is at M(q - q_0) T there, with the covariance of `predict_pose`. What
of it lies along the fingers' opening must fit between them; what lies along the approach is felt
for. Fingers that hold a bar hold it as well turned about their opening, a little about the bar, and
with the hand the other way round; of what stands open the free edge is held, too
(`akm_fg.manipulation.board_grasps`): whichever of these the arm can go on with farthest is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np

from akm_fg.errors import MotionInfeasible
from akm_fg.grasping.between import between
from akm_fg.interfaces import Arm
from akm_fg.manipulation.board_grasps import BoardGrasp, board_grasps
from akm_fg.manipulation.config import HoldConfig
from akm_fg.model.records import ModelPart
from akm_fg.planning.move_length import LEVEL
from akm_fg.prediction import predict_pose
from akm_fg.records import FloatArray, RgbdFrame


class FreshGrasps(Protocol):
    """Grasps about a place, as a frame shows it, best first."""

    def __call__(
        self, frame: RgbdFrame, p_world: FloatArray, normal_world: FloatArray
    ) -> Sequence[gtsam.Pose3]:
        """T_world_grasp each; none where the fingers find no hold."""
        ...


@dataclass(frozen=True, slots=True)
class CarriedGrasp:
    """A grasp at the state the part is in."""

    T_world_grasp: gtsam.Pose3
    opening_m: float  # 95 % bound of where the handle is, along the fingers' opening
    depth_m: float  # and along the approach
    board: BoardGrasp | None = None  # where it is of a front's edge


@dataclass(frozen=True, slots=True)
class ChosenGrasp:
    """A grasp that the arm can take."""

    grasp: CarriedGrasp
    reach: float  # share of the way to the target that it can go from there


def carried(part: ModelPart, q: float, q_sd: float, config: HoldConfig) -> list[CarriedGrasp]:
    """The grasps of a part's contacts at a state, the best tried first."""
    order = sorted(part.contacts, key=lambda contact: contact.failed - contact.succeeded)
    found = []
    for contact in order:
        T_part_grasp = not_so_deep(contact.T_part_grasp, part.surface.p_world, config)
        there = part.T_world_part(contact.state) * T_part_grasp
        pose = predict_pose(part.joint, q - contact.state, there, q_sd)
        sd = np.sqrt(np.maximum(np.diag(pose.cov)[3:], 0.0))
        T = gtsam.Pose3(pose.T_world_pose)
        found.append(CarriedGrasp(T, LEVEL * float(sd[1]), LEVEL * float(sd[2])))
    return found


def not_so_deep(T_part_grasp: gtsam.Pose3, p_part: FloatArray, config: HoldConfig) -> gtsam.Pose3:
    """The grasp, drawn back so far that the handle is between the fingers' tips.

    A hand that felt its way may have closed with the handle at its palm: there it cannot be sent
    again, by whoever sees the handle.
    """
    p = (p_part - T_part_grasp.translation()) @ T_part_grasp.rotation().matrix()
    between = (np.abs(p[:, 0]) < config.beside_m) & (np.abs(p[:, 1]) < config.gap_m / 2)
    # Towards the palm z is less than zero; behind the tips begins the front.
    between &= (p[:, 2] < -config.tips_m) & (p[:, 2] > -config.palm_m)
    if between.sum() < config.least_points:
        return T_part_grasp
    back_m = max(-config.depth_m - float(np.percentile(p[between, 2], 10.0)), 0.0)
    return T_part_grasp * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -back_m]))


def variants(T_world_grasp: gtsam.Pose3, config: HoldConfig) -> Iterator[gtsam.Pose3]:
    """Other ways to hold the same bar, the likest first; the grasp itself is the first."""
    turns = sorted(
        itertools.product(config.along_rad, config.about_rad, (0.0, np.pi)),
        key=lambda each: abs(each[0]) + 1.5 * abs(each[1]) + 0.1 * each[2],
    )
    for along, about, flip in turns:
        turn = gtsam.Rot3.Ry(along) * gtsam.Rot3.Rx(about) * gtsam.Rot3.Rz(flip)
        yield T_world_grasp * gtsam.Pose3(turn, np.zeros(3))


def choose_grasp(
    arm: Arm,
    part: ModelPart,
    q: float,
    q_sd: float,
    q_target: float,
    fresh: Sequence[gtsam.Pose3],
    lost: Sequence[gtsam.Pose3],
    config: HoldConfig,
) -> ChosenGrasp:
    """The first grasp with which the way to the target is within reach; else the farthest.

    Args:
        arm: is asked what it reaches.
        part: with its contacts.
        q: its state.
        q_sd: standard deviation of that.
        q_target: where it should be.
        fresh: grasps as they are seen now, T_world_grasp, best first; tried after the carried.
        lost: grasps that were lost or refused at this state: not again.
        config: tuning.

    Raises:
        MotionInfeasible: no grasp can be taken, or none leads anywhere; or where the handle is, is
            not known well enough for the fingers.
    """
    known = carried(part, q, q_sd, config)
    wide = [each for each in known if 2 * each.opening_m > config.gap_m - config.handle_m]
    if known and len(wide) == len(known) and not fresh:
        raise MotionInfeasible(
            f"the handle is known to +-{1e3 * wide[0].opening_m:.0f} mm, more than fingers open"
        )
    usable = [each for each in known if each not in wide]
    tried: list[CarriedGrasp] = []
    best: ChosenGrasp | None = None
    refusal: MotionInfeasible | None = None
    boards = _boards(part, q, usable, config)
    for grasp in _in_turn(usable, fresh, boards, config):
        if any(_same(grasp.T_world_grasp, T) for T in lost):
            continue
        if len(tried) >= config.most_grasps:
            break
        tried.append(grasp)
        try:
            reach = arm.reachable(
                grasp.T_world_grasp, way_of(part, grasp.T_world_grasp, q, q_target, config)
            )
        except MotionInfeasible as error:
            refusal = refusal or error
            continue
        reach = min(reach, room_for(part, grasp.board, q, q_target, config))
        if best is None or reach > best.reach:
            best = ChosenGrasp(grasp, reach)
        if reach >= config.enough:
            break
    if best is None:
        raise refusal or MotionInfeasible("no grasp of the part is known or seen")
    if best.reach < config.least:
        raise MotionInfeasible(f"no grasp goes farther than {100 * best.reach:.0f} % of the way")
    return best


def way_of(
    part: ModelPart, T_world_hand: gtsam.Pose3, q: float, q_target: float, config: HoldConfig
) -> list[gtsam.Pose3]:
    """Hand poses on the way from one state to another."""
    steps = np.linspace(0.0, q_target - q, config.way_poses + 1)[1:]
    R, t = part.joint.joint.motion(steps)
    return [gtsam.Pose3(gtsam.Rot3(R[k]), t[k]) * T_world_hand for k in range(len(steps))]


def room_for(
    part: ModelPart, board: BoardGrasp | None, q: float, q_target: float, config: HoldConfig
) -> float:
    """Share of the way on which the hand has room behind the front whose edge it holds."""
    if board is None:
        return 1.0
    steps = np.linspace(q, q_target, config.way_poses + 1)[1:]
    room = [board.opening_m(part, float(step)) >= config.board.room_m for step in steps]
    return (room.index(False) if False in room else len(room)) / len(room)


def _boards(
    part: ModelPart, q: float, known: Sequence[CarriedGrasp], config: HoldConfig
) -> Iterator[CarriedGrasp]:
    """Edges of the front, where it stands open, as sure as the handles are."""
    if not known:
        return
    opening_m, depth_m = known[0].opening_m, known[0].depth_m
    for board in board_grasps(part, config.board):
        if board.opening_m(part, q) >= config.board.room_m:
            T = part.T_world_part(q) * board.T_part_grasp
            yield CarriedGrasp(T, opening_m, depth_m, board)


def _in_turn(
    known: Sequence[CarriedGrasp],
    fresh: Sequence[gtsam.Pose3],
    boards: Iterator[CarriedGrasp],
    config: HoldConfig,
) -> Iterator[CarriedGrasp]:
    """Carried as they held, a few as they are seen, then edges, then the carried ones turned."""
    depth_m = max([each.depth_m for each in known], default=config.feel_m)
    yield from known
    for T in fresh[: config.most_grasps // 3]:
        yield CarriedGrasp(T, 0.0, depth_m)
    yield from itertools.islice(boards, config.most_boards)
    for each in known:
        for T in itertools.islice(variants(each.T_world_grasp, config), 1, None):
            yield CarriedGrasp(T, each.opening_m, each.depth_m)
    for T in fresh[config.most_grasps // 3 :]:
        yield CarriedGrasp(T, 0.0, depth_m)


def _same(one: gtsam.Pose3, other: gtsam.Pose3) -> bool:
    apart_m, turn_rad = between(one, other)
    return apart_m < SAME_M and turn_rad < SAME_RAD


SAME_M = 0.01  # grasps nearer than this fail for the same reason
SAME_RAD = 0.2
