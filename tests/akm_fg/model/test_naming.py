"""The part that is meant: by number, name, pixel or point; none and two are one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.model.naming import Pixel, Point, part_name, part_named


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("2", 2),
        ("part-2", "part-2"),
        ("412,230", Pixel(412, 230)),
        ("0.6,-0.1,.4", Point((0.6, -0.1, 0.4))),
        (" 411.6, 230 ", Pixel(412, 230)),
    ],
)
def test_what_a_person_writes_is_understood(text: str, name: object) -> None:
    assert part_name(text) == name


@pytest.mark.parametrize("text", ["", "1,2,3,4", "a,b", "nan,1", "1,", "inf,0,0"])
def test_what_names_nothing_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="--part") as caught:
        part_name(text)
    assert "\n" not in str(caught.value)


def test_numbers_and_names_are_those_of_the_model(two_part_model, door_model) -> None:
    assert part_named(two_part_model, 1) == 1
    assert part_named(two_part_model, "part-0") == 0
    assert part_named(door_model, None) == 0
    for name in (2, "lid", None, -1):
        with pytest.raises(InputError, match="--part"):
            part_named(two_part_model, name)


def test_a_pixel_names_the_part_that_it_shows(two_part_model, door) -> None:
    """At its state: the open door is looked for where it stands, and nowhere else."""
    frame, q = door.frames[-1], float(door.states[-1])
    v, u = np.argwhere(door.labels[-1] == 2).mean(axis=0).round().astype(int)
    there = two_part_model.parts[0].states.mean[-1]
    assert abs(there) == pytest.approx(q, abs=0.05)
    assert part_named(two_part_model, Pixel(u, v), frame=frame, states=[there, 0.0]) == 0
    assert part_named(two_part_model, Pixel(u, v), frame=frame) == 0  # wherever it stands
    with pytest.raises(InputError, match="on no part"):
        part_named(two_part_model, Pixel(u, v), frame=frame, states=[0.0, 0.0])
    hole = np.array(frame.depth_m)
    hole[v, u] = np.nan
    holed = replace(frame, depth_m=hole)
    assert part_named(two_part_model, Pixel(u, v), frame=holed, states=[there, None]) == 0
    with pytest.raises(InputError, match="not in the picture"):
        part_named(two_part_model, Pixel(10_000, v), frame=frame)
    blind = replace(frame, depth_m=np.full_like(hole, np.nan))
    with pytest.raises(InputError, match="has no depth"):
        part_named(two_part_model, Pixel(u, v), frame=blind)
    with pytest.raises(ValueError, match="picture"):
        part_named(two_part_model, Pixel(u, v))


def test_a_point_names_the_part_that_it_is_on(two_part_model) -> None:
    assert part_named(two_part_model, Point((0.02, -0.1, 0.5)), states=[0.0, 0.0]) == 0
    assert part_named(two_part_model, Point((0.02, 0.6, 0.5)), states=[0.0, 0.0]) == 1
    assert part_named(two_part_model, Point((0.17, 0.6, 0.5))) == 1  # the drawer, 15 cm open
    with pytest.raises(InputError, match="on no part"):
        part_named(two_part_model, Point((0.5, 3.0, 0.5)))
    with pytest.raises(ValueError, match="states"):
        part_named(two_part_model, 0, states=[0.0])


def test_what_rests_or_lies_between_two_parts_names_none(two_part_model, door_model) -> None:
    """Of a carcass' front strip beside the door, and of a door that is there twice."""
    with pytest.raises(InputError, match="does not move"):
        part_named(door_model, Point((0.0, 0.295, 0.5)), states=[0.0])
    part = replace(door_model.parts[0], name="part-1")
    twice = replace(door_model, parts=(*door_model.parts, part))
    with pytest.raises(InputError, match="part-0 or part-1"):
        part_named(twice, Point((0.02, -0.1, 0.5)), states=[0.0, 0.0])
