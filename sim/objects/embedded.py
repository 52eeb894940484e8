"""The two embedded objects, `door` and `drawer`: one cabinet each, varied by a seed.

Geometry comes from scene_synthesizer; masses, inertia, damping, friction and looks are ours,
because its masses are grams and it has no textures. The gripper frame is that of `Arm`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import gtsam
import numpy as np
from scene_synthesizer.procedural_assets import CabinetAsset

from akm_fg.records import FloatArray
from sim.objects.library_boxes import box_of, build_asset, shifted
from sim.objects.mechanisms import Catch, Closer
from sim.objects.meshes import Box
from sim.objects.part_spec import BuiltObject, hinge_side
from sim.objects.textures import FRONT_TEXTURES, Rgb, brushed_metal, rotated
from sim.objects.urdf.urdf_files import write_urdf
from sim.objects.urdf.urdf_model import Link

OBJECT_NAMES = ("door", "drawer")


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """One cabinet with one moving part. Everything here is truth: for building and scoring."""

    name: str
    seed: int
    kind: Literal["prismatic", "revolute"]
    hinge: Literal["left", "right"] | None  # as seen from the front; None for a drawer
    size_m: FloatArray  # (3,) width, depth, height
    front_height_m: float  # of the moving front; a closed panel fills the rest below it
    handle_bar_m: float  # thickness of the bar
    handle_length_m: float
    handle_reach_m: float  # from the front to the outside of the bar
    handle_shift_m: FloatArray  # (2,) of the handle from its usual place, along x and z
    mass_kg: float  # of the moving part
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float  # sliding friction of the handle against rubber with mu 1
    front_texture: str
    catch: Catch | None = None  # holds it closed
    closer: Closer | None = None  # pulls it shut

    @property
    def balanced(self) -> bool:
        """Neither of them lifts its part."""
        return False

    @property
    def view_side(self) -> float:
        """Of a door, where its hinge is; of a drawer, either side, by the seed."""
        return hinge_side(self.hinge) or (1.0 if self.seed % 2 == 1 else -1.0)


def sample_object(name: str, seed: int) -> ObjectSpec:
    """The object `name` as varied by `seed`.

    Figures are those of kitchen and office furniture: drawers of 2 to 6 kg on slides with 2 to
    6 N of friction, doors of 3 to 8 kg with 0.2 to 0.8 N m in the hinges.

    Raises:
        ValueError: no such object.
    """
    if name not in OBJECT_NAMES:
        raise ValueError(f"object {name!r}, expected one of {', '.join(OBJECT_NAMES)}")
    rng = np.random.default_rng([seed, OBJECT_NAMES.index(name)])
    drawer = name == "drawer"
    height = rng.uniform(0.6, 0.75)
    front = rng.uniform(0.2, 0.3) if drawer else rng.uniform(0.38, 0.5)
    hinge: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
    return ObjectSpec(
        name=name,
        seed=seed,
        kind="prismatic" if drawer else "revolute",
        hinge=None if drawer else hinge,
        size_m=np.array([rng.uniform(0.38, 0.52), 0.56 if drawer else 0.4, height]),
        front_height_m=front,
        handle_bar_m=rng.uniform(0.012, 0.02),
        handle_length_m=rng.uniform(0.12, 0.18),
        handle_reach_m=rng.uniform(0.042, 0.055),
        handle_shift_m=rng.uniform(-0.03, 0.03, 2),
        mass_kg=rng.uniform(2.0, 6.0) if drawer else rng.uniform(3.0, 8.0),
        damping=rng.uniform(3.0, 12.0) if drawer else rng.uniform(0.3, 1.0),
        friction=rng.uniform(2.0, 6.0) if drawer else rng.uniform(0.2, 0.8),
        upper=0.44 if drawer else np.pi / 2,
        handle_mu=rng.uniform(0.8, 1.0),
        front_texture=str(rng.choice(sorted(FRONT_TEXTURES))),
    )


def build_object(spec: ObjectSpec, folder: Path) -> BuiltObject:
    """Writes the object's URDF, meshes and textures into `folder`."""
    asset = build_asset(lambda _: _make_asset(spec))
    (joint,) = asset.movable()
    origin = joint.T_parent_joint.translation()  # the parent stands in the object frame's origin
    corpus = [b for link in asset.links.values() if link.name != joint.child for b in _boxes(link)]
    moved = _place_handle(_boxes(asset.links[joint.child]), spec)
    _write_textures(spec, folder, np.random.default_rng([spec.seed, 77]))
    urdf = write_urdf(spec, corpus, moved, origin, joint.axis, folder)
    bar = next(box for box in moved if box.name.endswith("handle_part_0"))
    R_object_handle = gtsam.Rot3(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
    if spec.kind == "revolute":  # the bar stands upright: x along it
        R_object_handle = R_object_handle * gtsam.Rot3.Rz(-np.pi / 2)
    p_bar = origin + bar.T_link_box.translation()
    _, depth, height = spec.size_m.tolist()
    return BuiltObject(
        spec=spec,
        urdf=urdf,
        axis_object=joint.axis,
        pivot_object=origin,
        T_object_handle=gtsam.Pose3(R_object_handle, p_bar),
        p_object_front=np.array([0.0, -depth / 2.0, height - spec.front_height_m / 2.0]),
        handle_thickness_m=spec.handle_bar_m,
    )


def _make_asset(spec: ObjectSpec) -> CabinetAsset:
    """The library's cabinet: the moving front on top, a closed panel below."""
    width, depth, height = spec.size_m.tolist()
    # The library's door_left has its hinge on the right as seen from the front.
    kind = "drawer"
    if spec.kind == "revolute":
        kind = "door_right" if spec.hinge == "left" else "door_left"
    return CabinetAsset(
        width=width,
        depth=depth,
        height=height,
        compartment_mask=[[0], [1]],
        compartment_types=[kind, "closed"],
        compartment_heights=[spec.front_height_m, height - spec.front_height_m],
        outer_wall_thickness=0.016,
        drawer_wall_thickness=0.012,
        handle_width=spec.handle_length_m,
        handle_height=spec.handle_reach_m,
        handle_depth=spec.handle_bar_m,
    )


def _boxes(link: Link) -> list[Box]:
    """The link's boxes, each of the material that its name in the library tells."""
    found = [box_of(shape, _material(shape.name)) for shape in link.collisions]
    return [box for box in found if box is not None]


def _material(name: str) -> str:
    if "handle" in name:
        return "handle"
    return "front" if name.endswith(("board_0", "_door")) or "closed" in name else "carcass"


def _place_handle(boxes: list[Box], spec: ObjectSpec) -> list[Box]:
    """The part's boxes with the handle shifted by the spec's x and z."""
    shift = np.array([spec.handle_shift_m[0], 0.0, spec.handle_shift_m[1]])
    if spec.kind == "revolute":  # keep the bar on the door: shift only towards the hinge
        shift[0] = abs(shift[0]) * (1.0 if spec.hinge == "right" else -1.0)
    return [shifted(box, shift) if box.material == "handle" else box for box in boxes]


def _write_textures(spec: ObjectSpec, folder: Path, rng: np.random.Generator) -> None:
    front = FRONT_TEXTURES[spec.front_texture](rng)
    textures: dict[str, Rgb] = {
        "front": rotated(front) if rng.random() < 0.5 else front,
        "carcass": FRONT_TEXTURES[spec.front_texture](rng),
        "handle": brushed_metal(rng),
    }
    for name, image in textures.items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
