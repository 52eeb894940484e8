"""Results and descriptions that are spoilt: read, or one line that says why not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import gtsam
import pytest
from hypothesis import HealthCheck, given, settings

from akm_fg.calibration.board_file import read_board
from akm_fg.errors import AkmError
from akm_fg.hardware.mounted_camera import read_mounted_camera
from akm_fg.io.posteriors.posterior_json import posterior_as_line
from akm_fg.io.scoring.answers import read_answers
from akm_fg.io.scoring.truths import read_truth_file
from akm_fg.model.read import read_model
from akm_fg.model.write import write_model
from akm_fg.records import PinholeCamera
from tests.akm_fg.hardware.calibration_file import write_calibration
from tests.spoiled import CHANGES, CUT, SWAPS, spoiled

# A warning would be a second line on standard error.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

BOARD = {
    "schema": "akm-fg/board/1", "squares_x": 5, "squares_y": 7, "square_m": 0.04,
    "marker_m": 0.03, "dictionary": "DICT_4X4_50",
}  # fmt: skip
TRUTH = {"kind": "revolute", "axis": [0, 0, 1], "pivot": [0, 0, 0], "states": [0, 1]}
LINK = '<link name="{}"><visual><geometry><box size="1 1 1"/></geometry></visual></link>'
URDF = (
    f'<robot name="r">{LINK.format("a")}{LINK.format("b")}<joint name="j" type="revolute">'
    '<origin xyz="0 0.1 0" rpy="0 0 1.5"/><parent link="a"/><child link="b"/>'
    '<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>'
)
CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
Files = dict[str, tuple[Path, bytes, Callable[[Path], object]]]


def _read_urdf(path: Path) -> object:
    pytest.importorskip("pybullet")
    from sim.objects.urdf.urdf_reader import read_urdf

    return read_urdf(path)


@pytest.fixture(scope="module")
def files(door_model, tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Each sound, with its reader."""
    place = tmp_path_factory.mktemp("files")
    write_model(place, door_model)
    write_calibration(place / "rig.json", CAMERA, gtsam.Pose3())
    posterior = posterior_as_line(door_model.parts[0].posterior)
    for name, text in (
        ("board.json", json.dumps(BOARD)),
        ("truth.json", json.dumps(TRUTH)),
        ("posterior.json", posterior),
        ("object.urdf", URDF),
    ):
        (place / name).write_text(text)
    readers: dict[str, Callable[[Path], object]] = {
        "model.json": read_model,
        "part-0.npz": lambda path: read_model(path.parent),
        "posterior.json": read_answers,
        "truth.json": read_truth_file,
        "board.json": read_board,
        "rig.json": read_mounted_camera,
        "object.urdf": _read_urdf,
    }
    return {name: (place / name, (place / name).read_bytes(), r) for name, r in readers.items()}


NAMES = (
    "model.json", "posterior.json", "truth.json", "board.json", "rig.json", "object.urdf",
    pytest.param("part-0.npz", marks=pytest.mark.slow),  # surfaces are large: 0.2 s each
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@settings(
    deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(CHANGES, SWAPS, CUT)
def test_a_spoilt_file_is_read_or_refused_in_a_line(
    files: Files,
    name: str,
    changes: list[tuple[int, int]],
    swaps: list[tuple[int, bytes]],
    cut: int,
) -> None:
    path, data, read = files[name]
    path.write_bytes(spoiled(data, changes, swaps, cut))
    try:
        read(path)
    except AkmError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(data)
