"""Files in other units, of absurd sizes, and objects in a room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from akm_fg.errors import InputError
from sim.objects.imported.contact import _named
from sim.objects.imported.surfaces import Surface
from sim.objects.staging import find_spec

SIDES = [((0.0, y, 0.4), (0.5, 0.02, 0.8)) for y in (-0.29, 0.29)]
BOARD = ((-0.25, 0.0, 0.3), (0.02, 0.56, 0.3))
BAR = ((-0.285, 0.0, 0.3), (0.03, 0.2, 0.015))
WALL = ((-3.0, 0.0, 1.25), (0.1, 4.0, 2.5))
DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}" name="u"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="{n}">{points}</float_array><technique_common>
<accessor source="#a" count="{count}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p>
</triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


def boxes(solids: list, unit: float = 1.0) -> str:
    text = ""
    for middle, sides in solids:
        xyz, size = (" ".join(str(unit * x) for x in numbers) for numbers in (middle, sides))
        text += f'<visual><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></visual>'
    return text


def cabinet(path: Path, corpus: str, part: str, upper: float = 0.4, more: str = "") -> str:
    path.write_text(
        f'<robot name="c"><link name="b">{corpus}</link><link name="d">{part}</link>{more}'
        '<joint name="s" type="prismatic"><parent link="b"/><child link="d"/>'
        f'<axis xyz="-1 0 0"/><limit lower="0" upper="{upper}"/></joint></robot>'
    )
    return str(path)


def test_a_wall_before_the_cabinet_does_not_change_its_handle(tmp_path: Path):
    part = boxes([BOARD, BAR])
    alone, in_room = (
        find_spec(cabinet(tmp_path / f"{i}.urdf", boxes(corpus), part), 0).handle
        for i, corpus in enumerate((SIDES, [*SIDES, WALL]))
    )
    assert alone.style == in_room.style == "protrusion" and in_room.fits
    for name in ("length_m", "thickness_m", "reach_m"):
        assert getattr(alone, name) == pytest.approx(getattr(in_room, name), abs=1e-6)
    p_alone, p_in_room = (h.T_object_handle[[0, 2], 3] for h in (alone, in_room))
    np.testing.assert_allclose(p_alone, p_in_room, atol=1e-6)


def test_a_handle_is_known_by_its_links_name(tmp_path: Path):
    """A moulding stands out farther, so that the geometry alone would choose that."""
    moulding = ((-0.30, 0.0, 0.42), (0.08, 0.2, 0.015))
    for name, style in (("drawer_Pull", "handle"), ("pull_out", "protrusion")):
        more = f'<link name="{name}">{boxes([BAR])}</link><joint name="f" type="fixed">'
        more += f'<parent link="d"/><child link="{name}"/></joint>'
        path = tmp_path / f"{name}.urdf"
        handle = find_spec(
            cabinet(path, boxes(SIDES), boxes([BOARD, moulding]), more=more), 0
        ).handle
        assert handle.style == style
        z = 0.3 if style == "handle" else 0.42
        assert handle.T_object_handle[2, 3] == pytest.approx(z, abs=0.01)


@pytest.mark.parametrize(
    ("name", "is_handle"),
    [("grip", True), ("left-knob2", True), ("pulls", True), ("gripper_board", False)],
)
def test_words_that_name_a_handle(name: str, is_handle: bool):
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    board = Surface("", box.vertices, box.faces, (0.5, 0.5, 0.5), link="door_with_handle")
    assert _named([board]) == []  # the board itself is none
    named = Surface("", box.vertices, box.faces, (0.5, 0.5, 0.5), link=name)
    plain = Surface("", box.vertices, box.faces, (0.5, 0.5, 0.5), link="door")
    assert _named([plain, named]) == ([named] if is_handle else [])


@pytest.mark.parametrize("unit_m", [1.0, 0.001])
def test_a_dae_mesh_is_as_large_as_its_unit_says(unit_m: float, tmp_path: Path):
    bar = trimesh.creation.box(np.array(BAR[1]) / unit_m)
    text = DAE.format(
        unit=unit_m,
        n=bar.vertices.size,
        count=len(bar.vertices),
        faces=len(bar.faces),
        points=" ".join(map(str, bar.vertices.ravel())),
        corners=" ".join(map(str, bar.faces.ravel())),
    )
    (tmp_path / "bar.dae").write_text(text)
    mesh = '<visual><origin xyz="-0.285 0 0.3"/><geometry><mesh filename="bar.dae"/></geometry>'
    part = boxes([BOARD]) + mesh + "</visual>"
    spec = find_spec(cabinet(tmp_path / "c.urdf", boxes(SIDES), part), 0)
    assert spec.handle.length_m == pytest.approx(0.2) and spec.size_m.max() < 1.0


def test_millimetres_are_said_and_absurd_sizes_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    def of_unit(unit: float) -> str:
        corpus, part = (boxes(solids, unit) for solids in (SIDES, [BOARD, BAR]))
        return cabinet(tmp_path / f"{unit}.urdf", corpus, part, 0.4 * unit)

    find_spec(of_unit(1000.0), 0)
    (line,) = caplog.messages
    assert "largest side is 800 m: probably millimetres; write lengths in metres" in line
    for unit in (1e9, 1e200, 1e-4):
        with pytest.raises(InputError, match=r"largest side is .* m; expected metres") as caught:
            find_spec(of_unit(unit), 0)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("part", "upper", "told"),
    [
        (boxes([((0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6))]), 0.4, "what joint 's' moves is 1e-06 m"),
        (boxes([BOARD]), 1e300, "joint 's' goes over 1e+300 m; expected limits in metres"),
        (boxes([((0, 0, 0), (0, 0, 0))]), 0.4, "(link 'd' has a box without size; left out)"),
    ],
)
def test_a_part_without_size_and_a_way_without_end_are_one_line(
    part: str, upper: float, told: str, tmp_path: Path
):
    with pytest.raises(InputError) as caught:
        find_spec(cabinet(tmp_path / "c.urdf", boxes(SIDES), part, upper), 0)
    assert told in str(caught.value) and "\n" not in str(caught.value)
