"""The calibration as one factor graph.

Variables: intrinsics K (Cal3DS2), T_mount_cam, T_holder_board, and for every view the robot's true
pose T_mount_holder, which its reported pose is a prior for. Factors: the corners of each view
(`factors.measurements.board_view`), one prior a view from the arm's stated repeatability, and one
that holds what is not estimated of K. Corner noise is a Student-t whose scale is estimated.

Covariance. The corners' share of the information is divided by the sandwich factor of their
residuals (`factors.student_t.covariance_factor`); that of the robot's poses is taken as stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.calibration.covariance import JointCovariance, OpenDirection, joint_covariance
from akm_fg.calibration.initial import Start, reported_mount_holder
from akm_fg.calibration.records import CalibrationConfig, CalibrationViews
from akm_fg.errors import AxisUnobservable
from akm_fg.records import FloatArray
from factors.measurements.board_view import INTRINSICS, board_view_factor, board_view_residual
from factors.student_t import covariance_factor, weight

K, CAM, BOARD = gtsam.symbol("k", 0), gtsam.symbol("c", 0), gtsam.symbol("b", 0)
HELD_PRECISION = 1e12  # of an intrinsic that is not estimated: 1e-6 pixels
SCALE_ROUNDS = 20
SCALE_TOLERANCE = 1e-3  # relative; a tenth of a percent of an sd is beyond what anyone reads
CORNER_SCALE_START_PX = 0.5


@dataclass(frozen=True, slots=True)
class GraphFit:
    """The optimum, its covariances and residuals."""

    values: gtsam.Values
    intrinsics_cov: FloatArray  # (9, 9) in the order of Cal3DS2
    cam_cov: FloatArray  # (6, 6)
    board_cov: FloatArray  # (6, 6)
    errors_px: tuple[FloatArray, ...]  # (N, 2) a view
    robot_errors: FloatArray  # (V, 6) rad and m: reported against estimated poses
    robot_information: FloatArray  # (V, 6, 6) of these, as stated
    robot_misfit: float  # their squared Mahalanobis length, summed
    robot_misfit_dof: float  # what it should be
    scale_px: float  # of the Student-t

    @property
    def intrinsics(self) -> FloatArray:
        """(9,) in the order of Cal3DS2."""
        return self.values.atCal3DS2(K).vector()


def holder_key(view: int) -> int:
    """Key of T_mount_holder of a view."""
    return gtsam.symbol("h", view)


def solve(data: CalibrationViews, config: CalibrationConfig, start: Start) -> GraphFit:
    """Find the most probable calibration and its covariance.

    Raises:
        AxisUnobservable: the views leave a direction of a variable open.
    """
    problem = _Problem(data, config, start)
    values = problem.first_values()
    scale = config.corner_scale_px or CORNER_SCALE_START_PX
    try:
        for _ in range(SCALE_ROUNDS):
            graph = problem.graph(scale)
            values = gtsam.LevenbergMarquardtOptimizer(graph, values, _by_qr()).optimize()
            fitted = problem.dof_of_fit(joint_covariance(graph, values))
            if config.corner_scale_px is not None:
                break
            before, scale = scale, problem.scale(values, scale, fitted)
            if abs(scale / before - 1.0) < SCALE_TOLERANCE:
                break
        return _summary(problem, values, scale, fitted)
    except OpenDirection as error:
        raise _open(data.name, error.key) from error
    except RuntimeError as error:  # GTSAM's word for a singular system; it names the key
        named = [key for key in (K, CAM, BOARD) if str(key) in str(error)]
        raise _open(data.name, named[0] if named else CAM) from error


def _by_qr() -> gtsam.LevenbergMarquardtParams:
    """Pixels, metres and distortion differ too much in scale for Cholesky."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    return parameters


def _open(name: str, key: int) -> AxisUnobservable:
    names = {K: "the intrinsics", BOARD: "the board's pose"}
    what = names.get(key, "the camera's pose")
    return AxisUnobservable(
        f"{name}: the views leave {what} open; expected the board at several distances and tilts, "
        "in gripper poses that turn about two or more axes"
    )


