"""What scene_synthesizer builds, as links and joints of ours, and its shapes as boxes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.bullet import quiet
from sim.objects.meshes import Box
from sim.objects.urdf.urdf_model import Shape, UrdfModel
from sim.objects.urdf.urdf_reader import read_urdf


def build_asset(make: Callable[[str], Any]) -> UrdfModel:
    """The asset that `make(folder)` gives, as the library itself writes it.

    Its meshes are gone with the scratch folder: only its boxes and cylinders are of use.
    """
    with tempfile.TemporaryDirectory(prefix="akm-fg-sim-") as scratch:
        path = Path(scratch) / "raw.urdf"
        with quiet():
            make(scratch).scene().export(str(path))
        return read_urdf(path)


def box_of(shape: Shape, material: str) -> Box | None:
    """A box, or the box around an upright cylinder, in the link's frame; None for what is else."""
    if shape.kind == "box":
        return Box(shape.name, shape.size, shape.T_link_shape, material)
    if shape.kind == "cylinder":
        diameters = shape.size * np.array([2.0, 2.0, 1.0])  # the model has radii
        return Box(shape.name, diameters, shape.T_link_shape, material, rounded=True)
    return None


def shifted(box: Box, by_m: FloatArray) -> Box:
    """The box moved by (3,) metres along its link's axes."""
    T = box.T_link_box
    return replace(box, T_link_box=gtsam.Pose3(T.rotation(), T.translation() + by_m))
