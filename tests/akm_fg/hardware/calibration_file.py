"""A file as `akm-fg calibrate --json` writes it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.calibration.result_json import SCHEMA
from akm_fg.records import PinholeCamera


def write_calibration(
    path: Path,
    camera: PinholeCamera,
    T_world_cam: gtsam.Pose3,
    changes: dict[str, Any] | None = None,
) -> Path:
    """Of a fixed camera without distortion, known to 1 mm and 0.1 deg; but for `changes`."""
    turn, place = np.radians(0.1) ** 2, 1e-6
    lens = [0.25] * 4 + [0.0] * 4
    described = {
        "schema": SCHEMA,
        "camera_place": "fixed",
        "camera": asdict(camera),
        "distortion": dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "intrinsics_cov": np.diag(lens).tolist(),
        "T_world_cam": T_world_cam.matrix().tolist(),
        "T_world_cam_cov": np.diag([turn] * 3 + [place] * 3).tolist(),
        "rms_px": 0.2,
        **(changes or {}),
    }
    path.write_text(json.dumps(described), encoding="utf-8")
    return path
