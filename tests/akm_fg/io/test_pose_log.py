"""Pose logs, and the choice of reader."""

from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.inputs import read_input
from akm_fg.io.pose_log import read_pose_log
from akm_fg.io.tracks import TracksInput
from akm_fg.records import PoseTrack

STURM = Path(__file__).resolve().parents[4] / "shared/data/sturm"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.log"
    path.write_text(text)
    return path


def test_positions_are_read_past_comments_and_blank_lines(tmp_path: Path) -> None:
    track = read_pose_log(write(tmp_path, "# marker 3\n\n1 2 3\n  4\t5e-1 -6  # last\n\n"))
    np.testing.assert_array_equal(track.p_world, [[1, 2, 3], [4, 0.5, -6]])
    assert track.R_world_part is None


def test_a_quarter_turn_about_z_takes_x_to_y(tmp_path: Path) -> None:
    track = read_pose_log(write(tmp_path, "1 2 3 0 0 0 1\n1 2 3 0 0 2 2\n"))
    assert track.R_world_part is not None
    np.testing.assert_allclose(track.R_world_part[0], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(track.R_world_part[1] @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.log: has no rows"),
        ("# nothing\n\n", "a.log: has no rows"),
        ("1 2 3\n", "a.log: has only one row"),
        ("1 2 3\n4 5\n", "line 2: 2 columns"),
        ("1 2 3\n\n4 5 6 0 0 0 1\n", "line 3: 7 columns; expected 3 columns as in the rows before"),
        ("1 2 3\n4 x 6\n", "line 2: 'x' is not a number"),
        ("1|2|3\n4|5|6\n", "line 1: '1|2|3' is not a number"),
        ("1 2 3\nnan nan nan\n", "a.log: has only one row (1 with NaN left out)"),
        ("1 2 3\n4 inf 6\n", "line 2: 'inf' is not finite"),
        ("1 2 3 0 0 0 1\n1 2 3 0 0 0 0\n", "line 2: the quaternion is zero"),
    ],
)
def test_broken_logs_are_named_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_pose_log(write(tmp_path, text))
    assert message in str(caught.value)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)


def test_a_binary_log_and_a_missing_one_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="is not text"):
        read_pose_log(tmp_path / "a.log")
    with pytest.raises(InputError, match="does not exist"):
        read_pose_log(tmp_path / "b.log")


@pytest.mark.skipif(not STURM.is_dir(), reason="the Sturm logs are not beside this checkout")
def test_all_sturm_logs_are_read() -> None:
    logs = sorted(STURM.rglob("*.log"))
    assert len(logs) == 49
    for log in logs:
        track = read_pose_log(log)
        assert len(track.p_world) > 60
        assert (track.R_world_part is not None) == (log.parent.name == "kitchen")


def test_the_reader_is_chosen_by_what_the_path_is(tmp_path: Path) -> None:
    assert isinstance(read_input(write(tmp_path, "1 2 3\n4 5 6\n")), PoseTrack)
    np.savez(tmp_path / "a.npz", points=np.zeros((3, 2, 3)))
    assert isinstance(read_input(tmp_path / "a.npz"), TracksInput)
    with pytest.raises(InputError, match=r"recording\.json: is missing"):
        read_input(tmp_path)
    with pytest.raises(InputError, match="does not exist; expected a recording folder, tracks"):
        read_input(tmp_path / "nothing")
    (tmp_path / "a.odd").write_bytes(b"#ROSBAG")
    with pytest.raises(InputError, match=r"ends in '\.odd'; expected a recording folder"):
        read_input(tmp_path / "a.odd")
    with pytest.raises(InputError, match="is not a usable path"):
        read_input(Path("a" * 5000))
