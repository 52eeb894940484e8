"""A folder laid out as PartNet-Mobility, made of small real meshes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from akm_fg.io.sources.realsense.library import provide_libusb

provide_libusb()  # before tests look whether librealsense can be had

# The objects are modelled as PartNet's are: y up, front at +z of the mesh files, about 2 units
# large; the first joint turns them upright, with the front at -x.
ROOT_RPY = "1.570796326794897 0 -1.570796326794897"


@dataclass
class Solid:
    """A box of the mesh file: middle and sides, in the file's units."""

    middle: tuple[float, float, float]
    sides: tuple[float, float, float]
    material: str = "wood"


@dataclass
class MobilityObject:
    """Writes one object folder: a carcass and one moving link."""

    kind: str = "prismatic"
    limits: tuple[float, float] | None = (0.0, 1.0)
    axis: str = "0 0 1"
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the joint, in mesh coordinates
    part: list[Solid] = field(default_factory=list)
    handle: list[Solid] = field(default_factory=list)
    collision: bool = True
    second_joint: bool = False
    category: str = "StorageFurniture"

    def write(self, folder: Path) -> Path:
        meshes = folder / "textured_objs"
        meshes.mkdir(parents=True)
        (folder / "images").mkdir()
        (folder / "meta.json").write_text(json.dumps({"model_cat": self.category}))
        (folder / "semantics.txt").write_text("link_0 slider drawer\n")
        _write_picture(folder / "images" / "texture0.png")
        _write_solids(meshes / "carcass-1.obj", CARCASS, (0.0, 0.0, 0.0))
        shift = tuple(-c for c in self.origin)
        _write_solids(meshes / "front-2.obj", self.part or DRAWER, shift)
        _write_solids(meshes / "bar-3.obj", self.handle or BAR, shift)
        (folder / "mobility.urdf").write_text(self._urdf())
        return folder

    def _urdf(self) -> str:
        origin = " ".join(str(c) for c in self.origin)
        limit = ""
        if self.limits is not None:
            limit = f'<limit lower="{self.limits[0]}" upper="{self.limits[1]}"/>'
        links = self._link("link_1", [("shelf-1", "carcass-1.obj")])
        links += self._link("link_0", [("front-2", "front-2.obj"), ("handle-3", "bar-3.obj")])
        second = ""
        if self.second_joint:
            links += self._link("link_2", [("lid-4", "carcass-1.obj")])
            second = (
                '<joint name="joint_2" type="revolute"><origin xyz="0 0 0"/><axis xyz="0 1 0"/>'
                '<parent link="link_1"/><child link="link_2"/><limit lower="0" upper="1"/></joint>'
            )
        return (
            f'<robot name="test"><link name="base"/>{links}'
            f'<joint name="joint_1" type="fixed"><origin rpy="{ROOT_RPY}" xyz="0 0 0"/>'
            '<parent link="base"/><child link="link_1"/></joint>'
            f'<joint name="joint_0" type="{self.kind}"><origin xyz="{origin}"/>'
            f'<axis xyz="{self.axis}"/><parent link="link_1"/><child link="link_0"/>{limit}</joint>'
            f"{second}</robot>"
        )

    def _link(self, name: str, shapes: list[tuple[str, str]]) -> str:
        text = ""
        for tag in ("visual", "collision") if self.collision else ("visual",):
            for shape, file in shapes:
                mesh = f'<geometry><mesh filename="textured_objs/{file}"/></geometry>'
                named = f' name="{shape}"' if tag == "visual" else ""
                text += f'<{tag}{named}><origin xyz="0 0 0"/>{mesh}</{tag}>'
        return f'<link name="{name}">{text}</link>'


# A cabinet of 1.0 x 1.2 x 1.0 units (wide, high, deep) with an opening in its front at z = 0.5.
CARCASS = [
    Solid((-0.48, 0.0, 0.0), (0.04, 1.2, 1.0), "wood"),
    Solid((0.48, 0.0, 0.0), (0.04, 1.2, 1.0), "wood"),
    Solid((0.0, 0.58, 0.0), (1.0, 0.04, 1.0), "wood"),
    Solid((0.0, -0.58, 0.0), (1.0, 0.04, 1.0), "wood"),
    Solid((0.0, 0.0, -0.48), (1.0, 1.2, 0.04), "wood"),
]
# A board that closes the opening; what the drawers and doors below are made of.
DRAWER = [Solid((0.0, 0.0, 0.52), (0.9, 1.1, 0.04), "paint")]
# A bar on two posts, as one mesh: its hull would fill the gap behind it.
BAR = [
    Solid((0.0, 0.0, 0.61), (0.30, 0.03, 0.03), "metal"),
    Solid((-0.13, 0.0, 0.57), (0.03, 0.03, 0.07), "metal"),
    Solid((0.13, 0.0, 0.57), (0.03, 0.03, 0.07), "metal"),
]
MATERIALS = {"wood": (0.6, 0.4, 0.2), "paint": (0.1, 0.2, 0.8), "metal": (0.9, 0.9, 0.9)}
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2.0
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def _write_solids(path: Path, solids: list[Solid], shift: tuple[float, ...]) -> None:
    lines = [f"mtllib {path.stem}.mtl", "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    for i, solid in enumerate(solids):
        corners = SIGNS * solid.sides + solid.middle + np.array(shift)
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
        lines.append(f"usemtl {solid.material}")
        for quad in QUADS:
            lines.append("f " + " ".join(f"{8 * i + k + 1}/{t}" for t, k in enumerate(quad, 1)))
    path.write_text("\n".join(lines) + "\n")
    texts = []
    for name in {solid.material for solid in solids}:
        kd = " ".join(map(str, MATERIALS[name]))
        picture = "map_Kd ../images/texture0.png\n" if name == "wood" else ""
        texts.append(f"newmtl {name}\nKd {kd}\n{picture}")
    path.with_suffix(".mtl").write_text("".join(sorted(texts)))


def _write_picture(path: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    cv2.imwrite(str(path), rng.integers(80, 160, (64, 64, 3), dtype=np.uint8))


@pytest.fixture
def mobility_object() -> type[MobilityObject]:
    return MobilityObject


@pytest.fixture
def solid() -> type[Solid]:
    return Solid
