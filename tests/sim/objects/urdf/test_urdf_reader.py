"""Reading URDF files: what is in them, and one clear line for each way they can be broken."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

from akm_fg.errors import InputError
from sim.objects.urdf.urdf_reader import read_urdf

BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
LINKS = f'<link name="a">{BOX}</link><link name="b">{BOX}</link>'


def joint(name: str = "j", kind: str = "revolute", ends: str = "ab", rest: str = "") -> str:
    limit = '<limit lower="0" upper="1"/>' if kind != "continuous" and "<limit" not in rest else ""
    axis = "" if "<axis" in rest else '<axis xyz="0 0 1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f"{axis}{limit}{rest}</joint>"
    )


def write(folder: Path, body: str, tag: str = "robot") -> Path:
    path = folder / "object.urdf"
    path.write_text(f'<{tag} name="r">{body}</{tag}>')
    return path


MESH = '<visual><geometry><mesh filename="gone.obj"/></geometry></visual>'
XACRO = "http://www.ros.org/wiki/xacro"
BROKEN = {
    "is not XML": "<link",
    "has no links": "",
    "no link of that name": LINKS + joint(ends="ac"),
    "form a loop": LINKS + joint() + joint("k", ends="ba"),
    "hangs on several joints": LINKS + joint() + joint("k"),
    "links a, b have no parent": LINKS,
    "lies outside the object's folder": f'<link name="a">{MESH.replace("gone", "../gone")}</link>',
    "is of type 'bendy'": LINKS + joint(kind="bendy"),
    "has no <limit>": LINKS + joint().replace('<limit lower="0" upper="1"/>', ""),
    "has a zero axis": LINKS + joint(rest='<axis xyz="0 0 0"/>'),
    "expected 3 finite numbers": LINKS + joint(rest='<origin xyz="0 nan 0"/>'),
    "expected 1 finite number": LINKS + joint(rest='<limit lower="x" upper="1"/>'),
    "lacks a parent": LINKS + '<joint name="j" type="fixed"><child link="b"/></joint>',
    "negative size": LINKS.replace('<box size="1 1 1"/>', '<sphere radius="-1"/>'),
    "is a xacro file": LINKS + f'<x:arg xmlns:x="{XACRO}" name="n"/>',
    "shape that is not known": '<link name="a"><visual><geometry/></visual></link>',
    "has no name": "<link/>",
}
BROKEN["names a link 'c' that is not there; expected one of a, b"] = BROKEN.pop(
    "no link of that name"
)


@pytest.mark.parametrize("told", BROKEN)
def test_a_broken_file_gets_one_line_that_says_what_is_wrong(told: str, tmp_path: Path):
    path = write(tmp_path, BROKEN[told])
    with pytest.raises(InputError) as caught:
        read_urdf(path)
    line = str(caught.value)
    assert told in line and str(path) in line and "expected" in line and "\n" not in line


HINGE = joint(rest='<limit lower="0" upper="90"/>')
DOUBTFUL = {
    "mesh 'gone.obj' of link 'a' is missing; left out": LINKS.replace(BOX, MESH, 1) + joint(),
    "link 'a' has a box without size; left out": LINKS.replace("1 1 1", "0 0 0", 1) + joint(),
    "joint 'j' names no axis; it is x then": LINKS + joint(rest="<axis/>"),
    "has limits of up to 90 rad, more than a turn: probably degrees": LINKS + HINGE,
    "joint 'j' should follow 'k' (mimic)": LINKS + joint(rest='<mimic joint="k"/>'),
}


@pytest.mark.parametrize("told", DOUBTFUL)
def test_what_is_probably_not_meant_so_is_read_and_noted(told: str, tmp_path: Path):
    model = read_urdf(write(tmp_path, DOUBTFUL[told]))
    (note,) = model.notes
    assert told in note and "\n" not in note and str(tmp_path) not in note
    assert len(model.links["a"].visuals) == (0 if "left out" in told else 1)
    assert model.joints[0].axis.tolist() == ([1, 0, 0] if "axis" in told else [0, 0, 1])
    assert read_urdf(write(tmp_path, LINKS + joint())).notes == ()


def test_a_slide_over_seven_metres_and_an_expanded_xacro_are_not_doubted(tmp_path: Path):
    long = joint(kind="prismatic", rest='<limit lower="0" upper="7"/>')
    path = write(tmp_path, LINKS + long)
    path.write_text(path.read_text().replace("<robot", f'<robot xmlns:xacro="{XACRO}"'))
    assert read_urdf(path).notes == ()


@pytest.mark.parametrize("filename", ["/etc/m.stl", "package://p/../../m.stl", "link/m.stl"])
def test_meshes_come_from_the_objects_folder_alone(filename: str, tmp_path: Path):
    folder, outside = tmp_path / "object", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    for place in (outside, tmp_path):
        (place / "m.stl").write_text("solid m\nendsolid m\n")
    (folder / "link").symlink_to(outside)
    body = f'<link name="a">{MESH.replace("gone.obj", filename)}</link>'
    path = write(folder, body)
    with pytest.raises(InputError, match="lies outside the object's folder and packages"):
        read_urdf(path)


def test_a_package_around_the_file_gives_its_meshes(tmp_path: Path):
    folder = tmp_path / "robots" / "one"
    folder.mkdir(parents=True)
    (tmp_path / "package.xml").touch()
    (tmp_path / "m.stl").write_text("solid m\nendsolid m\n")
    model = read_urdf(
        write(folder, f'<link name="a">{MESH.replace("gone.obj", "../../m.stl")}</link>')
    )
    assert model.links["a"].visuals[0].mesh.samefile(tmp_path / "m.stl")


@pytest.mark.parametrize("encoding", ["utf-7", "no-such-encoding"])
def test_an_encoding_that_cannot_be_read_is_one_line(encoding: str, tmp_path: Path):
    path = write(tmp_path, LINKS + joint())
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?>{path.read_text()}')
    with pytest.raises(InputError, match="is not XML"):
        read_urdf(path)


def test_a_mesh_name_that_no_file_can_have_is_one_short_line(tmp_path: Path):
    shape = MESH.replace("gone", "m" * 5000)
    with pytest.raises(InputError, match="cannot be looked for") as caught:
        read_urdf(write(tmp_path, f'<link name="a">{shape}</link>'))
    assert len(str(caught.value)) < 300


ENTITIES = {
    "outside": '<!ENTITY x SYSTEM "secret.txt">',
    "bomb": '<!ENTITY a "0123456789">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in pairwise("abcdefgh"))
    + '<!ENTITY x "&h;">',
}


@pytest.mark.parametrize("entity", ENTITIES)
def test_entities_neither_fetch_nor_fill_memory(entity: str, tmp_path: Path):
    (tmp_path / "secret.txt").write_text("secret")
    path = write(tmp_path, LINKS.replace('<link name="a">', '<link name="a">&x;') + joint())
    path.write_text(f"<!DOCTYPE robot [{ENTITIES[entity]}]>{path.read_text()}")
    with pytest.raises(InputError, match="is not XML"):
        read_urdf(path)


def test_a_loop_beside_a_root_is_found_too(tmp_path: Path):
    links = LINKS + '<link name="c"/>'
    with pytest.raises(InputError, match="loop"):
        read_urdf(write(tmp_path, links + joint() + joint("k", ends="ba")))


@pytest.mark.parametrize("tag", ["sdf", "mujoco"])
def test_another_format_is_named(tag: str, tmp_path: Path):
    with pytest.raises(InputError, match=f"its root is <{tag}>; expected <robot>"):
        read_urdf(write(tmp_path, "", tag))


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        read_urdf(tmp_path / "object.urdf")


def test_the_joint_must_be_named_where_several_move_and_known_where_it_is(tmp_path: Path):
    third = '<link name="c"/>'
    two = read_urdf(write(tmp_path, LINKS + third + joint() + joint("k", "prismatic", "bc")))
    with pytest.raises(
        InputError, match="several joints move; expected one named by --joint: j, k"
    ):
        two.joint(None)
    with pytest.raises(InputError, match="no joint 'x' that moves; expected one of j, k"):
        two.joint("x")
    assert two.joint("k").kind == "prismatic"
    one = read_urdf(write(tmp_path, LINKS + joint()))
    assert one.joint(None).name == "j"


def test_a_file_without_a_moving_joint_is_refused_when_one_is_asked_for(tmp_path: Path):
    still = LINKS + joint(kind="fixed")
    with pytest.raises(InputError, match="has no joint that moves"):
        read_urdf(write(tmp_path, still)).joint(None)
    no_way = LINKS + joint(rest='<limit lower="0.2" upper="0.2"/>')
    assert read_urdf(write(tmp_path, no_way)).movable() == ()


def test_swapped_limits_are_sorted_and_a_continuous_joint_has_none(tmp_path: Path):
    swapped = read_urdf(write(tmp_path, LINKS + joint(rest='<limit lower="0" upper="-1"/>')))
    assert (swapped.joints[0].lower, swapped.joints[0].upper) == (-1.0, 0.0)
    free = read_urdf(write(tmp_path, LINKS + joint(kind="continuous")))
    assert (free.joints[0].lower, free.joints[0].upper) == (-np.inf, np.inf)


def test_package_paths_are_found_above_the_file(tmp_path: Path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "m.stl").write_text("solid m\nendsolid m\n")
    (tmp_path / "urdf").mkdir()
    mesh = '<visual><geometry><mesh filename="package://any/meshes/m.stl"/></geometry></visual>'
    model = read_urdf(write(tmp_path / "urdf", f'<link name="a">{mesh}</link>'))
    assert model.links["a"].visuals[0].mesh == tmp_path / "meshes" / "m.stl"


@pytest.mark.parametrize(
    "name", ["../library/any/m.stl", "package://any/m.stl", "{library}/any/m.stl"]
)
def test_a_mesh_outside_is_taken_from_the_folder_that_is_allowed(name: str, tmp_path: Path):
    folder, library, other = (tmp_path / x for x in ("object", "library", "other"))
    for place in (folder / "urdf", library / "any", other):
        place.mkdir(parents=True)
    mesh = library / "any" / "m.stl"
    mesh.write_text("solid m\nendsolid m\n")
    name = name.replace("{library}", str(library))
    path = write(folder, f'<link name="a">{MESH.replace("gone.obj", name)}</link>')
    found = read_urdf(path, library).links["a"].visuals[0].mesh
    assert found is not None and found.samefile(mesh)
    if name.startswith("package"):
        assert not read_urdf(path, other).links["a"].visuals
        return
    with pytest.raises(InputError, match=r"lies outside .* or --allow DIR"):
        read_urdf(path, other)


def test_links_stand_where_another_reader_has_them(mobility_object, tmp_path: Path):
    folder = mobility_object(second_joint=True, origin=(0.1, 0.2, 0.3)).write(tmp_path / "1")
    model = read_urdf(folder / "mobility.urdf")
    other = yourdfpy.URDF.load(str(folder / "mobility.urdf"), load_meshes=False)
    states = {"joint_0": 0.4, "joint_2": 0.7}
    other.update_cfg(states)
    for link, T in model.T_root_links(states).items():
        np.testing.assert_allclose(T.matrix(), other.get_transform(link, "base"), atol=1e-9)
    assert model.below(model.joint("joint_0")) == {"link_0"}
    assert model.below(model.joints[[j.name for j in model.joints].index("joint_1")]) == {
        "link_0",
        "link_1",
        "link_2",
    }


RICH = """
<material name="oak"><color rgba="0.6 0.4 0.2 1"/></material>
<link name="base"><inertial><mass value="7.5"/></inertial>
  <visual name="side"><origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><material name="oak"/>
    <geometry><box size="0.5 0.6 0.7"/></geometry></visual>
  <visual><geometry><mesh filename="m.stl" scale="0.001"/></geometry></visual>
  <collision><origin rpy="0 1.5 0"/>
    <geometry><cylinder radius="0.2" length="0.9"/></geometry></collision></link>
