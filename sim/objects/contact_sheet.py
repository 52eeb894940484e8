"""A page of small pictures of a suite: each object closed and open, as the camera sees it.

    python -m sim.objects.contact_sheet --suite furniture-116 --out docs/images/furniture-116.jpg

The robot is out of the picture; the view is the one that `sim.episode.open_world` takes for the
placement: on the hinge's side for `reachable`, fixed beside the base for `published`.
An object that cannot be built gets a cell that says so, and the page goes on without it.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from akm_fg.errors import AkmError, InputError, OutputError
from sim.bullet import p
from sim.camera.camera import CameraConfig
from sim.episode import SimEpisode, open_world
from sim.objects.staging import PlacementMode
from sim.objects.suites.catalogue import SUITES
from sim.objects.suites.furniture_spec import FurnitureSpec

Rgb = NDArray[np.uint8]
LOG = logging.getLogger(__name__)

PROCESSES = 2
OPEN_M, OPEN_RAD = 0.40, np.deg2rad(40.0)  # the benchmark's ranges
AWAY_M = (0.0, 0.0, -50.0)  # where the robot waits, world
FINE = 2  # pictures are drawn this many times larger and averaged


@dataclass(frozen=True, slots=True)
class SheetConfig:
    """Sizes on the page, pixels."""

    columns: int = 12  # of pictures; an object takes two
    width: int = 160
    label: int = 15  # height of the line with the name
    gap: int = 3
    text: float = 0.36  # of OpenCV's font, whose capitals are 22 px high
    quality: int = 82  # of the JPEG

    @property
    def height(self) -> int:
        """Of a picture."""
        return self.width * 3 // 4


@dataclass(frozen=True, slots=True)
class Cell:
    """One object."""

    label: str
    closed: Rgb  # (h, w, 3)
    opened: Rgb | None  # None where it cannot be shown; `label` says why


def label_of(spec: FurnitureSpec) -> str:
    """What the page says of an object: name, family and how it opens, handle."""
    how = f" {spec.hinge}" if spec.hinge else ""
    return f"{spec.name.split('/')[-1]} {spec.family}{how}, {spec.handle.style}"


World = Callable[[str, int, CameraConfig], AbstractContextManager[SimEpisode]]
"""Opens the world of an object (its name, a seed) with a camera."""


def clean_world(name: str, seed: int, camera: CameraConfig) -> AbstractContextManager[SimEpisode]:
    """As `open_world`, seen by a camera without noise."""
    return open_world(name, seed, "clean", camera_config=camera)


def published_world(
    name: str, seed: int, camera: CameraConfig
) -> AbstractContextManager[SimEpisode]:
    """Where the paper puts the object, seen by its fixed camera without noise."""
    return open_world(name, seed, "clean", camera_config=camera, placement="published")


WORLDS: dict[PlacementMode, World] = {"reachable": clean_world, "published": published_world}


def take_cell(
    spec: FurnitureSpec, seed: int, config: SheetConfig, world: World = clean_world
) -> Cell:
    """Builds the object and takes its two pictures; an object that fails says so in its cell."""
    try:
        camera = CameraConfig().scaled(FINE * config.width / CameraConfig().width)
        with world(spec.name, seed, camera) as episode:
            closed, opened = _closed_and_open(episode)
    except (AkmError, ValueError) as error:
        LOG.warning("%s is left out: %s", spec.name, error)
        blank = np.full((config.height, config.width, 3), 255, dtype=np.uint8)
        return Cell(f"{spec.name.split('/')[-1]}: {type(error).__name__}", blank, None)
    return Cell(label_of(spec), _averaged(closed), _averaged(opened))


def _closed_and_open(episode: SimEpisode) -> tuple[Rgb, Rgb]:
    world = episode.world
    where = {"physicsClientId": world.client}
    p.resetBasePositionAndOrientation(world.robot_id, AWAY_M, (0.0, 0.0, 0.0, 1.0), **where)
    closed = episode.camera.exact()[0]
    full = OPEN_M if world.spec.kind == "prismatic" else OPEN_RAD
    state = min(full, world.spec.upper)
    p.resetJointState(world.object_id, world.part_joint, state, **where)
    return closed, episode.camera.exact()[0]


def _averaged(rgb: Rgb) -> Rgb:
    size = (rgb.shape[1] // FINE, rgb.shape[0] // FINE)
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def lay_out(cells: Sequence[Cell], config: SheetConfig) -> Rgb:
    """The page (H, W, 3): objects in rows, each closed and open under one line of text."""
    across = config.columns // 2
    cell_h = config.label + config.height + config.gap
    cell_w = 2 * config.width + config.gap
    rows = -(-len(cells) // across)
    page = np.full((rows * cell_h, across * cell_w - config.gap, 3), 255, dtype=np.uint8)
    for i, cell in enumerate(cells):
        top, left = (i // across) * cell_h, (i % across) * cell_w
        at = (left + 2, top + config.label - 4)
        cv2.putText(
            page, cell.label, at, cv2.FONT_HERSHEY_SIMPLEX, config.text, (0, 0, 0), 1, cv2.LINE_AA
        )
        top += config.label
        for k, image in enumerate((cell.closed, cell.opened)):
            if image is not None:
                x = left + k * config.width
                page[top : top + config.height, x : x + config.width] = image
    return page


def make_cells(
    specs: Sequence[FurnitureSpec],
    seed: int,
    config: SheetConfig,
    processes: int,
    world: World = clean_world,
) -> Iterator[Cell]:
    """The cells of the objects in their order, as they are done."""
    jobs = (specs, [seed] * len(specs), [config] * len(specs), [world] * len(specs))
    if processes == 1:
        yield from map(take_cell, *jobs)
        return
    # Not forked: a library's threads do not survive that.
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        yield from pool.map(take_cell, *jobs)


def write_sheet(path: Path, page: Rgb, config: SheetConfig) -> None:
    """Writes the page as JPEG or whatever the ending says.

    Raises:
        OutputError: it cannot be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        done = cv2.imwrite(str(path), page[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, config.quality])
    except (OSError, cv2.error) as error:
        raise OutputError(f"{path}: {error}") from None
    if not done:
        raise OutputError(f"{path}: cannot be written")


