"""One model of several parts: what was found later joins what was known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import akm_fg
from akm_fg.model.merge import with_found
from akm_fg.model.read import read_model
from akm_fg.model.records import Surface
from akm_fg.model.write import write_model


def test_parts_keep_joint_surface_and_recording(two_part_model, door_model, drawer_aside) -> None:
    first, second = two_part_model.parts
    assert [first.name, second.name] == ["part-0", "part-1"]
    assert second.joint is drawer_aside.parts[0].joint
    assert first.surface is door_model.parts[0].surface
    assert (first.sources, second.sources) == (("clip",), ("aside",))
    assert two_part_model.sources == ("clip", "aside")
    with pytest.raises(ValueError, match="states"):
        with_found(door_model, drawer_aside, [])


def _with_resting(model, p_world: np.ndarray):
    """A model in whose resting surface a cloud was taken for something that rests."""
    n = len(p_world)
    more = np.concatenate([model.static.p_world, p_world])
    normals = np.concatenate([model.static.normal_world, np.tile([1.0, 0.0, 0.0], (n, 1))])
    colours = np.concatenate([model.static.rgb, np.zeros((n, 3), np.uint8)])
    own = np.concatenate([model.static.on_object, np.ones(n, dtype=bool)])
    return replace(model, static=Surface(more, normals, colours, own))


def test_a_part_is_in_no_resting_surface(door_model, drawer_aside) -> None:
    """Each stood in the other's recording: the door open, the drawer closed."""
    door, drawer = door_model.parts[0], drawer_aside.parts[0]
    q = float(door.states.mean[-1])
    T = door.T_world_part(q)
    opened = door.surface.p_world[::9] @ T.rotation().matrix().T + T.translation()
    closed = drawer.surface.p_world[::9]
    later, earlier = _with_resting(drawer_aside, opened), _with_resting(door_model, closed)
    model, wrong = with_found(earlier, later, [q]), with_found(earlier, later, [0.0])
    truly = np.concatenate([door_model.static.p_world, drawer_aside.static.p_world])
    for cloud, left in ((opened, True), (closed, False)):
        free = cloud[cKDTree(truly).query(cloud)[0] > 0.02]  # a part meets what rests at its rims
        assert len(free) > 200
        assert cKDTree(model.static.p_world).query(free)[0].min() > 0.005
        off_m = np.median(cKDTree(wrong.static.p_world).query(free)[0])
        assert (off_m < 1e-6) == left
    # What does rest is that of both, once.
    sides = [np.abs(model.static.p_world[:, 1] - y).min() for y in (-0.3, 0.7 - 0.3, 0.7 + 0.3)]
    assert max(sides) < 0.01
    assert len(model.static) < len(earlier.static) + len(later.static)


def test_a_model_of_several_parts_is_read_as_it_was_written(two_part_model, tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    file = write_model(tmp_path, two_part_model)
    found = read_model(file)
    for got, part in zip(found.parts, two_part_model.parts, strict=True):
        assert (got.name, got.sources) == (part.name, part.sources)
        np.testing.assert_allclose(got.joint.T_world_joint, part.joint.T_world_joint, atol=1e-12)
        np.testing.assert_allclose(got.joint.cov, part.joint.cov)
        np.testing.assert_allclose(got.surface.p_world, part.surface.p_world, atol=1e-6)
    fields = json.loads(file.read_text())
    assert [part["surface"] for part in fields["parts"]] == ["part-0.npz", "part-1.npz"]
    validator = jsonschema.Draft202012Validator(akm_fg.model_schema())
    validator.check_schema(akm_fg.model_schema())
    validator.validate(fields)
    fields["parts"][1].pop("closed_state")
    assert not validator.is_valid(fields)


def test_the_schema_holds_for_a_model_of_one_part(door_model, tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    fields = json.loads(write_model(tmp_path, door_model).read_text())
    jsonschema.validate(fields, akm_fg.model_schema())
    assert "from" not in fields["parts"][0]
    assert read_model(tmp_path).parts[0].sources == ()
