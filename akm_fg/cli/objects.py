"""`akm-fg objects`: which objects a suite has."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from akm_fg.cli.exit_codes import DONE
from akm_fg.cli.output import json_output, write_line

if TYPE_CHECKING:
    from sim.suites.catalogue import Suite
    from sim.suites.furniture_spec import FurnitureSpec


@dataclass(frozen=True)
class ObjectsArguments:
    """Example: akm-fg objects --suite furniture-dev --json objects.json

    Lists the objects of a suite: name, kind of joint, range, size, handle, surface. Names are
    those that other commands take as OBJECT: furniture-dev/door-003. furniture-116 is the
    benchmark, on which nothing may be tuned; furniture-dev is for that.
    """

    suite: str = "furniture-dev"
    """furniture-116 or furniture-dev."""
    json: str | None = None
    """Write the list as one JSON object to this file; - is standard output (no table then)."""
    seed: int = 0
    """Of the meeting: varies the scale (0.9 to 1.1) and with it the sizes."""


def objects(arguments: ObjectsArguments) -> int:
    """Run the command.

    Raises:
        InputError: no such suite.
        OutputError: the file cannot be written.
    """
    from sim.suites.catalogue import find_suite

    suite = find_suite(arguments.suite)
    specs = [suite.load(name, arguments.seed) for name in suite.names()]
    with json_output(arguments.json) as stream:
        if stream is not None:
            listing = {
                "schema": "akm-fg/objects/1",
                "suite": suite.name,
                "split": suite.split,
                "seed": arguments.seed,
                "objects": [_as_dict(spec) for spec in specs],
            }
            write_line(stream, json_module.dumps(listing, allow_nan=False))
    if arguments.json != "-":
        _print(suite, specs)
    return DONE


def _as_dict(spec: FurnitureSpec) -> dict[str, Any]:
    handle = spec.handle
    return {
        "name": spec.name,
        "kind": spec.kind,
        "range": [0.0, spec.upper],
        "unit": "m" if spec.kind == "prismatic" else "rad",
        "family": spec.family,
        "hinge": spec.hinge,
        "size_m": spec.size_m.tolist(),
        "handle": {
            "style": handle.style,
            "length_m": handle.length_m,
            "thickness_m": handle.thickness_m,
            "reach_m": handle.reach_m,
        },
        "mass_kg": spec.mass_kg,
        "friction": spec.friction,
        "damping": spec.damping,
        "finish": spec.finish,
        "split": spec.split,
    }


def _print(suite: Suite, specs: list[FurnitureSpec]) -> None:
    from rich.console import Console
    from rich.table import Table

    titles = ("object", "kind", "range", "hinge", "family", "w x d x h, cm", "handle", "surface")
    table = Table(*titles, "split")
    for spec in specs:
        prismatic = spec.kind == "prismatic"
        end = f"{100.0 * spec.upper:.0f} cm" if prismatic else f"{np.degrees(spec.upper):.0f} deg"
        size = " x ".join(f"{100.0 * side:.0f}" for side in spec.size_m)
        looks = (spec.hinge or "-", spec.family.replace("_", " "), size, spec.handle.style)
        table.add_row(spec.name, spec.kind, f"0 to {end}", *looks, spec.finish, spec.split)
    console = Console()
    if not console.is_terminal:
        console = Console(width=140)
    console.print(table)
    drawers = sum(spec.kind == "prismatic" for spec in specs)
    console.print(
        f"{suite.name}: {drawers} prismatic, {len(specs) - drawers} revolute; for {suite.split}"
    )
