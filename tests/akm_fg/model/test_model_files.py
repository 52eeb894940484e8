"""`model.json` and its surfaces: written whole, read back the same, refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InputError, OutputError
from akm_fg.model.read import read_model
from akm_fg.model.records import Contact, ModelPart, StateLimits, Surface
from akm_fg.model.write import set_aside, write_model
from akm_fg.records import CameraCorrection


def test_what_was_written_is_read(door_model, tmp_path: Path) -> None:
    grasp = Contact(gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.array([0.1, 0.2, 0.3])), 0.2, 3, 1)
    part = replace(
        door_model.parts[0],
        limits=StateLimits(-0.01, 1.6, 0.004),
        contacts=(grasp,),
        closed_state=0.002,
        correction=CameraCorrection(
            gtsam.Pose3(gtsam.Rot3.Rz(0.01), np.array([0.01, 0.0, -0.002])),
            1e-6 * np.eye(6), 0.004, 0.003,
        ),
    )  # fmt: skip
    model = replace(door_model, parts=(part,), sources=("a", "b"))
    for place in (write_model(tmp_path, model), tmp_path):
        found = read_model(place)
        (got,) = found.parts
        assert (got.limits, got.closed_state, found.sources) == (part.limits, 0.002, ("a", "b"))
        assert got.correction.T_world_seen.equals(part.correction.T_world_seen, 1e-12)
        np.testing.assert_array_equal(got.correction.cov_seen_joint, 1e-6 * np.eye(6))
        assert (got.correction.length_share, got.correction.length_share_sd) == (0.004, 0.003)
        assert got.posterior.to_dict() == part.posterior.to_dict()
        assert found.camera == model.camera and found.T_world_cam.equals(model.T_world_cam, 1e-12)
        assert got.contacts[0].T_part_grasp.equals(grasp.T_part_grasp, 1e-12)
        assert (got.contacts[0].state, got.contacts[0].succeeded, got.contacts[0].failed) == (
            (0.2, 3, 1)
        )
        np.testing.assert_allclose(got.surface.p_world, part.surface.p_world, atol=1e-6)
        np.testing.assert_array_equal(got.surface.rgb, part.surface.rgb)
        np.testing.assert_array_equal(found.static.on_object, model.static.on_object)


def test_the_schema_is_that_of_the_design(door_model, tmp_path: Path) -> None:
    fields = json.loads(write_model(tmp_path, door_model).read_text())
    assert set(fields) == {"schema", "frame", "parts", "static", "camera", "from"}
    assert fields["schema"] == "akm-fg/model/1" and fields["frame"] == "world"
    (part,) = fields["parts"]
    assert set(part) == {"name", "posterior", "closed_state", "limits", "contacts", "surface"}
    assert part["surface"] == "part-0.npz" and fields["static"] == {"surface": "static.npz"}
    with np.load(tmp_path / "part-0.npz", allow_pickle=False) as surface:
        assert set(surface.files) == {"points", "normals", "colours"}


def test_an_older_model_stays_beside_the_new_one(door_model, tmp_path: Path) -> None:
    def with_points(n: int):
        part = door_model.parts[0]
        few = part.surface.select(np.arange(len(part.surface)) < n)
        return replace(door_model, parts=(replace(part, surface=few),))

    for n in (60, 70):
        write_model(tmp_path, with_points(n))
    set_aside(tmp_path)
    set_aside(tmp_path)  # nothing is there any more
    write_model(tmp_path, with_points(80))
    write_model(tmp_path, with_points(90))
    kept = [read_model(tmp_path / f"model{k}.json") for k in ("-1", "-2", "-3", "")]
    assert [len(model.parts[0].surface) for model in kept] == [60, 70, 80, 90]


def _changed(folder: Path, change) -> Path:
    file = folder / "model.json"
    fields = json.loads(file.read_text())
    change(fields)
    file.write_text(json.dumps(fields))
    return file


BROKEN = {
    "schema": lambda m: m.update(schema="akm-fg/model/0"),
    "at least one part": lambda m: m.update(parts=[]),
    "parts": lambda m: m.update(parts={}),
    "surface": lambda m: m["parts"][0].update(surface="../part-0.npz"),
    "surface ": lambda m: m["static"].update(surface="gone.npz"),
    "posterior": lambda m: m["parts"][0].update(posterior=None),
    "cov": lambda m: m["parts"][0]["posterior"]["joint"].update(cov=(-np.eye(6)).tolist()),
    "joint": lambda m: m["parts"][0]["posterior"].update(joint=None),
    "kind": lambda m: m["parts"][0]["posterior"].update(kind="sliding"),
    "sd": lambda m: m["parts"][0]["posterior"]["states"]["sd"].pop(),
    "limits": lambda m: m["parts"][0].update(limits={"lower": 1, "upper": 0, "sd": 0}),
    "failed": lambda m: m["parts"][0].update(
        contacts=[{"T_part_grasp": np.eye(4).tolist(), "state": 0, "succeeded": 1, "failed": -1}]
    ),
    "T_world_cam": lambda m: m["camera"].update(T_world_cam=np.zeros((4, 4)).tolist()),
    "name": lambda m: m["parts"][0].pop("name"),
    "from": lambda m: m.update({"from": "recording"}),
    "closed_state": lambda m: m["parts"][0].update(closed_state="closed"),
}


@pytest.mark.parametrize("what", sorted(BROKEN))
def test_a_broken_model_is_one_line(door_model, tmp_path: Path, what: str) -> None:
    write_model(tmp_path, door_model)
    file = _changed(tmp_path, BROKEN[what])
    with pytest.raises(InputError, match=what.strip()) as caught:
        read_model(file)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_surface_that_is_none_is_one_line(door_model, tmp_path: Path) -> None:
    write_model(tmp_path, door_model)
    n = 5
    good = {
        "points": np.zeros((n, 3)),
        "normals": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "colours": np.zeros((n, 3), np.uint8),
    }
    for name, value in (
        ("points", np.full((n, 3), np.nan)),
        ("normals", np.zeros((n, 3))),
        ("colours", np.zeros((n, 3))),
        ("colours", None),
    ):
        arrays = {k: v for k, v in {**good, name: value}.items() if v is not None}
        np.savez(tmp_path / "part-0.npz", **arrays)
        with pytest.raises(InputError, match=r"part-0\.npz"):
            read_model(tmp_path)
    (tmp_path / "part-0.npz").write_bytes(b"PK no")
    with pytest.raises(InputError, match=r"part-0\.npz"):
        read_model(tmp_path)


def test_a_model_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "no"):
        with pytest.raises(InputError, match="is missing"):
            read_model(place)
    with pytest.raises(InputError, match="holds a list"):
        (tmp_path / "model.json").write_text("[]")
        read_model(tmp_path)


def test_a_disk_that_refuses_leaves_the_old_model(door_model, tmp_path: Path, monkeypatch) -> None:
    write_model(tmp_path, door_model)
    before = (tmp_path / "model.json").read_bytes()

    def refuse(path: Path, data: bytes) -> None:
        raise OutputError(f"{path}: cannot be written")

    monkeypatch.setattr("akm_fg.model.write.replace_file", refuse)
    with pytest.raises(OutputError):
        write_model(tmp_path, door_model)
    assert (tmp_path / "model.json").read_bytes() == before
    read_model(tmp_path)


def test_models_and_surfaces_show_themselves_in_a_line(door_model) -> None:
    assert repr(door_model) == "<ObjectModel part-0: revolute; made from clip>"
    text = repr(door_model.parts[0])
    assert "<Surface of " in text and "array" not in text.split("posterior=")[0]


def test_records_refuse_what_contradicts_itself(door_model) -> None:
    part = door_model.parts[0]
    with pytest.raises(ValueError, match="stands twice"):
        replace(door_model, parts=(part, part))
    with pytest.raises(ValueError, match="closed at"):
        replace(part, closed_state=float("nan"))
    with pytest.raises(ValueError, match="colours"):
        Surface(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="limits"):
        StateLimits(0.2, 0.1, 0.0)
    other = replace(part, name="part-1")
    assert [p.name for p in door_model.with_part(other).parts] == ["part-0", "part-1"]
    assert door_model.with_part(replace(part, closed_state=0.1)).parts[0].closed_state == 0.1
    assert isinstance(part, ModelPart) and part.range_seen()[0] <= 0.0