<link name="lid">
  <visual><geometry><mesh filename="m.stl" scale="1 -2 3"/></geometry></visual></link>
<link name="knob"><visual><geometry><sphere radius="0.03"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/>
  <origin xyz="1 2 3" rpy="-0.1 0.2 -0.3"/><axis xyz="0 0.6 -0.8"/>
  <limit lower="-0.5" upper="1.5" effort="1" velocity="1"/><dynamics damping="0.7" friction="0.2"/>
</joint>
<joint name="slide" type="prismatic"><parent link="lid"/><child link="knob"/>
  <limit upper="0.1" effort="1" velocity="1"/><mimic joint="hinge" multiplier="2"/></joint>
"""


def test_every_number_is_what_another_reader_has(tmp_path: Path):
    (tmp_path / "m.stl").write_text("solid m\nendsolid m\n")
    path = write(tmp_path, RICH)
    ours, theirs = read_urdf(path), yourdfpy.URDF.load(str(path), load_meshes=False)
    for joint_, other in zip(ours.joints, theirs.robot.joints, strict=True):
        T = np.eye(4) if other.origin is None else other.origin
        np.testing.assert_allclose(joint_.T_parent_joint.matrix(), T, atol=1e-12)
        np.testing.assert_allclose(joint_.axis, other.axis)
        limits = (other.limit.lower or 0.0, other.limit.upper)
        assert (joint_.name, joint_.kind) == (other.name, other.type)
        assert (joint_.lower, joint_.upper) == limits
        assert (joint_.parent, joint_.child) == (other.parent, other.child)
    hinge, dynamics = ours.joints[0], theirs.robot.joints[0].dynamics
    assert (hinge.damping, hinge.friction) == (float(dynamics.damping), float(dynamics.friction))
    for link in theirs.robot.links:
        mine = ours.links[link.name]
        assert mine.mass_kg == (link.inertial.mass if link.inertial else None)
        for shapes, others in ((mine.visuals, link.visuals), (mine.collisions, link.collisions)):
            for shape, other in zip(shapes, others, strict=True):
                T = np.eye(4) if other.origin is None else other.origin
                np.testing.assert_allclose(shape.T_link_shape.matrix(), T, atol=1e-12)
                np.testing.assert_allclose(shape.size, _size(other.geometry))
    oak = ours.links["base"].visuals[0].rgb
    np.testing.assert_allclose(oak, theirs.robot.materials[0].color.rgba[:3])


def _size(geometry: yourdfpy.Geometry) -> np.ndarray:
    """(3,) as in `Shape.size`."""
    if geometry.box is not None:
        return geometry.box.size
    if geometry.cylinder is not None:
        return np.array([geometry.cylinder.radius] * 2 + [geometry.cylinder.length])
    if geometry.sphere is not None:
        return np.full(3, geometry.sphere.radius)
    return np.ones(3) * geometry.mesh.scale


def test_an_axis_of_any_length_is_a_direction(tmp_path: Path) -> None:
    """Squared, this one is no number: found by tests/akm_fg/test_fuzz_results.py."""
    path = write(tmp_path, LINKS + joint(rest='<axis xyz="0 3e300 4e300"/>'))
    np.testing.assert_allclose(read_urdf(path).joints[0].axis, [0.0, 0.6, 0.8])
