"""Meshes, pieces, messages and the command: what leaves the house of a model."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import ConvexHull

from akm_fg.cli.main import main
from akm_fg.errors import InsufficientData
from akm_fg.export.config import ExportConfig
from akm_fg.export.describe import describe, goes_with, recording_of
from akm_fg.export.description import Mesh, joint_of
from akm_fg.export.glb import glb
from akm_fg.export.pieces import convex_pieces, hull, nominal_mass
from akm_fg.export.ros import ros_covariance, ros_messages
from akm_fg.export.uncertainty import uncertainty_json
from akm_fg.export.urdf import urdf
from akm_fg.export.wavefront import coloured_obj
from akm_fg.io.recording import write_recording
from akm_fg.model.merge import with_found
from akm_fg.model.records import StateLimits
from akm_fg.model.write import write_model

from .conftest import SMALL

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)


@pytest.mark.parametrize("fused", [True, False])
def test_meshes_lie_on_the_closed_object(described, kind: str, fused: bool) -> None:
    model, description, clip = described[kind]
    if not fused:
        description = describe(model, None, one_hull=True, config=SMALL)
    (joint, link), *_ = description.parts
    points = link.visual.points + joint.origin_world
    front = points[np.abs(points[:, 0] - 0.02) < 0.012]
    assert len(front) > 100 and np.ptp(front[:, 1]) > 0.5 and np.ptp(front[:, 2]) > 0.55
    _, part = clip.scene.quads()
    off = []
    for quad in part:
        T = quad.T_world_quad.inverse()
        local = points @ T.rotation().matrix().T + T.translation()
        beside = np.maximum(np.abs(local[:, :2]) - np.array(quad.half), 0)
        off.append(np.sqrt((beside**2).sum(axis=1) + local[:, 2] ** 2))
    assert np.quantile(np.min(off, axis=0), 0.9) < 0.01
    assert len(link.visual.triangles) <= SMALL.triangles
    np.testing.assert_allclose(np.median(link.visual.rgb, axis=0), [170, 130, 90], atol=20)


def test_pieces_are_convex_and_closed_and_hold_the_surface(described) -> None:
    pytest.importorskip("coacd")
    _, description, _ = described["revolute"]
    (_, link), *_ = description.parts
    pieces = convex_pieces(link.visual, replace(SMALL, most_pieces=4))
    assert 1 <= len(pieces) <= 4
    for piece in pieces:
        assert len(ConvexHull(piece.points).vertices) == len(piece.points)
        a, b, c = (piece.points[piece.triangles[:, i]] for i in range(3))
        outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - piece.points.mean(axis=0))
        assert (outward > 0).all()
    together = np.concatenate([piece.points for piece in pieces])
    assert (together.min(axis=0) < link.visual.points.min(axis=0) + 0.03).all()
    assert (together.max(axis=0) > link.visual.points.max(axis=0) - 0.03).all()


def test_the_mass_of_a_box_is_that_of_the_textbook() -> None:
    config = ExportConfig(density_kg_m3=10.0)
    mass = nominal_mass((hull(BOX),), config)
    assert mass.mass_kg == pytest.approx(60)
    np.testing.assert_allclose(mass.centre, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(mass.inertia, 60 / 12 * np.array([4 + 9, 1 + 9, 1 + 4]))
    halves = BOX * [1, 1, 0.5], BOX * [1, 1, 0.5] + [0, 0, 1.5]
    two = nominal_mass(tuple(map(hull, halves)), config)
    np.testing.assert_allclose(two.inertia, mass.inertia)
    light = nominal_mass((hull(BOX * 1e-2),), config)
    assert light.mass_kg == config.least_mass_kg
    with pytest.raises(InsufficientData, match="without volume"):
        hull(BOX * [1, 1, 0])


def test_a_triangle_points_to_its_own_colour_in_the_palette(tmp_path: Path) -> None:
    colours = np.array([[200, 10, 10], [10, 200, 10], [10, 10, 200]], np.uint8)
    points = np.arange(27, dtype=float).reshape(9, 3)
    mesh = Mesh(points, np.arange(9).reshape(3, 3), colours.repeat(3, axis=0))
    files = coloured_obj(mesh, "thing")
    assert set(files) == {"thing.obj", "thing.mtl", "thing.png"}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    picture = np.asarray(Image.open(tmp_path / "thing.png").convert("RGB"))
    lines = files["thing.obj"].decode().splitlines()
    places = [tuple(map(float, line.split()[1:])) for line in lines if line.startswith("vt ")]
    faces = [line.split()[1:] for line in lines if line.startswith("f ")]
    for face, colour in zip(faces, colours, strict=True):
        fields = {int(corner.split("/")[1]) for corner in face}
        (field,) = fields
        u, v = places[field - 1]
        seen = picture[int((1 - v) * picture.shape[0]), int(u * picture.shape[1])]
        np.testing.assert_allclose(seen, colour, atol=4)


def test_what_is_not_decided_or_not_in_the_format_is_refused(
    door_model, screw_model, with_joint_of
) -> None:
    part = door_model.parts[0]
    undecided = replace(part, posterior=replace(part.posterior, kind="undecided"))
    with pytest.raises(InsufficientData, match="undecided"):
        joint_of(undecided)
    with pytest.raises(InsufficientData, match="URDF has no helical joint"):
        urdf(with_joint_of(screw_model), "meshes")


def test_limits_are_those_met_and_else_those_seen(described) -> None:
    model, description, _ = described["prismatic"]
    said = json.loads(uncertainty_json(model, description))["joints"][0]
    part = model.parts[0]
    assert said["limits"]["met"] is False and said["limits"]["sd"] is None
    np.testing.assert_allclose(said["limits"]["upper"], np.nanmax(part.states.mean))
    assert said["cov"] == part.joint.cov.tolist() and said["pivot"] is None
    met = replace(part, limits=StateLimits(-0.01, 0.4, 0.002))
    limited = replace(model, parts=(met,))
    joint = joint_of(met)
    assert (joint.lower, joint.upper, joint.limits_met) == (-0.01, 0.4, True)
    described_ = replace(description, parts=((joint, description.parts[0][1]),))
    limits = json.loads(uncertainty_json(limited, described_))["joints"][0]["limits"]
    assert limits == {"lower": -0.01, "upper": 0.4, "sd": 0.002, "met": True}


def test_a_glb_shows_the_object_and_moves_its_part(described, kind: str, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    model, description, _ = described[kind]
    file = tmp_path / "object.glb"
    file.write_bytes(glb(description, model))
    scene = trimesh.load(file)
    assert len(scene.geometry) == 2
    T, _ = scene.graph.get("part-0")
    z_to_y = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    part = model.parts[0]
    np.testing.assert_allclose(T[:3, 3], z_to_y @ part.joint.joint.origin, atol=1e-6)
    data = file.read_bytes()
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (animation,) = tree["animations"]
    node = next(n for n in tree["nodes"] if n.get("name") == "part-0")
    assert node["extras"]["joint"]["kind"] == kind and "matrix" not in node
    moved = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        accessor = tree["accessors"][sampler["output"]]
        view = tree["bufferViews"][accessor["bufferView"]]
        raw = base64.b64decode(tree["buffers"][view["buffer"]]["uri"].split(",")[1])
        values = np.frombuffer(raw, "<f4").reshape(accessor["count"], -1)
        moved[channel["target"]["path"]] = values[len(values) // 2]
    upper = part.range_seen()[1]
    there = part.T_world_part(upper)
    x, y, z, w = moved["rotation"]
    assert gtsam.Rot3.Quaternion(w, x, y, z).equals(there.rotation(), 1e-5)
    origin = there.transformFrom(part.joint.joint.origin)
    np.testing.assert_allclose(moved["translation"], origin, atol=1e-5)


def test_the_covariance_of_the_message_is_that_of_sampled_frames(door_model) -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(6, 6)) * np.array([[1e-3, 2e-3, 1e-3, 5e-3, 2e-3, 3e-3]]).T
    joint = replace(door_model.parts[0].joint, cov=spread @ spread.T)
    T = gtsam.Pose3(joint.T_world_joint)
    xi = rng.multivariate_normal(np.zeros(6), joint.cov, 4000, method="eigh")
    rows = []
    for each in xi:
        sample = T.retract(each)
        turn = gtsam.Rot3.Logmap(sample.rotation() * T.rotation().inverse())
        rows.append([*(sample.translation() - T.translation()), *turn])
    found = np.cov(np.array(rows).T)
    scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(
        ros_covariance(joint) / np.outer(scale, scale), found / np.outer(scale, scale), atol=0.1
    )


def test_messages_are_as_ros_writes_them(door_model) -> None:
    (pose_type, pose), (state_type, state) = ros_messages(door_model.parts[0], "base")
    assert pose_type == "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert state_type == "sensor_msgs/msg/JointState"
    fields = json.loads(pose)
    assert fields["header"]["frame_id"] == "base" and len(fields["pose"]["covariance"]) == 36
    q = fields["pose"]["pose"]["orientation"]
    R = gtsam.Rot3.Quaternion(q["w"], q["x"], q["y"], q["z"]).matrix()
    np.testing.assert_allclose(R[:, 2], door_model.parts[0].joint.axis, atol=1e-9)
    last = door_model.parts[0].states.mean[-1]
    assert json.loads(state)["position"] == [pytest.approx(last)]


def test_a_recording_of_other_frames_is_not_the_models(described, tmp_path: Path) -> None:
    model, _, clip = described["prismatic"]
    recording = clip.recording
    write_recording(tmp_path / "seen", recording)
    named = replace(model, sources=("seen",))
    found = recording_of(named, tmp_path)
    assert found is not None and goes_with(model, found)
    assert recording_of(replace(model, sources=("gone",)), tmp_path) is None
    assert not goes_with(model, replace(recording, frames=recording.frames[:-1]))


def test_each_part_is_fused_from_its_own_recording(described, tmp_path: Path) -> None:
    door_model, _, door = described["revolute"]
    drawer_model, alone, drawer = described["prismatic"]
    named = [
        replace(model, sources=(name,))
        for model, name in ((door_model, "door"), (drawer_model, "drawer"))
    ]
    model = with_found(*named, [0.0])
    for name, clip in (("door", door), ("drawer", drawer)):
        write_recording(tmp_path / name, clip.recording)
    found = [recording_of(model, tmp_path, part) for part in range(2)]
    assert [each.name for each in found] == ["door", "drawer"]
    own = describe(model, None, more=[drawer.recording], one_hull=True, config=SMALL)
    (_, _), (joint, link) = own.parts
    (_, expected), *_ = alone.parts
    np.testing.assert_allclose(link.visual.points, expected.visual.points)
    assert joint.name == "part-1-joint"
    said = json.loads(uncertainty_json(model, own))["joints"]
    assert [each["cov"] for each in said] == [p.joint.cov.tolist() for p in model.parts]


def test_a_glb_has_every_part(two_part_model, several_described, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "object.glb"
    file.write_bytes(glb(several_described, two_part_model))
    assert len(trimesh.load(file).geometry) == 3
    data = file.read_bytes()
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    kinds = {n["name"]: n["extras"]["joint"]["kind"] for n in tree["nodes"] if "extras" in n}
    assert kinds == {"part-0": "revolute", "part-1": "prismatic"}
    moved = {
        channel["target"]["node"] for each in tree["animations"] for channel in each["channels"]
    }
    assert {tree["nodes"][node]["name"] for node in moved} == {"part-0", "part-1"}


def test_the_command_writes_all_formats_and_says_where(
    described, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch
) -> None:
    model, _, _ = described["prismatic"]
    monkeypatch.setattr("akm_fg.export.describe.ExportConfig", lambda: SMALL)
    write_model(tmp_path, replace(model, sources=("gone",)))
    out = [str(tmp_path / name) for name in ("u", "m", "o.glb")]
    command = ["export", str(tmp_path), "--urdf", out[0], "--mjcf", out[1], "--glb", out[2]]
    assert main([*command, "--collision", "hull"]) == 0
    captured = capfd.readouterr()
    files = [tmp_path / "u" / "object.urdf", tmp_path / "m" / "object.xml", tmp_path / "o.glb"]
    assert captured.out.split() == [str(file) for file in files]
    assert all(file.stat().st_size for file in files)
    assert json.loads((tmp_path / "u" / "joints.json").read_text())["schema"] == "akm-fg/export/1"
    assert main(["export", str(tmp_path / "model.json"), "--ros"]) == 0
    assert "geometry_msgs/msg/PoseWithCovarianceStamped" in capfd.readouterr().out


def test_what_cannot_be_exported_is_one_line(
    described, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    model, _, clip = described["revolute"]
    write_model(tmp_path, model)
    assert main(["export", str(tmp_path)]) == 2
    assert "nothing to write" in capfd.readouterr().err
    assert main(["export", str(tmp_path / "no"), "--ros"]) == 2
    few = replace(clip.recording, frames=clip.recording.frames[:3])
    write_recording(tmp_path / "few", few)
    urdf_, few_ = str(tmp_path / "u"), str(tmp_path / "few")
    assert main(["export", str(tmp_path), "--urdf", urdf_, "--recording", few_]) == 2
    assert "has 3 frames" in capfd.readouterr().err
    part = model.parts[0]
    undecided = replace(part, posterior=replace(part.posterior, kind="undecided"))
    write_model(tmp_path, replace(model, parts=(undecided,)))
    assert main(["export", str(tmp_path), "--urdf", urdf_]) == 1
    lines = capfd.readouterr().err.splitlines()
    assert any("undecided" in line for line in lines) and not (tmp_path / "u").exists()
