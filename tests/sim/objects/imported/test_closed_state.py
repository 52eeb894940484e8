"""Where foreign joints are closed, which way they open, and which side is the front."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.objects.imported.assembly import assemble
from sim.objects.urdf.urdf_reader import read_urdf

HINGE = {"kind": "revolute", "axis": "0 1 0", "origin": (-0.45, 0.0, 0.52)}  # stands, at the left
INWARD = "0 0 -1"  # of the mesh files, whose front is +z
# limits in the file, axis, and what is found: closed, sign, travel, depth of the closed object
SLIDES = {
    "plain": ((0.0, 0.5), "0 0 1", (0.0, 1.0, 0.5, 1.125)),
    "swapped": ((0.0, -1.0), INWARD, (0.0, -1.0, 1.0, 1.125)),
    "negative": ((-0.7, 0.0), INWARD, (0.0, -1.0, 0.7, 1.125)),
    "closed at neither end's zero": ((-0.576, 0.136), INWARD, (0.136, -1.0, 0.712, 1.0)),
    "modelled open": ((-0.5, 0.2), "0 0 1", (-0.5, 1.0, 0.7, 1.0)),
}


@pytest.mark.parametrize("case", SLIDES)
def test_a_drawer_is_closed_at_the_end_where_the_whole_is_smaller(
    case: str, mobility_object, tmp_path: Path
):
    limits, axis, (closed, sign, travel, depth) = SLIDES[case]
    found = assembled(mobility_object(limits=limits, axis=axis).write(tmp_path / "1"))
    assert (found.opening.closed, found.opening.sign) == (closed, sign)
    assert found.travel == pytest.approx(travel)
    assert found.size_m[1] == pytest.approx(depth)  # the part stands closed
    np.testing.assert_allclose(found.axis, [0.0, -1.0, 0.0], atol=1e-9)  # out of the front


@pytest.mark.parametrize(
    ("limits", "sign"), [((-1.57, 0.0), -1.0), ((0.0, -1.57), -1.0)], ids=["sorted", "swapped"]
)
def test_a_door_with_negative_limits_opens_outwards_from_zero(
    limits: tuple[float, float], sign: float, mobility_object, tmp_path: Path
):
    found = assembled(mobility_object(**HINGE, limits=limits).write(tmp_path / "1"))
    assert (found.opening.closed, found.opening.sign) == (0.0, sign)
    assert opens_outwards(found)


@pytest.mark.parametrize("axis", ["0 1 0", "0 -1 0"])
def test_a_joint_without_limits_opens_the_way_that_leads_out_of_the_object(
    axis: str, mobility_object, tmp_path: Path
):
    folder = mobility_object(**{**HINGE, "axis": axis, "kind": "continuous"}, limits=None).write(
        tmp_path / "1"
    )
    found = assembled(folder)
    assert found.opening.closed == 0.0
    assert found.travel == pytest.approx(2.0 * np.pi)
    assert opens_outwards(found)


def test_a_joint_that_changes_nothing_of_the_box_is_closed_at_the_end_nearer_to_zero(
    mobility_object, solid, tmp_path: Path
):
    # A panel within the opening that slides sideways.
    panel = [solid((0.0, 0.0, 0.49), (0.4, 1.1, 0.02))]
    knob = [solid((0.1, 0.0, 0.499), (0.03, 0.03, 0.002))]
    for limits, closed in (((-0.03, 0.25), -0.03), ((0.04, -0.25), 0.04), ((-0.02, 0.02), -0.02)):
        folder = mobility_object(axis="1 0 0", part=panel, handle=knob, limits=limits).write(
            tmp_path / str(closed)
        )
        found = assembled(folder)
        assert found.opening.closed == closed
        np.testing.assert_allclose(np.abs(found.axis), [1.0, 0.0, 0.0], atol=1e-9)
        # The front is the side on which the panel lies, not the one towards which it slides.
        assert max(s.points[:, 1].max() for s in found.part) < 0.0


def test_a_lid_on_top_faces_the_robot_with_its_free_edge(mobility_object, solid, tmp_path: Path):
    lid = [solid((0.0, 0.62, 0.0), (1.0, 0.04, 1.0))]
    grip = [solid((0.0, 0.66, 0.45), (0.2, 0.04, 0.03))]
    folder = mobility_object(
        kind="revolute", axis="-1 0 0", origin=(0.0, 0.62, -0.5), part=lid, handle=grip
    ).write(tmp_path / "1")
    found = assembled(folder)
    assert found.pivot[1] > 0.2  # the hinge is at the back
    rises = np.cross(found.axis, np.array([0.0, -0.5, 0.0]))
    assert rises[2] > 0.0


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_the_scale_multiplies_origins_and_the_range_of_slides_but_not_angles(
    scale: float, mobility_object, tmp_path: Path
):
    drawer = mobility_object(limits=(0.0, 0.5), origin=(0.1, 0.0, 0.2)).write(tmp_path / "1")
    door = mobility_object(**HINGE, limits=(-1.57, 0.0)).write(tmp_path / "2")
    for folder, angular in ((drawer, False), (door, True)):
        one, other = assembled(folder), assembled(folder, scale)
        np.testing.assert_allclose(other.size_m, scale * one.size_m)
        np.testing.assert_allclose(other.pivot, scale * one.pivot, atol=1e-12)
        assert other.travel == pytest.approx(one.travel * (1.0 if angular else scale))
        np.testing.assert_allclose(other.part[0].points, scale * one.part[0].points, atol=1e-12)


def test_root_rotations_stand_the_object_up_on_the_floor_with_its_front_ahead(
    mobility_object, tmp_path: Path
):
    found = assembled(mobility_object(limits=(0.0, 0.5)).write(tmp_path / "1"))
    points = np.concatenate([s.points for s in (*found.corpus, *found.part)])
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(high - low, [1.0, 1.125, 1.2], atol=1e-6)
    assert low[2] == pytest.approx(0.0)
    np.testing.assert_allclose((low + high)[:2], 0.0, atol=1e-9)
    assert np.concatenate([s.points for s in found.part])[:, 1].min() == pytest.approx(low[1])


def assembled(folder: Path, scale: float = 1.0):
    model = read_urdf(folder / "mobility.urdf")
    return assemble(model, model.joint("joint_0"), scale, 1.0, None)


def opens_outwards(found) -> bool:
    """Whether a standing door's far edge sets out to the front, -y, where its handle is."""
    handle, board = (
        min(s.points[:, 1].min() for s in found.part if s.name.startswith(name))
        for name in ("handle", "front")
    )
    assert handle < board
    points = np.concatenate([s.points for s in found.part])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    return float(np.cross(found.axis, middle - found.pivot)[1]) < -0.1
