"""A toy world of fronts with a coloured spot where they open, and features that see colours."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.backends.networks.crops import SquareCrop
from akm_fg.exploration.analogy.contacts import ContactMemory, Opened, RememberedContact, remembered
from akm_fg.interfaces import FeatureMap
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
BOX = np.s_[20:100, 40:120]  # the front in the image
DEPTH_M = 1.0
# The camera looks along the world's x, upright; the front looks back at it.
T_WORLD_CAM = gtsam.Pose3(
    gtsam.Rot3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])), np.array([0.0, 0.0, 0.5])
)
NORMAL = np.array([-1.0, 0.0, 0.0])


class ColourFeatures:
    """`DenseFeatures` without a network: the colours of 20 x 20 cells."""

    made_by = "colours/20"

    def describe(self, rgb: np.ndarray, mask: np.ndarray) -> FeatureMap:
        crop = SquareCrop.around(mask, 80, 1.0)
        cells = cv2.resize(crop.cut(rgb), (20, 20), interpolation=cv2.INTER_AREA)
        return crop.feature_map(cells.astype(np.float32) / 255.0, mask, self.made_by)


@dataclass(frozen=True)
class Front:
    frame: RgbdFrame
    mask: np.ndarray
    uv: np.ndarray  # of its handle

    @property
    def contact_world(self) -> np.ndarray:
        p_cam = CAMERA.back_project(self.uv, np.array(DEPTH_M))
        return T_WORLD_CAM.transformFrom(p_cam)


def front(uv: tuple[int, int], body=(90, 90, 90), handle=(220, 40, 40)) -> Front:
    """A grey front with a handle of a colour at a pixel."""
    rgb = np.full((120, 160, 3), 20, dtype=np.uint8)
    mask = np.zeros((120, 160), dtype=bool)
    mask[BOX] = True
    rgb[mask] = body
    u, v = uv
    rgb[v - 4 : v + 5, u - 4 : u + 5] = handle
    depth = np.full((120, 160), DEPTH_M, dtype=np.float32)
    return Front(RgbdFrame(0.0, rgb, depth, CAMERA, T_WORLD_CAM), mask, np.array(uv, dtype=float))


def kept(
    seen: Front,
    name: str = "toy/drawer",
    family: str = "chest",
    kind: str = "prismatic",
    direction=(-1.0, 0.0, 0.0),
) -> RememberedContact:
    """What is remembered of a front that opened at its handle."""
    opened = Opened(name, family, kind, seen.contact_world, np.array(direction), NORMAL)
    features = ColourFeatures().describe(seen.frame.rgb, seen.mask)
    return remembered(seen.frame, seen.mask, features, opened)


@pytest.fixture
def memory() -> ContactMemory:
    """Three that opened: two red handles on grey, a blue one on a green door."""
    found = ContactMemory("", ())
    door = front((60, 80), body=(60, 140, 60), handle=(40, 40, 220))
    for contact in (
        kept(front((55, 50))),
        kept(front((95, 35)), "toy/other", "desk"),
        kept(door, "toy/door", "cabinet", "revolute", (-0.8, 0.6, 0.0)),
    ):
        found = found.with_contact(contact, ColourFeatures.made_by)
    return found
