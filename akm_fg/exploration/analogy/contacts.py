"""A memory of contacts at which something opened: what they looked like, and how it opened."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.exploration.analogy.front import front_axes
from akm_fg.interfaces import DenseFeatures, FeatureMap
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

OpeningKind = Literal["prismatic", "revolute", "helical"]
MAX_CROP_PX = 192  # longer side of a remembered picture: a handle is still seen in it
CROP_MARGIN = 0.05  # of the object's longer side, around it


@dataclass(frozen=True, slots=True)
class RememberedContact:
    """One contact at which a pull opened an object."""

    object_name: str
    family: str  # of objects that look and open alike, for leaving them out; "" if unknown
    kind: OpeningKind
    crop_rgb: NDArray[np.uint8]  # (h, w, 3) the object, at most `MAX_CROP_PX` along either side
    crop_mask: BoolArray  # (h, w)
    contact_uv: FloatArray  # (2,) in the crop
    contact_world: FloatArray  # (3,) m, world of that time
    direction_front: FloatArray  # (3,) unit, of the pull: across, up, out of the front
    feature: NDArray[np.float32]  # (C,) at the contact, minus `descriptor`
    descriptor: NDArray[np.float32]  # (C,) of the whole object

    def __post_init__(self) -> None:
        size = self.crop_mask.shape
        if self.crop_rgb.shape != (*size, 3) or max(size) > MAX_CROP_PX:
            raise ValueError(f"crop {self.crop_rgb.shape}, mask {size}, at most {MAX_CROP_PX} px")
        if self.feature.shape != self.descriptor.shape or self.feature.ndim != 1:
            raise ValueError(f"feature {self.feature.shape}, descriptor {self.descriptor.shape}")
        if abs(float(np.linalg.norm(self.direction_front)) - 1.0) > 1e-3:
            raise ValueError(f"direction {self.direction_front} is no unit vector")


@dataclass(frozen=True, slots=True)
class Opened:
    """What is told of a contact at which something opened."""

    object_name: str
    family: str
    kind: OpeningKind
    contact_world: FloatArray  # (3,) m, where the hand took hold
    direction_world: FloatArray  # (3,) unit, in which it began to move
    normal_world: FloatArray  # (3,) unit, out of the front


def remembered(
    frame: RgbdFrame, mask: BoolArray, features: FeatureMap, opened: Opened
) -> RememberedContact:
    """A contact as it is kept, of the frame in which the object was closed.

    Raises:
        ValueError: an empty mask, or a contact behind the camera.
    """
    uv = frame.camera.project(frame.T_world_cam.transformTo(opened.contact_world)[None])[0]
    if not mask.any() or not np.isfinite(uv).all():
        raise ValueError(f"contact at pixel {uv}, {int(mask.sum())} pixels of the object")
    rgb, small, crop_uv = _cropped(frame.rgb, mask, uv)
    direction = front_axes(opened.normal_world).T @ opened.direction_world
    return RememberedContact(
        object_name=opened.object_name,
        family=opened.family,
        kind=opened.kind,
        crop_rgb=rgb,
        crop_mask=small,
        contact_uv=crop_uv,
        contact_world=opened.contact_world,
        direction_front=direction / np.linalg.norm(direction),
        feature=features.at(uv[None])[0],
        descriptor=features.descriptor,
    )


def _cropped(
    rgb: NDArray[np.uint8], mask: BoolArray, uv: FloatArray
) -> tuple[NDArray[np.uint8], BoolArray, FloatArray]:
    """Picture and mask around the object, made smaller where they are large; the pixel in it."""
    rows, columns = np.nonzero(mask)
    extent = max(np.ptp(rows), np.ptp(columns)) + 1
    room = int(np.ceil(CROP_MARGIN * extent))
    top, left = max(rows.min() - room, 0), max(columns.min() - room, 0)
    box = np.s_[top : rows.max() + 1 + room, left : columns.max() + 1 + room]
    picture, inside = rgb[box], mask[box]
    h, w = inside.shape
    factor = min(MAX_CROP_PX / max(h, w), 1.0)
    size = max(round(factor * w), 1), max(round(factor * h), 1)
    crop_uv = (uv - [left, top] + 0.5) * np.array(size) / [w, h] - 0.5
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    share = cv2.resize(inside.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return small, np.asarray(share >= min(0.5, float(share.max()))), crop_uv


@dataclass(frozen=True, slots=True)
class ContactMemory:
    """Contacts, and whose features they are described by."""

    made_by: str  # see `FeatureMap.made_by`; "" of a memory without a contact
    contacts: tuple[RememberedContact, ...]

    def __post_init__(self) -> None:
        lengths = {contact.feature.shape for contact in self.contacts}
        if len(lengths) > 1:
            raise ValueError(f"features of several lengths in one memory: {sorted(lengths)}")

    @staticmethod
    def read(path: Path) -> ContactMemory:
        """The memory that a folder holds, see `memory_folder`.

        Raises:
            InputError: no such folder, another schema, or a broken one.
        """
        from akm_fg.exploration.analogy.memory_folder import read_memory

        return read_memory(path)

    def write(self, path: Path) -> None:
        """Put the memory into a folder, in the place of one that it holds.

        Raises:
            OutputError: the disk refuses.
        """
        from akm_fg.exploration.analogy.memory_folder import write_memory

        write_memory(path, self)

    def with_contact(self, contact: RememberedContact, made_by: str) -> ContactMemory:
        """With one more.

        Raises:
            ValueError: it is described by other features than the memory.
        """
        if self.contacts and made_by != self.made_by:
            raise ValueError(f"the memory is described by {self.made_by}, the contact by {made_by}")
        return ContactMemory(made_by, (*self.contacts, contact))

    def without_family(self, name: str) -> ContactMemory:
        """As one that has never met the family (the paper's zero-shot)."""
        kept = tuple(contact for contact in self.contacts if contact.family != name)
        return ContactMemory(self.made_by, kept)

    def without_object(self, name: str) -> ContactMemory:
        """As one that has never met the object."""
        kept = tuple(contact for contact in self.contacts if contact.object_name != name)
        return ContactMemory(self.made_by, kept)

    def in_terms_of(self, dense: DenseFeatures) -> ContactMemory:
        """The memory as these features describe it: itself, if they are its own."""
        if not self.contacts:
            return self
        first = self.contacts[0]
        made_by = dense.describe(first.crop_rgb, first.crop_mask).made_by
        return self if made_by == self.made_by else self.described_by(dense)

    def described_by(self, dense: DenseFeatures) -> ContactMemory:
        """The same contacts, described by other features: by their pictures."""
        made_by, anew = self.made_by, []
        for contact in self.contacts:
            features = dense.describe(contact.crop_rgb, contact.crop_mask)
            made_by = features.made_by
            feature = features.at(contact.contact_uv[None])[0]
            anew.append(replace(contact, feature=feature, descriptor=features.descriptor))
        return ContactMemory(made_by, tuple(anew))
