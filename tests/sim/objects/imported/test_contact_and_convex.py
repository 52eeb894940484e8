"""Where foreign parts can be gripped, and what stands for their shape in contact."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
import trimesh

from sim.objects.imported import collision_pieces
from sim.objects.imported.collision_pieces import link_pieces
from sim.objects.imported.contact import EDGE_GRIP_M, find_contact
from sim.objects.imported.convex import convex_pieces
from sim.objects.imported.decomposition import COARSE
from sim.objects.imported.imported_build import inertia_of_hulls
from sim.objects.imported.imported_spec import ImportOptions
from sim.objects.imported.surfaces import Surface
from sim.objects.staging import find_spec
from sim.objects.suites.handles import R_LYING

DOOR = {"kind": "revolute", "axis": "0 1 0", "origin": (-0.45, 0.0, 0.52), "limits": (-1.57, 0.0)}


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    base = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    return base / "akm-fg"


def decomposed(cache: Path) -> dict[str, int]:
    """What is kept of decompositions: file -> when it was written."""
    return {str(file): file.stat().st_mtime_ns for file in cache.glob("convex-*/pieces.npz")}


def test_a_concave_mesh_is_decomposed_once_for_all_scales(own_cache: Path):
    corner = trimesh.creation.box([1.0, 1.0, 2.0])
    corner.apply_translation([0.3, 0.3, 0.0])
    angle = trimesh.boolean.difference([trimesh.creation.box([1.0, 1.0, 1.0]), corner])
    pieces = convex_pieces(angle.vertices, angle.faces)
    volume = sum(trimesh.convex.convex_hull(piece).volume for piece in pieces)
    assert len(pieces) >= 2 and volume == pytest.approx(angle.volume, rel=0.05)
    ran = decomposed(own_cache)
    larger = convex_pieces(3.0 * angle.vertices + 1.0, angle.faces)
    assert len(ran) == 1 and decomposed(own_cache) == ran
    np.testing.assert_allclose(larger[0], 3.0 * pieces[0] + 1.0, atol=1e-5)


def test_only_what_the_hand_comes_near_is_decomposed_finely(own_cache: Path):
    def arch(width: float, middle: tuple[float, float, float]) -> Surface:
        """Two legs and a top, with room below."""
        cut = trimesh.creation.box([0.8, 2.0, 1.6]).apply_translation([0.0, 0.0, -0.9])
        mesh = trimesh.boolean.difference([trimesh.creation.box([1.0, 1.0, 2.0]), cut])
        mesh.apply_scale(width).apply_translation(middle)
        return Surface("arch", mesh.vertices, mesh.faces, (0.5, 0.5, 0.5))

    def volumes(surface: Surface, grip: list[float]) -> float:
        T = gtsam.Pose3(gtsam.Rot3(R_LYING), np.array(grip))
        pieces = link_pieces("corpus", [surface], [T])
        volume = sum(trimesh.convex.convex_hull(piece).volume for piece in pieces)
        return float(volume / surface.mesh().volume)

    table, handle = arch(1.0, (0.0, 0.0, 0.0)), arch(0.1, (0.0, 0.0, 0.0))
    assert volumes(table, [3.0, 0.0, 0.0]) > 1.15  # coarse, where nobody takes hold
    below = np.array([[x, 0.0, z] for x in (-0.3, 0.0, 0.3) for z in (-0.9, -0.5, 0.0, 0.5)])
    coarse = [
        trimesh.convex.convex_hull(piece)
        for piece in convex_pieces(table.points, table.faces, COARSE)
    ]
    filled = below[np.any([hull.contains(below) for hull in coarse], axis=0)]
    assert len(filled)
    for grip in filled.tolist():  # there the hand would stand within a piece
        assert volumes(table, grip) == pytest.approx(1.0, abs=0.1)
    assert volumes(handle, [0.0, 0.0, 0.08]) == pytest.approx(1.0, abs=0.1)
    assert volumes(handle, [3.0, 0.0, 0.0]) > 1.15


def test_a_long_decomposition_tells_how_far_it_is(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(collision_pieces, "EVERY_S", -1.0)
    caplog.set_level("INFO", "akm_fg.progress")
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    surface = Surface("box", box.vertices, box.faces, (0.5, 0.5, 0.5))
    link_pieces("corpus", [surface, surface], [gtsam.Pose3()])
    assert caplog.messages[-1] == "collision shapes of the corpus: 1 of 2 meshes"


@pytest.mark.parametrize("flat", [True, False])
def test_what_is_convex_or_flat_needs_no_decomposition(flat: bool, own_cache: Path):
    box = trimesh.creation.box([1.0, 1.0, 0.3])
    if flat:
        box = trimesh.Trimesh([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]])
    (piece,) = convex_pieces(box.vertices, box.faces)
    assert trimesh.convex.convex_hull(piece).volume == pytest.approx(0.002 if flat else 0.3)
    assert decomposed(own_cache) == {}


def test_a_front_without_handle_is_pinched_at_its_free_edge_or_said_not_to_fit(
    mobility_object, solid, tmp_path: Path
):
    bare = [solid((0.0, 0.0, 0.53), (0.02, 0.02, 0.02), "paint")]  # within the board
    inset = mobility_object(**DOOR, handle=bare).write(tmp_path / "1")
    wide = [solid((0.05, 0.0, 0.52), (1.0, 1.1, 0.04), "paint")]
    over = mobility_object(**DOOR, part=wide, handle=bare).write(tmp_path / "2")
    for folder in (inset, over):  # the names in the file say `handle`; take them away
        urdf = folder / "mobility.urdf"
        urdf.write_text(urdf.read_text().replace('name="handle-3"', 'name="panel-3"'))
    shut, proud = (find_spec(f"partnet:{f}", 0).handle for f in (inset, over))
    assert shut.style == proud.style == "edge"
    assert proud.fits and not shut.fits
    np.testing.assert_allclose(proud.T_object_handle[:3, 2], [-1.0, 0.0, 0.0])  # from the right


def test_a_protrusion_serves_as_handle_and_a_point_may_be_given(mobility_object, tmp_path: Path):
    folder = mobility_object().write(tmp_path / "1")
    urdf = folder / "mobility.urdf"
    metres = ImportOptions(scale=1.0)
    named = find_spec(f"partnet:{folder}", 0, options=metres).handle
    urdf.write_text(urdf.read_text().replace('name="handle-3"', 'name="thing-3"'))
    found = find_spec(f"partnet:{folder}", 0, options=metres).handle
    assert found.style == "protrusion"
    np.testing.assert_allclose(found.T_object_handle, named.T_object_handle, atol=0.01)
    point = tuple(float(x) for x in named.T_object_handle[:3, 3] + [0.05, 0.0, 0.0])
    given = find_spec(
        f"partnet:{folder}", 0, options=ImportOptions(scale=1.0, contact=point)
    ).handle
    assert given.style == "given"
    assert np.linalg.norm(given.T_object_handle[:3, 3] - point) < 0.03


def test_a_front_below_its_own_back_is_pinched_at_the_front():
    def board(middle: tuple[float, float, float], sides: list[float]) -> Surface:
        box = trimesh.creation.box(sides).apply_translation(middle)
        return Surface("board", box.vertices, box.faces, (0.5, 0.5, 0.5))

    front = board((0.0, -0.25, 0.20), [0.56, 0.02, 0.15])
    floor = board((0.0, -0.02, 0.14), [0.5, 0.45, 0.01])
    back = board((0.0, 0.20, 0.35), [0.5, 0.01, 0.4])
    contact = find_contact([front, floor, back], [], None, np.zeros(3))
    assert contact.style == "edge" and contact.fits
    assert contact.thickness_m == pytest.approx(0.02, abs=1e-3)
    at_edge = [0.0, -0.25, 0.275 - EDGE_GRIP_M]
    np.testing.assert_allclose(contact.T_object_handle[:3, 3], at_edge, atol=5e-3)


def test_hulls_share_the_mass_by_volume_and_have_the_textbook_inertia():
    left, right = (trimesh.creation.box([1.0, 2.0, 3.0]) for _ in range(2))
    right.apply_translation([1.0, 0.0, 0.0])  # beside it: a box of 2 x 2 x 3
    com, inertia = inertia_of_hulls([left, right], 12.0)
    np.testing.assert_allclose(com, [0.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(inertia, np.diag([13.0, 13.0, 8.0]), atol=1e-4)
