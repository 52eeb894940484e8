"""Do regions hold for a rig that is not perfect, and does its calibration's covariance make them?

    python -m experiments.claims.rig_errors --recordings runs/dev-recordings --first-seed 50000

Every recording of a folder (`experiments.rendered_recordings`) gets errors of its own, drawn by
seed, that the estimator is not told: the camera stands elsewhere, its focal length and its depth
are off. It is fitted as if the calibration were perfect, and with the covariance that the errors
were drawn from. One row a recording and way in OUT/*.jsonl, as it ends; what is there is not done
again. About five seconds a recording.

How large the errors are: 1 mm and 0.1 deg (each axis) of a hand-eye calibration, 0.2 % of the focal
length; depth within 2 % (95 %) as the data sheet of the D455 says, and a bias of 1 mm.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from akm_fg.errors import AkmError
from akm_fg.io.recording import read_recording, read_truth
from akm_fg.pipeline import fit_recording
from akm_fg.records import CalibrationErrors, Recording
from experiments.pages.covered import NOTHING, inside_columns, nees_of_joint
from experiments.pages.one_line import ends_in_one_line
from experiments.pages.tables import NoRows, grouped, markdown, percent
from experiments.rows.provenance import note_run
from experiments.rows.rows import Key, TrialRow, fill, keys, read_rows, trial_row
from experiments.scores.answers import answer_of_posterior, failed
from experiments.scores.statistics import share
from sim.camera.rig import RigErrors, drawn_camera

WITHOUT, WITH = "as if perfect", "with the calibration's covariance"
ERRORS = RigErrors().calibration()


@dataclass(frozen=True, slots=True)
class RigErrorsConfig:
    """Which recordings, which errors."""

    recordings: Path
    first_seed: int = 50_000
    folder: Path = Path("runs/rig-errors")


def with_rig_errors(recording: Recording, errors: CalibrationErrors, seed: int) -> Recording:
    """The recording as a rig would give it whose errors are drawn from `errors`."""
    camera = drawn_camera(errors, seed)
    return dataclasses.replace(recording, frames=tuple(map(camera.seen, recording.frames)))


def run_trial(config: RigErrorsConfig, key: Key) -> TrialRow:
    """One recording, one way."""
    folder = config.recordings / key.cell
    truth = read_truth(folder)
    assert truth is not None
    recording = with_rig_errors(read_recording(folder), ERRORS, key.seed)
    if key.method == WITH:
        recording = dataclasses.replace(recording, calibration=ERRORS)
    began = time.process_time()
    try:
        answer = answer_of_posterior(fit_recording(recording).posterior)
    except AkmError as problem:
        answer = failed(problem)
    return trial_row(key, truth, answer, time.process_time() - began)


def run(config: RigErrorsConfig) -> list[TrialRow]:
    """All trials that are not there yet; returns those that were asked for."""
    found = sorted(file.parent.name for file in config.recordings.glob("*/recording.json"))
    names = [name for name in found if not name.endswith(".part")]
    if not names:
        raise NoRows(f"{config.recordings} has no recordings: run experiments.rendered_recordings")
    note_run(config.folder, config)
    wanted = [
        dataclasses.replace(key, seed=config.first_seed + names.index(key.cell))
        for key in keys(names, (WITHOUT, WITH), (0,))
    ]
    fill(config.folder / "graph.jsonl", wanted, lambda keys: (run_trial(config, k) for k in keys))
    asked = set(wanted)
    return [row for row in read_rows(config.folder) if row.key in asked]


def table(rows: Sequence[TrialRow]) -> str:
    """Coverage by what the estimator was told, of all and of each kind."""
    header = ["told", "trials", "kind right, %", "axis inside", "pivot", "joint", "last state"]
    return markdown([*header, "NEES/dof, joint"], list(_lines(rows)))


def _lines(rows: Sequence[TrialRow]) -> Iterator[list[str]]:
    for method, some in grouped(rows, lambda row: row.method).items():
        parts = [(method, some), *((f"{method}, {k}", r) for k, r in grouped(
            some, lambda row: row.kind_true).items())]  # fmt: skip
        for name, few in parts:
            nees = nees_of_joint(few)
            yield [
                name,
                str(len(few)),
                percent(share([row.kind_right for row in few])),
                *inside_columns(few),
                NOTHING if nees is None else f"{nees.value:.2f}",
            ]


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--first-seed", type=int, default=50_000)
    parser.add_argument("--out", type=Path, default=Path("runs/rig-errors"))
    arguments = parser.parse_args()
    config = RigErrorsConfig(arguments.recordings, arguments.first_seed, arguments.out)
    with ends_in_one_line("rig_errors"):
        print(table(run(config)))


if __name__ == "__main__":
    main()