def main(arguments: Sequence[str] | None = None, world: World | None = None) -> int:
    """Run the command; 1 if an object had to be left out, 2 if nothing could be done.

    Args:
        arguments: of the command line.
        world: opens the worlds that are shown; those of the placement if absent.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", choices=tuple(SUITES), default="furniture-116")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--columns", type=int, default=SheetConfig().columns)
    parser.add_argument("--placement", choices=tuple(WORLDS), default="reachable")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="such as door-003; else all")
    parser.add_argument("--processes", type=int, choices=range(1, PROCESSES + 1), default=PROCESSES)
    given = parser.parse_args(arguments)
    if given.columns < 2:
        parser.error(f"--columns {given.columns}: an object takes two")
    config = SheetConfig(columns=given.columns)
    suite = SUITES[given.suite]
    try:
        specs = [suite.load(name) for name in given.only or suite.names()]
    except InputError as error:
        parser.error(str(error))
    console = Console(file=sys.stderr)
    world = world or WORLDS[given.placement]
    cells = make_cells(specs, given.seed, config, given.processes, world)
    shown = list(track(cells, given.suite, len(specs), console=console))
    try:
        write_sheet(given.out, lay_out(shown, config), config)
    except OutputError as error:
        console.print(str(error))
        return 2
    missing = sum(cell.opened is None for cell in shown)
    console.print(f"{given.out}: {len(shown) - missing} of {len(shown)} objects")
    return 1 if missing else 0


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    sys.exit(main())
