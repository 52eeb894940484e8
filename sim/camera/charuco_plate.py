"""A ChArUco board printed on a stiff plate, as a body of the simulated world.

Board frame, as in OpenCV: origin in the upper left corner of the printed pattern, x right, y
down, z into the plate.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray
from sim.objects.obj_files import Patch, joined, write_obj


@dataclass(frozen=True, slots=True)
class PlateSpec:
    """The printed pattern and the plate it is on."""

    squares_x: int = 9  # 405 x 270 mm: a sheet of A3
    squares_y: int = 6
    square_m: float = 0.045
    marker_m: float = 0.034
    dictionary: str = "DICT_4X4_50"  # six cells a side: readable at 13 pixels
    margin_m: float = 0.008  # white rim; also what the fingers clamp
    thickness_m: float = 0.004
    texel_m: float = 2.5e-4  # finer than a supersampled pixel at the least distance

    @property
    def size_m(self) -> FloatArray:
        """(2,) width and height of the printed pattern."""
        return self.square_m * np.array([self.squares_x, self.squares_y])


RIM = ((0.001, 0.001),) * 4  # texture coordinates of a place that is white
# For each side: its corners, counter-clockwise from outside, of the plate's eight (x runs fastest,
# z slowest); its normal; its texture coordinates, v up. The first one is the printed face.
SIDES = (
    ((0, 2, 3, 1), (0.0, 0.0, -1.0), ((0.0, 1.0), (0.0, 0.0), (1.0, 0.0), (1.0, 1.0))),
    ((4, 5, 7, 6), (0.0, 0.0, 1.0), RIM),
    ((0, 1, 5, 4), (0.0, -1.0, 0.0), RIM),
    ((2, 6, 7, 3), (0.0, 1.0, 0.0), RIM),
    ((0, 4, 6, 2), (-1.0, 0.0, 0.0), RIM),
    ((1, 3, 7, 5), (1.0, 0.0, 0.0), RIM),
)
TWO_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def write_plate(spec: PlateSpec, folder: Path) -> Path:
    """Writes `plate.urdf` with mesh and texture; the link's frame is the board frame."""
    cv2.imwrite(str(folder / "plate.png"), _pattern(spec))
    width, height = spec.size_m
    m = spec.margin_m
    x, y, z = np.array([-m, width + m]), np.array([-m, height + m]), [0.0, spec.thickness_m]
    corners = np.array([(a, b, c) for c in z for b in y for a in x])
    patches = [
        Patch(corners[list(ring)], np.tile(normal, (4, 1)), np.array(uv), TWO_TRIANGLES)
        for ring, normal, uv in SIDES
    ]
    write_obj(folder / "plate.obj", joined(patches), "plate.png")
    centre = f"{width / 2:.6f} {height / 2:.6f} {spec.thickness_m / 2:.6f}"
    size = f"{x[1] - x[0]:.6f} {y[1] - y[0]:.6f} {spec.thickness_m:.6f}"
    urdf = folder / "plate.urdf"
    urdf.write_text(
        '<robot name="plate"><link name="plate">\n<inertial><mass value="0.1"/>'
        '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>\n'
        '<visual><geometry><mesh filename="plate.obj"/></geometry></visual>\n'
        f'<collision><origin xyz="{centre}" rpy="0 0 0"/>\n'
        f'<geometry><box size="{size}"/></geometry></collision>\n</link></robot>\n',
        encoding="utf-8",
    )
    return urdf


def _pattern(spec: PlateSpec) -> NDArray[np.uint8]:
    """The face of the plate, rim included."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    board = cv2.aruco.CharucoBoard(
        (spec.squares_x, spec.squares_y), spec.square_m, spec.marker_m, dictionary
    )
    width, height = np.rint(spec.size_m / spec.texel_m).astype(int)
    rim = round(spec.margin_m / spec.texel_m)
    image = board.generateImage((int(width), int(height)), marginSize=0, borderBits=1)
    return np.asarray(cv2.copyMakeBorder(image, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=255))
