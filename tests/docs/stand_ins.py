"""Stand-ins for the files that the commands of the pages name, made once and copied where needed.

A page's `my_cabinet/` or `cabinet.bag` is the rendered door of the other tests, its `runs/NAME`
what the command before it on the page leaves.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.cli.config_argument import write_tree
from akm_fg.cli.main import main
from akm_fg.cli.recordings.board_recording import write_simulated_board
from akm_fg.config import AkmConfig
from akm_fg.io.recording import write_recording
from akm_fg.io.tracks import write_tracks
from akm_fg.records import Recording
from experiments.trials.openings import make_opening
from sim.camera.charuco_board import PoseConfig
from tests.akm_fg.conftest import Cabinet, film
from tests.akm_fg.io.sources import conftest as formats
from tests.conftest import MobilityObject

HANDLE = gtsam.Pose3(gtsam.Rot3(), np.array([0.055, 0.21, 0.35]))  # in the world, door closed
EXPLORED = "runs/20260101-120000-explore-furniture-dev-door-001-3"  # of the pages
BOARD_VIEWS = 12  # of the forty that a simulated board is shown in
TRAVEL_RAD, FRAMES, FIRST_STAMP_S = np.deg2rad(35), 15, 1000.0

Maker = Callable[[Path], object]


def door() -> Recording:
    """A door that opens, held by its handle; stamps as a clock of the day has them."""
    clip = film(Cabinet(), TRAVEL_RAD, FRAMES)
    frames = tuple(replace(f, stamp_s=f.stamp_s + FIRST_STAMP_S) for f in clip.frames)
    hand = tuple(clip.scene.motion(q) * HANDLE for q in clip.states)
    return Recording("door", frames, T_world_gripper=hand, grasp_frames=(0, FRAMES - 1))


def own_folder(place: Path) -> None:
    write_recording(place, door())


def tum_folder(place: Path) -> None:
    formats.write_tum(place, door())


def ros1_bag(place: Path) -> None:
    formats.write_ros1(place, door())


def record3d(place: Path) -> None:
    formats.write_r3d(place, door())


def ros2_folder(place: Path) -> None:
    """The bag of a robot: the camera's place and the hand's, told from `base_link` on."""
    recording = door()
    grips = recording.T_world_gripper

    def entries(make: formats.BagMessages) -> Iterator[tuple[str, float, object]]:
        first_s = recording.frames[0].stamp_s
        fixed = make.transform(first_s, "base_link", "world", gtsam.Pose3())
        yield "/tf_static", first_s, make.tf(fixed)
        for frame, T in zip(recording.frames, grips, strict=True):
            moved = make.transform(frame.stamp_s, "base_link", "panda_hand_tcp", T)
            yield "/tf", frame.stamp_s, make.tf(moved)
        yield from formats.bag_entries(recording)(make)

    formats.write_bag(place, "ros2", entries)


def tracks(place: Path) -> None:
    write_tracks(place, make_opening(0).tracks)


def marker_log(place: Path) -> None:
    """A marker on the door, a row a frame, with a tenth of a millimetre of noise."""
    rng, rows = np.random.default_rng(0), []
    for q in np.linspace(0.0, TRAVEL_RAD, 4 * FRAMES):
        T = Cabinet().motion(q) * HANDLE
        quaternion = T.rotation().toQuaternion()
        p = T.translation() + 1e-4 * rng.normal(size=3)
        rows.append([*p, quaternion.x(), quaternion.y(), quaternion.z(), quaternion.w()])
    np.savetxt(place, rows, fmt="%.6f")


def settings(place: Path) -> None:
    """The line that README has."""
    place.write_text("fit.prior.hinge_distance_m = 0.5\n")


def all_settings(place: Path) -> None:
    write_tree(place, AkmConfig(), "as a run writes them")


def mobility_urdf(place: Path) -> None:
    """As PartNet-Mobility has them, with a drawer on joint_2."""
    shutil.rmtree(place.parent)
    MobilityObject().write(place.parent)
    place.write_text(place.read_text().replace("joint_0", "joint_2"))


def board(place: Path) -> None:
    """Fewer views than the command makes, drawn only twice as large: quick."""
    write_simulated_board(place, BOARD_VIEWS, "d455", seed=1, config=PoseConfig(supersample=2))


def board_for_hand_camera(place: Path) -> None:
    """With each pose inverted, hand and base change places: the hand carries the camera."""
    board(place)
    file = place / "recording.json"
    said = json.loads(file.read_text())
    said["T_world_gripper"] = [np.linalg.inv(T).tolist() for T in said["T_world_gripper"]]
    file.write_text(json.dumps(said))


def fitted(place: Path) -> None:
    """What `akm-fg fit --out` leaves."""
    own_folder(place.with_name("of-" + place.name))
    assert main(["fit", str(place.with_name("of-" + place.name)), "--out", str(place)]) == 0


def explored(name: str, place: Path) -> None:
    """What `akm-fg explore` leaves."""
    runs = place.with_name("runs-of-" + place.name)
    assert main(["explore", name, "--seed", "3", "--out", str(runs)]) == 0
    (folder,) = runs.glob("*-explore-*")
    folder.rename(place)


MAKERS: dict[str, Maker] = {
    "my_tum": tum_folder,
    "my_cabinet": own_folder,
    "recording": own_folder,
    "recordings/cabinet": own_folder,
    "recordings/kitchen": own_folder,
    "recordings/phone": own_folder,
    "runs/kitchen/recording": own_folder,
    "tracks.npz": tracks,
    "marker.log": marker_log,
    "my.toml": settings,
    "out.jsonl.config.toml": all_settings,
    "cabinet.bag": ros1_bag,
    "kitchen": ros2_folder,
    "phone.r3d": record3d,
    "kitchen/mobility.urdf": mobility_urdf,
    "runs/board": board,
    "recordings/board": board,
    "a hand camera's board": board_for_hand_camera,
    "runs/door": fitted,
    "runs/kitchen": fitted,
    "runs/my_tum": fitted,
    EXPLORED: partial(explored, "furniture-dev/door-001"),
    "runs/NAME": partial(explored, "furniture-dev/door-003"),
}


@dataclass(frozen=True, slots=True)
class Stock:
    """What was made so far."""

    root: Path

    def put(self, name: str, place: Path) -> None:
        """A copy of what the pages call `name`, made where it is wanted first."""
        maker = MAKERS[name]
        called = maker.args[0] if isinstance(maker, partial) else maker.__name__
        kept = self.root / called.replace("/", "-") / place.name
        if not kept.exists():
            kept.parent.mkdir(parents=True, exist_ok=True)
            maker(kept)
        place.parent.mkdir(parents=True, exist_ok=True)
        if maker is mobility_urdf:  # with the meshes beside it
            shutil.copytree(kept.parent, place.parent, dirs_exist_ok=True)
        elif kept.is_dir():
            shutil.copytree(kept, place)
        else:
            shutil.copy(kept, place)
