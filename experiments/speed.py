"""How fast is a fit, beside the paper's method on the same data in the same run?

    python -m experiments.speed --repeats 7

Tracks only (200 x 30) against the paper's coarse stage with 100 starts; tracks and the surfaces of
five keyframes (10,000 readings each and more) against its coarse and fine stages; both on one
thread, timed in turn so that a slow machine slows both. Then the cost over tracks and over frames,
and the peak memory of a process that does nothing but one fit of both. Writes rows, a table
and a figure to docs/; about five minutes on one core.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.surface_registration import SurfaceToRegister
from akm_fg.perception.surface.part_cloud import sample_cloud
from akm_fg.report.score import axis_angle_rad
from akm_fg.steps import to_end
from experiments.baselines.clouds import PartCloud, choose_keyframes, part_cloud
from experiments.baselines.coarse import coarse_estimate
from experiments.baselines.config import CoarseConfig
from experiments.baselines.fine import fine_estimate
from experiments.pages.figures import COLOURS, new_figure, save
from experiments.rows.provenance import machine, note_run
from experiments.trials.openings import Opening, make_opening
from experiments.trials.panel_camera import PanelCamera

CLOUD_POINTS = 10_000
KINDS = ("revolute", "prismatic")
COUNTS, LENGTHS = (25, 50, 100, 200, 400, 800), (10, 20, 30, 40, 60, 120, 240)


@dataclass(frozen=True, slots=True)
class Timing:
    """One call, timed."""

    what: str
    method: str
    kind: str
    tracks: int
    frames: int
    repeat: int
    seconds: float
    axis_error_deg: float


def _timed(call: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    began = time.perf_counter()
    axis = call()
    return time.perf_counter() - began, axis


def _graph(opening: Opening, camera: PanelCamera | None) -> np.ndarray:
    sources = [] if camera is None else [SurfaceToRegister(camera)]
    joint = fit_tracks(opening.tracks, sources=sources).alternatives[opening.kind].joint
    assert joint is not None
    return joint.axis


def _paper(opening: Opening, camera: PanelCamera | None, seed: int) -> np.ndarray:
    coarse = coarse_estimate(opening.tracks.p_world, seed, CoarseConfig(starts=100))
    if camera is None:
        return coarse.axis
    frames = choose_keyframes(coarse.states, 5)
    clouds = [_cloud(camera, int(t), seed) for t in frames]
    return fine_estimate(coarse, clouds, coarse.states[frames], seed).axis


def _cloud(camera: PanelCamera, t: int, seed: int) -> PartCloud:
    still = np.eye(3)[None], np.zeros((1, 3)), np.ones(1, dtype=bool)
    views = to_end(camera.views([t], *still))
    rng = np.random.default_rng(seed)
    return part_cloud(sample_cloud(views.planes[0], t, rng, CLOUD_POINTS).p_world)


def compared(repeats: int) -> list[Timing]:
    """Ours and the paper's, in turn."""
    rows = []
    for repeat in range(repeats):
        for kind in KINDS:
            opening = make_opening(repeat, kind, points=200, frames=30)
            camera = PanelCamera(opening, repeat)
            for t in range(opening.q.size):  # a recording's pictures are there before its fit
                camera.frame(t)
            for what, seen in (("tracks", None), ("tracks and surfaces", camera)):
                for method, call in (
                    ("graph", lambda o=opening, s=seen: _graph(o, s)),
                    ("paper", lambda o=opening, s=seen, r=repeat: _paper(o, s, r)),
                ):
                    seconds, axis = _timed(call)
                    error = float(np.degrees(axis_angle_rad(axis, opening.axis)))
                    rows.append(Timing(what, method, kind, 200, 30, repeat, seconds, error))
                    print(rows[-1], flush=True)
    return rows


def curves(repeats: int) -> list[Timing]:
    """Cost over tracks at 30 frames, and over frames at 100 tracks."""
    rows = []
    for what, sizes in (
        ("over tracks", [(n, 30) for n in COUNTS]),
        ("over frames", [(100, t) for t in LENGTHS]),
    ):
        for tracks, frames in sizes:
            for repeat in range(repeats):
                opening = make_opening(repeat, KINDS[repeat % 2], points=tracks, frames=frames)
                seconds, axis = _timed(partial(_graph, opening, None))
                error = float(np.degrees(axis_angle_rad(axis, opening.axis)))
                rows.append(
                    Timing(what, "graph", opening.kind, tracks, frames, repeat, seconds, error)
                )
            print(rows[-1], flush=True)
    return rows


