"""Where does a memory of contacts point on objects that it has never met, and how far to trust it?

    python -m experiments.hands.contact_memory --suite furniture-dev --out runs/contact-memory

Each object of the suite is seen once, as exploration first sees it, and pulled at the free part's
grip (`trials.first_looks`). Where that opened it and the contact is seen in the look, the contact
is remembered: training data. Then each object is left out, or its whole family (zero-shot), and the
memory of the others is carried over to it (`transfer`): does the best place lie on a handle, does
one of the five best; how much weight do handles get at which temperature; how sure may the
memories' vote on the kind be. Places count as five different ones where they are 5 cm apart.

Looks are kept in OUT/looks and not made again; the memory goes to OUT/memory, and with `--ship`
into the package. 5 s of CPU an object, 0.1 s for each transfer; the table goes to
docs/experiments.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.registry import features_of
from akm_fg.config import AkmConfig
from akm_fg.errors import AkmError
from akm_fg.exploration.analogy.contacts import ContactMemory, Opened, remembered
from akm_fg.exploration.analogy.shipped import SHIPPED
from akm_fg.exploration.analogy.transfer import AnalogyPrior, transfer
from akm_fg.interfaces import DenseFeatures, FeatureMap
from akm_fg.records import FloatArray
from experiments.pages.tables import markdown, percent
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from experiments.trials.first_looks import FirstLook, first_look, read_look, write_look
from sim.objects.suites.catalogue import SUITES


@dataclass(frozen=True, slots=True)
class MemoryConfig:
    """What is asked of the memory."""

    suite: str = "furniture-dev"
    seed: int = 0
    limit: int | None = None  # of objects; None: all
    asked: tuple[int, ...] = (1, 4, 8, 16, 32, 1000)  # memories; the last is all of them
    places: int = 5
    apart_m: float = 0.05  # between places that count as different
    beside_m: float = 0.01  # of a handle's pixels: still on it, for a hand
    least_seen_px: int = 12  # of handles; below it the look shows none
    temperatures: tuple[float, ...] = (0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.3, 0.5)
    trusts: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


@dataclass(frozen=True, slots=True)
class Transferred:
    """What the memory of others said of one object."""

    name: str
    asked: int
    zero_shot: bool
    place_on_handle: int | None  # 1: the best place; None: none of the best few
    share_on_handles: tuple[float, ...]  # of the weight, by temperature
    kind_vote: float  # share of the memories that have its kind
    cpu_s: float  # of features and transfer


@dataclass(frozen=True, slots=True)
class Described:
    """An object's features, and how long they took."""

    features: FeatureMap
    cpu_s: float


def described(look: FirstLook, dense: DenseFeatures) -> Described:
    """The features of a look."""
    began = time.process_time()
    features = dense.describe(look.frame.rgb, look.mask)
    return Described(features, time.process_time() - began)


def look_at_all(config: MemoryConfig, out: Path) -> list[FirstLook]:
    """Looks at the objects of the suite, kept or made now; drawers and doors by turns."""
    looks = []
    (out / "looks").mkdir(parents=True, exist_ok=True)
    numbered = sorted(SUITES[config.suite].names(), key=lambda name: name[-3:])
    for name in numbered[: config.limit]:
        full, path = f"{config.suite}/{name}", out / "looks" / f"{name}.npz"
        try:
            if not path.exists():
                write_look(path, first_look(full, config.seed))
                _say(f"{full}: seen")
        except AkmError as error:
            _say(f"{full}: no look: {error}")
            continue
        looks.append(read_look(path, full))
    return looks


def shows_handle(look: FirstLook, config: MemoryConfig) -> bool:
    """Whether there is anything to find."""
    return int((look.handles & look.mask).sum()) >= config.least_seen_px


def contact_seen(look: FirstLook, config: MemoryConfig) -> bool:
    """Whether the contact is seen, and not hidden behind the object's edge or the arm."""
    if not shows_handle(look, config):
        return False
    return _away_px(look, look.contact_uv) <= 2.0 * _pixels(look, config.beside_m)


def memory_of(
    looks: Sequence[FirstLook],
    maps: dict[str, Described],
    config: MemoryConfig,
) -> ContactMemory:
    """The contacts that opened their object and are seen in the look at it."""
    memory = ContactMemory("", ())
    for look in looks:
        if look.opened and contact_seen(look, config):
            told = Opened(
                object_name=look.name,
                family=look.family,
                kind=look.kind,  # type: ignore[arg-type]
                contact_world=look.contact_world,
                direction_world=look.direction_world,
                normal_world=look.normal_world,
            )
            features = maps[look.name].features
            contact = remembered(look.frame, look.mask, features, told)
            memory = memory.with_contact(contact, features.made_by)
    return memory


def carried_over(
    look: FirstLook,
    memory: ContactMemory,
    described: Described,
    k: int,
    zero_shot: bool,
    config: MemoryConfig,
) -> Transferred:
    """What the memory says of an object that is left out of it."""
    if zero_shot:
        memory = memory.without_family(look.family)
    memory, began = memory.without_object(look.name), time.process_time()
    prior = transfer(memory, described.features, look.frame, look.mask, k)
    cpu_s = described.cpu_s + time.process_time() - began
    votes = [contact.kind == look.kind for contact in prior.memories]
    return Transferred(
        name=look.name,
        asked=k,
        zero_shot=zero_shot,
        place_on_handle=_first_on_handle(look, prior, config),
        share_on_handles=tuple(_share_on_handles(look, prior, t) for t in config.temperatures),
        kind_vote=float(np.mean(votes)),
        cpu_s=cpu_s,
    )


