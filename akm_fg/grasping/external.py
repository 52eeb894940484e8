"""Grasps by another program, such as AnyGrasp, that runs as its own process.

The program is called with two paths more than its configured command: of a file to read and of one
to write. It reads an npz with

    points_cam (N, 3) float32, metres, camera axes (x right, y down, z forward), of the object and
        of what is around the contact; colours (N, 3) uint8; on_object (N,) bool;
    contact_cam (3,), normal_cam (3,) out of the object; T_world_cam (4, 4); max_width_m ();

and writes JSON: `{"grasps": [{"T_cam_grasp": [[4x4]], "score": 0..1, "width_m": 0.02}]}`, poses of
the point between the fingertips, z the way of the approach and y along the fingers' opening.
(AnyGrasp's own axes are x approach, y opening, and its depth goes along x: a wrapper turns them.)
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.errors import InputError, MissingDependency
from akm_fg.grasping.local_cloud import local_cloud
from akm_fg.interfaces import GraspCandidate
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

EXPECTED = 'JSON {"grasps": [{"T_cam_grasp": 4x4, "score": 0..1, "width_m": metres}]}'


@dataclass(frozen=True, slots=True)
class ExternalGraspsConfig:
    """The program, and what of its answers is taken."""

    command: tuple[str, ...] = ()  # program and arguments, before the two paths
    timeout_s: float = 60.0  # the first call may load weights
    around_m: float = 0.25  # half side of the cube about the contact that it is shown
    near_m: float = 0.05  # the paper takes the grasp nearest to the contact
    max_width_m: float = 0.08  # of the Franka hand
    most: int = 20

    def __post_init__(self) -> None:
        numbers = (self.timeout_s, self.around_m, self.near_m, self.max_width_m)
        if not all(np.isfinite(x) and x > 0 for x in numbers) or self.most < 1:
            raise ValueError(f"{numbers}, {self.most}: expected numbers above 0")


class ExternalSampler:
    """A `GraspSampler` that asks another process."""

    def __init__(self, config: ExternalGraspsConfig) -> None:
        """Takes the command; it is not tried before it is needed.

        Raises:
            MissingDependency: no command is configured.
        """
        if not config.command:
            raise MissingDependency(
                "grasps by another program want its command: stages.own.anygrasp.command"
            )
        self.config = config

    def sample(
        self,
        frame: RgbdFrame,
        mask: BoolArray,
        p_world_contact: FloatArray,
        normal_world: FloatArray,
        *,
        at_edge: bool = False,
    ) -> tuple[GraspCandidate, ...]:
        """See `akm_fg.interfaces.GraspSampler`. The program looks for itself what is at an edge.

        Raises:
            MissingDependency: the program is not there.
            InputError: it fails, takes too long, or writes something else.
        """
        c = self.config
        cloud = local_cloud(frame, mask, p_world_contact, c.around_m)
        T, uv = frame.T_world_cam, cloud.pixels
        with tempfile.TemporaryDirectory(prefix="akm-fg-grasps-") as folder:
            asked, answer = Path(folder) / "in.npz", Path(folder) / "out.json"
            np.savez(
                asked,
                points_cam=T.transformTo(cloud.p_world.T).T.astype(np.float32).reshape(-1, 3),
                colours=frame.rgb[uv[:, 1], uv[:, 0]],
                on_object=cloud.on_object,
                contact_cam=T.transformTo(p_world_contact),
                normal_cam=T.rotation().unrotate(normal_world),
                T_world_cam=T.matrix(),
                max_width_m=c.max_width_m,
            )
            self._run(asked, answer)
            grasps = self._read(answer, T)
        near = [g for g in grasps if _off(g, p_world_contact) < c.near_m]
        return tuple(sorted(near, key=lambda g: -g.quality)[: c.most])

    def _run(self, asked: Path, answer: Path) -> None:
        command = [*self.config.command, str(asked), str(answer)]
        name = self.config.command[0]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=self.config.timeout_s, check=False
            )
        except (FileNotFoundError, PermissionError) as error:
            raise MissingDependency(
                f"grasps by another program: {name}: {error.strerror}"
            ) from error
        except subprocess.TimeoutExpired as error:
            took = f"no answer in {self.config.timeout_s:g} s"
            raise InputError(name, took, EXPECTED) from error
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["nothing on standard error"])[-1]
            raise InputError(name, f"exit code {done.returncode} ({last})", EXPECTED)

    def _read(self, answer: Path, T_world_cam: gtsam.Pose3) -> list[GraspCandidate]:
        name = self.config.command[0]
        try:
            content = json.loads(answer.read_text(encoding="utf-8"))
            return [self._grasp(item, T_world_cam) for item in content["grasps"]]
        except OSError as error:
            raise InputError(name, "it wrote no answer", EXPECTED) from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(name, f"its answer cannot be read ({error})", EXPECTED) from error

    def _grasp(self, item: dict[str, Any], T_world_cam: gtsam.Pose3) -> GraspCandidate:
        T = np.asarray(item["T_cam_grasp"], dtype=float)
        score, width = float(item["score"]), float(item["width_m"])
        if T.shape != (4, 4) or not np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-4):
            raise ValueError("T_cam_grasp is no pose")
        if not (np.isfinite(T).all() and np.isfinite(score) and 0.0 <= width):
            raise ValueError("numbers that are not finite, or a width below 0")
        return GraspCandidate(T_world_cam * gtsam.Pose3(T), float(np.clip(score, 0.0, 1.0)), width)


def _off(grasp: GraspCandidate, p_world: FloatArray) -> float:
    return float(np.linalg.norm(grasp.T_world_grasp.translation() - p_world))