def peak_memory_mb() -> float:
    """Of a fresh process that fits tracks and surfaces once (Linux).

    Not `ru_maxrss`: a process inherits that of the one that started it.
    """
    code = (
        "import re; from akm_fg.estimation.fit import fit_tracks;"
        "from akm_fg.estimation.given.surface_registration import SurfaceToRegister;"
        "from experiments.trials.openings import make_opening;"
        "from experiments.trials.panel_camera import PanelCamera;"
        "o = make_opening(0, points=200, frames=30);"
        "fit_tracks(o.tracks, sources=[SurfaceToRegister(PanelCamera(o, 0))]);"
        "status = open('/proc/self/status').read();"
        "print(int(re.search(r'VmHWM:\\s*(\\d+) kB', status)[1]) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def table(rows: list[Timing]) -> str:
    """Medians and their ratios, per data and joint."""
    lines = [
        "| data | joint | graph, ms (worst) | paper's method, ms | ratio | axis error, deg: graph "
        "| paper's |",
        "|---|---|---|---|---|---|---|",
    ]
    for what in ("tracks", "tracks and surfaces"):
        for kind in KINDS:
            ours = [r for r in rows if (r.what, r.kind, r.method) == (what, kind, "graph")]
            paper = [r for r in rows if (r.what, r.kind, r.method) == (what, kind, "paper")]
            seconds = [r.seconds for r in ours]
            ratio = np.median([r.seconds for r in paper]) / np.median(seconds)
            lines.append(
                f"| {what} | {kind} | {1e3 * np.median(seconds):.0f} ({1e3 * max(seconds):.0f}) "
                f"| {1e3 * np.median([r.seconds for r in paper]):.0f} | {ratio:.0f} "
                f"| {np.median([r.axis_error_deg for r in ours]):.3f} "
                f"| {np.median([r.axis_error_deg for r in paper]):.3f} |"
            )
    return "\n".join(lines)


def draw(rows: list[Timing], file: Path) -> None:
    """The cost over tracks and over frames, with a straight line through the largest."""
    figure, axes = new_figure(columns=2)
    for ax, what, field in zip(
        axes, ("over tracks", "over frames"), ("tracks", "frames"), strict=True
    ):
        chosen = [r for r in rows if r.what == what]
        sizes = sorted({getattr(r, field) for r in chosen})
        medians = [
            1e3 * np.median([r.seconds for r in chosen if getattr(r, field) == n]) for n in sizes
        ]
        ax.plot(sizes, medians, "o-", color=COLOURS["graph"])
        ax.set_xlabel(f"{field} ({'30 frames' if field == 'tracks' else '100 tracks'})")
        ax.set_ylabel("fit of all kinds, ms")
        ax.set_ylim(bottom=0)
        ax.set_xlim(left=0)
    save(figure, file)


def main() -> None:
    """Time, and write docs/speed.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("runs/speed"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    arguments = parser.parse_args()
    note_run(arguments.out)
    rows = compared(arguments.repeats) + curves(arguments.repeats)
    with (arguments.out / "speed.jsonl").open("w", encoding="utf-8") as stream:
        stream.writelines(json.dumps(asdict(row)) + "\n" for row in rows)
    draw(rows, arguments.docs / "images" / "speed.png")
    page = [
        "# Speed",
        "",
        "Written by `python -m experiments.speed"
        f" --repeats {arguments.repeats}`, one thread; every line of the table was timed in turn "
        f"with its rival in the same run. Machine: {machine()}.",
        "",
        table(rows),
        "",
        "Tracks: 200 x 30. Paper's method: coarse stage with 100 starts; with surfaces also its "
        "fine stage on five keyframes of 10,000 points, normals included. Graph: all four kinds, "
        "covariances and evidence; with surfaces also planes, association and registration of "
        "five keyframes. The simulated camera's pictures are taken before the clock starts, "
        "for both.",
        "",
        "![cost over tracks and over frames](images/speed.png)",
        "",
        f"Peak memory of a process that fits tracks and surfaces: {peak_memory_mb():.0f} MB.",
        "",
        "Frames beyond sixty get their states beside the graph, so that the cost grows linearly "
        "in them too.",
        "",
    ]
    (arguments.docs / "speed.md").write_text("\n".join(page), encoding="utf-8")


if __name__ == "__main__":
    main()
