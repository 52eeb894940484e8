"""`akm-fg objects`: which objects a suite has."""

from __future__ import annotations

import importlib.util
import json as json_module
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from akm_fg.cli.console.lines import complain, console
from akm_fg.cli.exit_codes import BAD_INPUT, DONE
from akm_fg.cli.object_argument import check_scale
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import MissingDependency
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from rich.table import Table

    from sim.objects.household.household_spec import HouseholdSpec
    from sim.objects.imported.imported_spec import ImportedSpec
    from sim.objects.listing import Listing
    from sim.objects.mechanisms import Catch, Closer
    from sim.objects.suites.furniture_spec import FurnitureSpec

    Spec = FurnitureSpec | HouseholdSpec | ImportedSpec

WIDE = 130  # columns, from which all of a listing is shown
NAME_WIDTH = 24  # of the suites' names


@dataclass(frozen=True)
class ObjectsArguments:
    """Example: akm-fg objects --suite furniture-dev --json objects.json

    Lists the objects of a suite: name, joint, range, size, handle, what holds it closed, surface.
    Names are those that other commands take as OBJECT: furniture-dev/door-003. furniture-116 is
    the benchmark, on which nothing may be tuned; furniture-dev is for that. Your own objects:
    akm-fg objects --suite partnet --folder FOLDER; those that cannot be read are left out, said
    so, and make the exit code 2.
    """

    suite: str = "furniture-dev"
    """furniture-116, furniture-dev, household-60, household-dev or partnet."""
    folder: Path | None = None
    """Of partnet: FOLDER with FOLDER/ID/mobility.urdf, one such object, or any URDF file."""
    scale: float | None = None
    """Of partnet: what every length is multiplied by, such as 0.001 for millimetres."""
    json: str | None = None
    """Write the list as one JSON object to this file; - is standard output (no table then)."""
    seed: int = 0
    """Of the meeting: varies the scale (0.9 to 1.1) and with it the sizes."""


def objects(arguments: ObjectsArguments) -> int:
    """Run the command.

    Raises:
        InputError: no such suite, or a folder without objects.
        MissingDependency: the simulator is not installed.
        OutputError: the file cannot be written.
    """
    _require_simulator()
    check_scale(arguments.scale)
    from sim.objects.listing import list_suite

    listing = list_suite(arguments.suite, arguments.folder, arguments.seed, arguments.scale)
    with json_output(arguments.json) as stream:
        if stream is not None:
            write_line(stream, json_module.dumps(_as_dict(listing, arguments), allow_nan=False))
    if arguments.json != "-":
        _print(listing)
    for bad in listing.skipped:
        complain(f"left out: {bad.problem}")
    return BAD_INPUT if listing.skipped else DONE


def _require_simulator() -> None:
    absent = [m for m in ("pybullet", "trimesh") if importlib.util.find_spec(m) is None]
    if absent:
        raise MissingDependency(
            f"objects needs {' and '.join(absent)}; install akm-fg[sim] (Python 3.11)"
        )


def _as_dict(listing: Listing, arguments: ObjectsArguments) -> dict[str, Any]:
    """The list as JSON (`akm-fg/objects/1`, docs/conventions.md)."""
    return {
        "schema": "akm-fg/objects/1",
        "suite": listing.suite,
        "split": listing.split,
        "seed": arguments.seed,
        "objects": [_object(spec) for spec in listing.specs],
        "skipped": [{"name": bad.name, "problem": bad.problem} for bad in listing.skipped],
    }


def _object(spec: Spec) -> dict[str, Any]:
    from sim.objects.part_spec import mechanisms, standard_range

    handle = spec.handle
    return {
        "name": spec.name,
        "kind": spec.kind,
        "joint": getattr(spec, "joint", None),
        "range": [0.0, spec.upper],
        "standard_range": [0.0, standard_range(spec)],
        "unit": "m" if spec.kind == "prismatic" else "rad",
        "more": [{"kind": part.kind, "range": [0.0, part.upper]} for part in mechanisms(spec)[1:]],
        "closed_in_file": getattr(spec, "closed", None),
        "family": spec.family,
        "hinge": spec.hinge,
        "size_m": spec.size_m.tolist(),
        "scale": spec.scale,
        "handle": {
            "style": handle.style,
            "length_m": handle.length_m,
            "thickness_m": handle.thickness_m,
            "reach_m": handle.reach_m,
            "fits": getattr(handle, "fits", True),
        },
        "mass_kg": spec.mass_kg,
        "friction": spec.friction,
        "damping": spec.damping,
        "handle_mu": spec.handle_mu,
        "catch": _catch(spec.catch),
        "closer": _closer(spec.closer),
        "finish": getattr(spec, "finish", None),
        "split": spec.split,
    }


def _catch(catch: Catch | None) -> dict[str, float] | None:
    if catch is None:
        return None
    return {"force": catch.force, "stiffness": catch.stiffness, "travel": catch.travel}


def _closer(closer: Closer | None) -> dict[str, float | None] | None:
    if closer is None:
        return None
    until = closer.until if math.isfinite(closer.until) else None
    return {"preload": closer.preload, "stiffness": closer.stiffness, "until": until}


def _print(listing: Listing) -> None:
    out = console()
    out.print(_table(listing, wide=out.width >= WIDE))
    slides = sum(spec.kind == "prismatic" for spec in listing.specs)
    turns = len(listing.specs) - slides
    out.print(
        f"{printable(listing.suite)}: {slides} prismatic, {turns} revolute; for {listing.split}",
        soft_wrap=True,
    )


def _table(listing: Listing, wide: bool) -> Table:
    """One row an object; family, surface and split only where there is room for them."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2 if wide else 1, 0, 0))
    longest = max((len(spec.name) for spec in listing.specs), default=0)
    # Of one width, because Rich narrows the widest first. What is too long for its column goes on
    # below: what is cut off would be lost, the end of a path or a unit.
    width = None if wide else min(longest, NAME_WIDTH)
    table.add_column("object", overflow="fold", width=width)
    for title in ("joint", "w x d x h, cm", "handle", "held closed"):
        table.add_column(title, overflow="fold")
    for title in ("family", "surface", "split") if wide else ():
        table.add_column(title)
    for spec in listing.specs:
        size = " x ".join(f"{100.0 * side:.0f}" for side in spec.size_m)
        handle = spec.handle.style if getattr(spec.handle, "fits", True) else "none to grip"
        row = [spec.name, _joint(spec), size, handle, _held(spec)]
        if wide:
            finish = getattr(spec, "finish", "its own")
            row += [spec.family.replace("_", " "), finish, spec.split]
        table.add_row(*(Text(printable(cell)) for cell in row))
    return table


def _joint(spec: Spec) -> str:
    """Kind, hinge and range: `revolute left, 90 deg`."""
    from sim.objects.part_spec import mechanisms

    more = len(mechanisms(spec)) - 1
    others = f", +{more}" if more else ""
    if spec.kind == "prismatic":
        return f"prismatic, {100.0 * spec.upper:.0f} cm{others}"
    return f"{spec.kind} {spec.hinge}, {np.degrees(spec.upper):.0f} deg{others}"


def _held(spec: Spec) -> str:
    unit = "N" if spec.kind == "prismatic" else "N m"
    words = [f"catch {spec.catch.force:.1f} {unit}"] if spec.catch else []
    words += [f"closer {spec.closer.preload:.1f} {unit}"] if spec.closer else []
    return ", ".join(words) or "-"
