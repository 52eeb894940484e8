"""What is remembered of a success, and how it is kept on disk."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError, OutputError
from akm_fg.exploration.analogy import memory_folder
from akm_fg.exploration.analogy.contacts import MAX_CROP_PX, ContactMemory
from akm_fg.exploration.analogy.front import front_axes
from akm_fg.exploration.analogy.memory_folder import add_contact

from .conftest import NORMAL, ColourFeatures, front, kept

MADE_BY = ColourFeatures.made_by


def test_a_success_is_kept_as_crop_pixel_feature_and_direction_in_the_fronts_axes() -> None:
    seen = front((60, 70))
    contact = kept(seen, direction=(-0.6, 0.8, 0.0))
    u, v = np.rint(contact.contact_uv).astype(int)
    assert tuple(contact.crop_rgb[v, u]) == (220, 40, 40)
    assert contact.crop_mask[v, u] and contact.crop_rgb.shape[:2] == contact.crop_mask.shape
    features = ColourFeatures().describe(seen.frame.rgb, seen.mask)
    np.testing.assert_allclose(contact.feature, features.at(seen.uv[None])[0])
    # Across is z x out: of a front that looks along -x, the world's -y.
    np.testing.assert_allclose(front_axes(NORMAL)[:, 0], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(contact.direction_front, [-0.8, 0.0, 0.6], atol=1e-12)


def test_a_large_picture_is_kept_small_with_its_pixel_in_place() -> None:
    seen = front((60, 70))
    frame = seen.frame
    rgb = frame.rgb.repeat(4, axis=0).repeat(4, axis=1)
    camera = replace(frame.camera, width=640, height=480, fx=600, fy=600, cx=319.5, cy=239.5)
    depth = frame.depth_m.repeat(4, axis=0).repeat(4, axis=1)
    large = replace(frame, rgb=rgb, depth_m=depth, camera=camera)
    mask = seen.mask.repeat(4, axis=0).repeat(4, axis=1)
    contact = kept(replace(seen, frame=large, mask=mask))
    assert max(contact.crop_mask.shape) == MAX_CROP_PX
    u, v = np.rint(contact.contact_uv).astype(int)
    assert tuple(contact.crop_rgb[v, u]) == (220, 40, 40)


def test_a_memory_is_read_as_it_was_written(memory: ContactMemory, tmp_path: Path) -> None:
    memory.write(tmp_path / "memory")
    back = ContactMemory.read(tmp_path / "memory")
    assert back.made_by == memory.made_by and len(back.contacts) == 3
    for one, other in zip(memory.contacts, back.contacts, strict=True):
        assert (one.object_name, one.family, one.kind) == (
            other.object_name,
            other.family,
            other.kind,
        )
        np.testing.assert_array_equal(one.feature, other.feature)
        np.testing.assert_array_equal(one.descriptor, other.descriptor)
        np.testing.assert_array_equal(one.crop_mask, other.crop_mask)
        np.testing.assert_allclose(one.direction_front, other.direction_front, atol=1e-5)
        np.testing.assert_allclose(one.contact_uv, other.contact_uv, atol=0.01)
        assert np.abs(one.crop_rgb.astype(int) - other.crop_rgb).mean() < 4  # JPEG


def test_a_family_and_an_object_are_left_out(memory: ContactMemory) -> None:
    assert [c.family for c in memory.without_family("chest").contacts] == ["desk", "cabinet"]
    assert len(memory.without_object("toy/door").contacts) == 2
    assert len(memory.contacts) == 3


def test_other_features_describe_the_pictures_anew(memory: ContactMemory) -> None:
    again = memory.described_by(ColourFeatures())
    for one, other in zip(memory.contacts, again.contacts, strict=True):
        np.testing.assert_allclose(one.feature, other.feature, atol=0.12)
    assert memory.in_terms_of(ColourFeatures()) is memory
    other = ColourFeatures()
    other.made_by = "other"
    assert memory.in_terms_of(other).made_by == "other"
    assert ContactMemory("", ()).in_terms_of(other).contacts == ()
    with pytest.raises(ValueError, match="described by colours/20, the contact by other"):
        memory.with_contact(memory.contacts[0], "other")


def test_a_memory_grows_and_what_others_add_meanwhile_stays(tmp_path: Path) -> None:
    folder = tmp_path / "memory"
    contacts = [kept(front((50 + 4 * i, 60)), f"toy/{i}") for i in range(8)]
    threads = [
        threading.Thread(target=add_contact, args=(folder, contact, MADE_BY))
        for contact in contacts
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    names = {contact.object_name for contact in ContactMemory.read(folder).contacts}
    assert names == {f"toy/{i}" for i in range(8)}
    assert len(list(folder.iterdir())) == 2


def test_an_interruption_while_growing_leaves_the_memory_as_it_was(
    memory: ContactMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory.write(tmp_path)

    real = memory_folder.os.replace
    for last in ("arrays", "contacts.json"):  # what was about to take its place

        def interrupted(part: Path, place: Path, last: str = last) -> None:
            if place.name.startswith(last):
                raise KeyboardInterrupt
            real(part, place)

        with monkeypatch.context() as during:
            during.setattr(memory_folder.os, "replace", interrupted)
            with pytest.raises(KeyboardInterrupt):
                add_contact(tmp_path, memory.contacts[0], MADE_BY)
        assert len(ContactMemory.read(tmp_path).contacts) == 3
    assert len(add_contact(tmp_path, memory.contacts[0], MADE_BY).contacts) == 4
    assert len(list(tmp_path.iterdir())) == 2


def test_what_cannot_be_written_is_said_in_a_line(memory: ContactMemory, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/memory: cannot be written \("):
        memory.write(tmp_path / "file" / "memory")


def broken(folder: Path, **changes: object) -> Path:
    said = json.loads((folder / "contacts.json").read_text())
    for name, value in changes.items():
        target = said if name in said else said["contacts"][0]
        target[name] = value
    (folder / "contacts.json").write_text(json.dumps(said))
    return folder


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"schema": "akm-fg/contacts/9"}, r"`schema` is 'akm-fg/contacts/9'"),
        ({"arrays": "../arrays.npz"}, r"`arrays` is '../arrays.npz'"),
        ({"arrays": "gone.npz"}, r"gone.npz: does not exist"),
        ({"contacts": {}}, r"`contacts` is no list"),
        ({"contacts": [3, 3, 3]}, r"`contacts\[0\]` is no object"),
        ({"contacts": []}, r"features \(3, 3\)"),
        ({"kind": "screw"}, r"`contacts\[0\].kind` is 'screw'"),
        ({"contact_uv": [1]}, r"contact_uv"),
        ({"direction_front": [0, 0, 2]}, r"`contacts\[0\]`: direction .* no unit vector"),
        ({"picture": [0, 10**9]}, r"picture` is 0 to 1000000000"),
        ({"picture": [5, 90]}, r"picture` cannot be decoded"),
    ],
)
def test_a_broken_memory_is_told_in_a_line(
    memory: ContactMemory, tmp_path: Path, changes: dict, said: str
) -> None:
    memory.write(tmp_path)
    with pytest.raises(InputError, match=said) as caught:
        ContactMemory.read(broken(tmp_path, **changes))
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        ContactMemory.read(tmp_path / "gone")
    with pytest.raises(InputError, match="is missing"):
        ContactMemory.read(tmp_path)