class _Problem:
    """The parts of the graph that stay the same while the noise scale changes."""

    def __init__(self, data: CalibrationViews, config: CalibrationConfig, start: Start) -> None:
        self.data, self.config, self.start = data, config, start
        self.p_boards = data.p_boards
        self.reported = reported_mount_holder(data, config)
        self.robot_noise = [robot_noise(T, config) for T in self.reported]

    def first_values(self) -> gtsam.Values:
        values = gtsam.Values()
        values.insert(K, gtsam.Cal3DS2(self.start.intrinsics))
        values.insert(CAM, self.start.T_mount_cam)
        values.insert(BOARD, self.start.T_holder_board)
        for i, T in enumerate(self.reported):
            values.insert(holder_key(i), T)
        return values

    def graph(self, scale_px: float, count_as_one: float = 1.0) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        held = gtsam.noiseModel.Diagonal.Precisions(HELD_PRECISION * _held(self.config))
        graph.add(gtsam.PriorFactorCal3DS2(K, gtsam.Cal3DS2(self.start.intrinsics), held))
        for i, T in enumerate(self.reported):
            graph.add(gtsam.PriorFactorPose3(holder_key(i), T, self.robot_noise[i]))
            uv, p_board = self.data.views[i].uv, self.p_boards[i]
            noise = (scale_px, self.config.dof, count_as_one)
            graph.add(board_view_factor(K, CAM, holder_key(i), BOARD, p_board, uv, *noise))
        return graph

    def errors_px(self, values: gtsam.Values) -> list[FloatArray]:
        """(N, 2) a view: projected minus found."""
        poses = values.atPose3(CAM).matrix(), values.atPose3(BOARD).matrix()
        lens = values.atCal3DS2(K).vector()
        out = []
        for i, (view, p_board) in enumerate(zip(self.data.views, self.p_boards, strict=True)):
            holder = values.atPose3(holder_key(i)).matrix()
            e, _ = board_view_residual(lens, poses[0], holder, poses[1], p_board, view.uv)
            out.append(e)
        return out

    def robot_misfit_dof(self, cov: JointCovariance) -> float:
        """Expected squared Mahalanobis length of all reported against estimated poses.

        The deviation of a pose's estimate from its prior mean has covariance prior minus
        posterior, so each view contributes 6 - tr(prior^-1 posterior).
        """
        total = 0.0
        for i, noise in enumerate(self.robot_noise):
            posterior = cov.of(holder_key(i))
            total += 6.0 - float(np.trace(noise.information() @ posterior))
        return total

    def dof_of_fit(self, cov: JointCovariance) -> float:
        """Numbers that the corners determine: all that are free, less what the priors say."""
        free = 12.0 + 6.0 * len(self.reported) + float((_held(self.config) == 0.0).sum())
        priors = 6.0 * len(self.reported) - self.robot_misfit_dof(cov)
        return free - priors

    def scale(self, values: gtsam.Values, scale_px: float, fitted: float) -> float:
        """Maximum likelihood scale of the Student-t, corrected for the fitted numbers."""
        e2 = np.concatenate([(e * e).sum(axis=1) for e in self.errors_px(values)])
        for _ in range(SCALE_ROUNDS):
            w = weight(e2 / scale_px**2, self.config.dof, 2)
            scale_px = float(np.sqrt((w * e2).sum() / max(2.0 * e2.size - fitted, 1.0)))
        return scale_px


def _held(config: CalibrationConfig) -> FloatArray:
    """(9,) 1 where an intrinsic is kept, 0 where it is estimated."""
    if config.fixed_intrinsics:
        return np.ones(9)
    keep = {"skew"} if config.distortion else {"skew", "k1", "k2", "p1", "p2"}
    return np.array([float(name in keep) for name in INTRINSICS])


def robot_noise(
    T_mount_holder: gtsam.Pose3, config: CalibrationConfig
) -> gtsam.noiseModel.Gaussian:
    """Noise of T_mount_holder on its own tangent: the robot errs in the gripper's axes."""
    variances = np.repeat([config.robot_sd_rad**2, config.robot_sd_m**2], 3)
    if config.camera_place == "fixed":
        return gtsam.noiseModel.Diagonal.Variances(variances)
    # mount = gripper: (G Exp(xi))^-1 = G^-1 Exp(-Ad(G) xi).
    adjoint = T_mount_holder.inverse().AdjointMap()
    return gtsam.noiseModel.Gaussian.Covariance(adjoint @ np.diag(variances) @ adjoint.T)


def _summary(problem: _Problem, values: gtsam.Values, scale: float, fitted: float) -> GraphFit:
    errors = problem.errors_px(values)
    e2 = np.concatenate([(e * e).sum(axis=1) for e in errors])
    # Residuals are smaller than errors by what the fit has taken out.
    d2 = e2 / scale**2 * (2.0 * e2.size) / max(2.0 * e2.size - fitted, 1.0)
    if problem.config.corner_scale_px is None:
        count = covariance_factor(d2, problem.config.dof, 2)
    else:  # that of the noise as it is stated
        count = (problem.config.dof + 4.0) / (problem.config.dof + 2.0)
    cov = joint_covariance(problem.graph(scale, count), values)
    robot = np.array(
        [
            gtsam.Pose3.Logmap(T.between(values.atPose3(holder_key(i))))
            for i, T in enumerate(problem.reported)
        ]
    )
    misfit = sum(
        float(e @ n.information() @ e) for e, n in zip(robot, problem.robot_noise, strict=True)
    )
    return GraphFit(
        values=values,
        intrinsics_cov=cov.of(K),
        cam_cov=cov.of(CAM),
        board_cov=cov.of(BOARD),
        errors_px=tuple(errors),
        robot_errors=robot,
        robot_information=np.array([n.information() for n in problem.robot_noise]),
        robot_misfit=misfit,
        robot_misfit_dof=problem.robot_misfit_dof(cov),
        scale_px=scale,
    )