def _first_on_handle(look: FirstLook, prior: AnalogyPrior, config: MemoryConfig) -> int | None:
    score, radius = prior.score.copy(), round(_pixels(look, config.apart_m))
    for place in range(1, config.places + 1):
        v, u = np.unravel_index(score.argmax(), score.shape)
        if _away_px(look, np.array([u, v], dtype=float)) <= _pixels(look, config.beside_m):
            return place
        cv2.circle(score, (int(u), int(v)), radius, -1.0, cv2.FILLED)
    return None


def _share_on_handles(look: FirstLook, prior: AnalogyPrior, temperature: float) -> float:
    similarity = prior.similarity[look.mask].astype(float)
    weight = np.exp((similarity - similarity.max()) / temperature)
    return float(weight[look.handles[look.mask]].sum() / weight.sum())


def _pixels(look: FirstLook, length_m: float) -> float:
    depth_m = float(np.nanmedian(look.frame.depth_m[look.mask]))
    return length_m * look.frame.camera.fx / depth_m


def _away_px(look: FirstLook, uv: FloatArray) -> float:
    rows, columns = np.nonzero(look.handles & look.mask)
    return float(np.hypot(columns - uv[0], rows - uv[1]).min())


def chance(looks: Sequence[FirstLook], config: MemoryConfig) -> float:
    """With which probability a place drawn on the object lies on a handle."""
    shares = []
    for look in looks:
        radius = round(_pixels(look, config.beside_m))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        near: NDArray = cv2.dilate((look.handles & look.mask).astype(np.uint8), kernel)
        shares.append(near[look.mask].mean())
    return float(np.mean(shares))


def hit_table(rows: Sequence[Transferred]) -> str:
    """How often the best place, and one of the best few, lies on a handle."""
    lines = []
    for zero_shot in (False, True):
        for k in sorted({row.asked for row in rows}):
            of = [row for row in rows if (row.asked, row.zero_shot) == (k, zero_shot)]
            first = [row.place_on_handle == 1 for row in of]
            any_ = [row.place_on_handle is not None for row in of]
            lines.append(
                [
                    "without its family" if zero_shot else "without the object",
                    "all" if k >= 1000 else str(k),
                    str(len(of)),
                    percent(share(first)),
                    percent(share(any_)),
                    f"{1e3 * np.median([row.cpu_s for row in of]):.0f}",
                ]
            )
    header = ["memory", "asked", "objects", "best place, %", "within five, %", "ms CPU"]
    return markdown(header, lines)


def calibration_table(rows: Sequence[Transferred], config: MemoryConfig) -> str:
    """Mean logarithm of what truth was given, by temperature and by trust."""
    lines = []
    for zero_shot in (False, True):
        for k in sorted({row.asked for row in rows}):
            of = [row for row in rows if (row.asked, row.zero_shot) == (k, zero_shot)]
            weights = np.array([row.share_on_handles for row in of])
            places = np.log(np.maximum(weights, 1e-12)).mean(axis=0)
            votes = np.array([row.kind_vote for row in of])
            trusts = np.array(config.trusts)
            kinds = np.log(trusts * votes[:, None] + (1.0 - trusts) / 2.0).mean(axis=0)
            best_t, best_k = int(places.argmax()), int(kinds.argmax())
            lines.append(
                [
                    "without its family" if zero_shot else "without the object",
                    "all" if k >= 1000 else str(k),
                    f"{config.temperatures[best_t]:g}",
                    f"{places[best_t]:.2f}",
                    f"{config.trusts[best_k]:g}",
                    f"{kinds[best_k]:.3f}",
                    f"{np.log(0.5):.3f}",
                ]
            )
    header = ["memory", "asked", "temperature", "log weight of handles"]
    header += ["trust in kinds", "log p(kind)", "of even odds"]
    return markdown(header, lines)


def summary(memory: ContactMemory, looks: Sequence[FirstLook], config: MemoryConfig) -> str:
    """What was seen, opened and remembered, and how often chance would hit."""
    scored = [look for look in looks if shows_handle(look, config)]
    opened = sum(look.opened for look in looks)
    seen = f"{len(looks)} objects seen, {opened} opened, {len(memory.contacts)} remembered"
    share_on_handle = 100 * chance(scored, config)
    return f"{seen}; of {len(scored)} handles are seen, on {share_on_handle:.1f} % of their places"


def main() -> None:
    """Look, pull, remember, carry over, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", choices=sorted(SUITES))
    parser.add_argument("--features", default="efficientnet")
    parser.add_argument("--out", type=Path, default=Path("runs/contact-memory"))
    parser.add_argument("--ship", action="store_true", help="write the package's own memory")
    parser.add_argument("--limit", type=int, help="look at so many objects alone")
    arguments = parser.parse_args()
    config = MemoryConfig(suite=arguments.suite, limit=arguments.limit)
    if arguments.ship and SUITES[config.suite].split != "dev":
        parser.error(f"{config.suite} is not for training: the package's memory is of a dev suite")
    note_run(arguments.out, config)
    tree = AkmConfig()
    dense = features_of(replace(tree, stages=replace(tree.stages, features=arguments.features)))
    if dense is None:
        parser.error("a memory needs features")
    looks = look_at_all(config, arguments.out)
    maps = {look.name: described(look, dense) for look in looks}
    memory = memory_of(looks, maps, config)
    memory.write(SHIPPED if arguments.ship else arguments.out / "memory")
    scored = [look for look in looks if shows_handle(look, config)]
    rows = [
        carried_over(look, memory, maps[look.name], k, zero_shot, config)
        for zero_shot in (False, True)
        for k in config.asked
        for look in scored
    ]
    print(summary(memory, looks, config), end="\n\n")
    print(hit_table(rows), calibration_table(rows, config), sep="\n\n")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
