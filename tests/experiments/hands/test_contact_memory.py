"""What a memory of contacts is worth: on painted fronts, and once in the simulator."""

from __future__ import annotations

from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.backends.networks.crops import SquareCrop
from akm_fg.interfaces import FeatureMap
from akm_fg.records import PinholeCamera, RgbdFrame
from experiments.hands.contact_memory import (
    MemoryConfig,
    calibration_table,
    carried_over,
    chance,
    contact_seen,
    described,
    hit_table,
    memory_of,
    shows_handle,
    summary,
)
from experiments.trials.first_looks import FirstLook, first_look, read_look, write_look

CONFIG = MemoryConfig(asked=(1, 1000))
# Colours of cells that a handle half fills point the same way as the handle's own.
A_CELL = replace(CONFIG, beside_m=0.04)


class Colours:
    """`DenseFeatures` that sees colours."""

    def describe(self, rgb: np.ndarray, mask: np.ndarray) -> FeatureMap:
        crop = SquareCrop.around(mask, 80, 1.0)
        cells = cv2.resize(crop.cut(rgb), (20, 20), interpolation=cv2.INTER_AREA)
        return crop.feature_map(cells.astype(np.float32) / 255.0, mask, "colours")


def look(i: int, at: tuple[int, int], colour=(220, 40, 40)) -> FirstLook:
    """A grey front with a handle of a colour."""
    camera = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
    rgb = np.full((120, 160, 3), 90 + i, dtype=np.uint8)
    mask, handles = np.zeros((2, 120, 160), dtype=bool)
    mask[20:100, 40:120] = True
    u, v = at
    handles[v - 4 : v + 5, u - 4 : u + 5] = True
    rgb[handles] = colour
    depth = np.ones((120, 160), dtype=np.float32)
    frame = RgbdFrame(0.0, rgb, depth, camera, gtsam.Pose3())
    contact = camera.back_project(np.array(at, dtype=float), np.array(1.0))
    out = np.array([0.0, 0.0, -1.0])
    kind = "prismatic" if i % 2 else "revolute"
    family = "chest" if i < 3 else "oven"
    return FirstLook(f"toy/{i}", family, kind, frame, mask, handles, contact, out, out, True)


@pytest.fixture
def looks() -> list[FirstLook]:
    return [look(i, (50 + 9 * i, 40 + 8 * i)) for i in range(6)]


def test_handles_that_look_alike_are_found_on_objects_left_out(looks) -> None:
    maps = {one.name: described(one, Colours()) for one in looks}
    memory = memory_of(looks, maps, CONFIG)
    assert len(memory.contacts) == 6
    rows = [
        carried_over(one, memory, maps[one.name], k, zero_shot, A_CELL)
        for one in looks
        for k in CONFIG.asked
        for zero_shot in (False, True)
    ]
    assert all(row.place_on_handle == 1 for row in rows)
    assert all(np.all(np.diff(row.share_on_handles) < 0) for row in rows)  # sharper is better
    assert {row.kind_vote for row in rows if row.asked == 1000 and not row.zero_shot} == {0.4}
    table = hit_table(rows)
    assert "| without its family | all | 6 | 100.0" in table
    assert "| 0.02 |" in calibration_table(rows, CONFIG)


def test_what_was_not_opened_or_is_not_seen_is_not_remembered(looks) -> None:
    hidden = replace(looks[1], contact_world=np.array([0.2, 0.2, 1.0]))
    blind = replace(looks[2], handles=np.zeros_like(looks[2].handles))
    assert not contact_seen(hidden, CONFIG) and not shows_handle(blind, CONFIG)
    given = [replace(looks[0], opened=False), hidden, blind, looks[3]]
    maps = {one.name: described(one, Colours()) for one in given}
    memory = memory_of(given, maps, CONFIG)
    assert [contact.object_name for contact in memory.contacts] == ["toy/3"]
    assert summary(memory, given, CONFIG).startswith("4 objects seen, 3 opened, 1 remembered; of 3")


def test_a_handle_of_another_look_gets_hardly_any_weight(looks) -> None:
    other = look(7, (60, 60), colour=(40, 40, 220))
    maps = {one.name: described(one, Colours()) for one in [*looks, other]}
    memory = memory_of(looks, maps, CONFIG)
    row = carried_over(other, memory, maps[other.name], 1000, False, CONFIG)
    assert max(row.share_on_handles) < 0.1


def test_chance_is_the_share_of_places_on_handles(looks) -> None:
    # 9 x 9 pixels and 2 more on every side, rounded at the corners, of 80 x 80.
    assert chance(looks, CONFIG) == pytest.approx(13**2 / 80**2, rel=0.1)


@pytest.mark.slow  # builds and draws an object: 5 s
def test_a_first_look_knows_handle_and_contact_and_comes_back_from_disk(tmp_path) -> None:
    seen = first_look("furniture-dev/drawer-001", 0)
    assert seen.opened and seen.kind == "prismatic" and shows_handle(seen, CONFIG)
    assert contact_seen(seen, CONFIG)
    assert seen.direction_world @ seen.normal_world > 0.99
    write_look(tmp_path / "look.npz", seen)
    back = read_look(tmp_path / "look.npz", seen.name)
    for name in ("mask", "handles", "contact_world", "direction_world"):
        np.testing.assert_array_equal(getattr(back, name), getattr(seen, name))
    np.testing.assert_array_equal(back.frame.rgb, seen.frame.rgb)
    assert back.opened and back.family == seen.family
    assert back.frame.T_world_cam.equals(seen.frame.T_world_cam, 1e-9)
