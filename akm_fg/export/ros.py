"""A part's joint as text of ROS 2 messages, for `ros2 topic pub TOPIC TYPE TEXT`.

The text is JSON, which is YAML too. `geometry_msgs/msg/PoseWithCovarianceStamped` holds the joint's
frame, whose z is the axis; its covariance is that of a position and a rotation about the fixed axes
of the frame it is given in, translation first (the message's own comment), while the posterior's is
of a right increment, rotation first. With the frame's rotation R the two are

    (dp, dtheta) = (R v, R w),   cov_ros = J cov J^T,   J = [[0, R], [R, 0]].
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from akm_fg.model.records import ModelPart
from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
STATE = "sensor_msgs/msg/JointState"


def ros_messages(part: ModelPart, frame: str = "world") -> tuple[tuple[str, str], ...]:
    """Types and texts: the joint's frame, and its last known state from the closed one.

    Args:
        part: of a model.
        frame: name of the frame that the model's world is.
    """
    messages = [(POSE, _text(_pose(part.joint, frame)))]
    states = part.states
    if states is not None and states.last_seen is not None:
        q = float(states.mean[states.last_seen]) - part.closed_state
        state = {"header": _header(frame), "name": [f"{part.name}-joint"], "position": [q]}
        messages.append((STATE, _text(state)))
    return tuple(messages)


def _text(fields: dict[str, Any]) -> str:
    return json.dumps(fields, allow_nan=False)


def _header(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def _pose(joint: JointPosterior, frame: str) -> dict[str, Any]:
    T = joint.T_world_joint
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    pose = {
        "position": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
        "orientation": {"x": x, "y": y, "z": z, "w": w},
    }
    covariance = ros_covariance(joint).ravel().tolist()
    return {"header": _header(frame), "pose": {"pose": pose, "covariance": covariance}}


def ros_covariance(joint: JointPosterior) -> FloatArray:
    """(6, 6) of position and rotation about fixed axes; see the module."""
    R = joint.T_world_joint[:3, :3]
    J = np.zeros((6, 6))
    J[:3, 3:] = J[3:, :3] = R
    return np.asarray(J @ joint.cov @ J.T)
