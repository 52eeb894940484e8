"""The same door through every text format that public tools write, and what is said of guesses."""

from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.pose_log import read_pose_log
from akm_fg.io.read_options import ReadOptions

FRAMES = 30
RADIUS_M = 0.5
ANGLES_RAD = np.linspace(0, np.pi / 3, FRAMES)
P_WORLD = np.stack(
    [
        0.3 + RADIUS_M * np.cos(ANGLES_RAD),
        0.2 + RADIUS_M * np.sin(ANGLES_RAD),
        0 * ANGLES_RAD + 0.9,
    ],
    axis=1,
)
# The marker sits on the door turned about x, so that no quaternion has zeros where another has.
R_WORLD = np.array([gtsam.Rot3.Rz(a).compose(gtsam.Rot3.Rx(0.4)).matrix() for a in ANGLES_RAD])
XYZW = np.array([gtsam.Rot3(R).toQuaternion().coeffs() for R in R_WORLD])
WXYZ = XYZW[:, [3, 0, 1, 2]]
STAMPS_NS = 1721122914959000064 + 33333312 * np.arange(FRAMES)
MATRICES = np.concatenate([R_WORLD, P_WORLD[:, :, None]], axis=2)


def _text(rows: np.ndarray, separator: str = " ", header: str = "", decimal: str = ".") -> str:
    lines = [separator.join(f"{x:.9g}".replace(".", decimal) for x in row) for row in rows]
    return header + "\n".join(lines) + "\n"


def _with_nan() -> str:
    lines = _text(np.hstack([P_WORLD, XYZW])).splitlines()
    unknown = ["nan nan nan " + lines[7].split(" ", 3)[3], "NaN " * 7]
    return "\n".join([*lines[:5], unknown[0], *lines[5:9], unknown[1], *lines[9:]])


def _euroc(extra: int = 0) -> str:
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    header += "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    header += "".join(f", v_RS_R_{axis} [m s^-1]" for axis in "xyz"[:extra]) + "\n"
    rows = np.hstack([P_WORLD, WXYZ, np.ones((FRAMES, extra))])
    lines = _text(rows, ",").splitlines()
    return header + "\n".join(f"{t},{x}" for t, x in zip(STAMPS_NS, lines, strict=True))


POSES = np.hstack([P_WORLD, XYZW])
STAMPED = np.hstack([0.1 * np.arange(FRAMES)[:, None], POSES])
FORMATS: dict[str, Callable[[], str]] = {
    "plain": lambda: _text(POSES),
    "tabs": lambda: _text(POSES, "\t"),
    "comma": lambda: _text(POSES, ","),
    "comma and blank": lambda: _text(POSES, ", "),
    "semicolon": lambda: _text(POSES, ";"),
    "decimal comma": lambda: _text(POSES, " ", decimal=","),
    "decimal comma, semicolon": lambda: _text(POSES, "; ", decimal=","),
    "decimal comma, tab": lambda: _text(POSES, "\t", decimal=","),
    "header": lambda: _text(POSES, " ", "x y z qx qy qz qw\n"),
    "CSV of another order": lambda: _text(
        np.hstack([WXYZ, P_WORLD]), ",", "rot_w,rot_x,rot_y,rot_z,pos_x,pos_y,pos_z\n"
    ),
    "ROS names": lambda: _text(
        np.hstack([STAMPED[:, :1], 0 * STAMPED[:, :1], STAMPED[:, 1:]]),
        ",",
        "%time,field.header.seq,pose.position.x,pose.position.y,pose.position.z,"
        "pose.orientation.x,pose.orientation.y,pose.orientation.z,pose.orientation.w\n",
    ),
    "TUM": lambda: _text(STAMPED, " ", "# ground truth\n# timestamp tx ty tz qx qy qz qw\n"),
    "TUM without names": lambda: _text(STAMPED),
    "KITTI": lambda: _text(MATRICES.reshape(FRAMES, 12)),
    "KITTI, stamped": lambda: _text(np.hstack([STAMPED[:, :1], MATRICES.reshape(FRAMES, 12)])),
    "4x4": lambda: _text(
        np.hstack([MATRICES.reshape(FRAMES, 12), np.tile([0, 0, 0, 1], (FRAMES, 1))])
    ),
    "EuRoC": _euroc,
    "EuRoC with velocities": lambda: _euroc(3),
    "EuRoC without names": lambda: _euroc().split("\n", 1)[1],
    "quoted CSV": lambda: '"x","y","z","qx","qy","qz","qw"\n' + _text(POSES, ","),
    "rows with NaN": _with_nan,
    "millimetres by name": lambda: _text(
        POSES * ([1000] * 3 + [1] * 4), ",", "x [mm],y [mm],z [mm],qx,qy,qz,qw\n"
    ),
    "millimetres": lambda: _text(POSES * ([1000] * 3 + [1] * 4)),
    "Windows": lambda: _text(POSES).replace("\n", "\r\n"),
    "byte order mark": lambda: "\ufeff" + _text(POSES),
}


def _write(tmp_path: Path, text: str, name: str = "a.log") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8", newline="")
    return path


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_door_comes_out_of_every_format(tmp_path: Path, name: str) -> None:
    track = read_pose_log(_write(tmp_path, FORMATS[name]()))
    np.testing.assert_allclose(track.p_world, P_WORLD, atol=1e-8)
    assert track.R_world_part is not None
    np.testing.assert_allclose(track.R_world_part, R_WORLD, atol=1e-7)


def test_what_was_left_out_or_guessed_is_said(tmp_path: Path) -> None:
    def notes(name: str) -> tuple[str, ...]:
        return read_pose_log(_write(tmp_path, FORMATS[name]())).notes

    assert notes("plain") == notes("EuRoC") == notes("millimetres by name") == ()
    assert notes("rows with NaN") == ("2 rows with NaN left out",)
    assert "likely millimetres" in notes("millimetres")[0]


def test_a_unit_that_is_said_is_not_doubted(tmp_path: Path) -> None:
    path = _write(tmp_path, FORMATS["millimetres"]())
    metres = read_pose_log(path, ReadOptions(unit="m"))
    np.testing.assert_allclose(metres.p_world, 1000 * P_WORLD)
    assert metres.notes == ()
    short = read_pose_log(_write(tmp_path, FORMATS["plain"]()), ReadOptions(unit="mm"))
    np.testing.assert_allclose(short.p_world, P_WORLD / 1000)


def test_one_jump_of_a_tracker_does_not_make_metres_millimetres(tmp_path: Path) -> None:
    rows = P_WORLD.copy()
    rows[11] = [900, 0, 0]
    track = read_pose_log(_write(tmp_path, _text(rows)))
    assert track.notes == ()
    np.testing.assert_allclose(track.p_world[:11], P_WORLD[:11], atol=1e-8)


def test_quaternions_w_first_are_read_when_told_and_noticed_when_not(tmp_path: Path) -> None:
    path = _write(tmp_path, _text(np.hstack([P_WORLD, WXYZ])))
    told = read_pose_log(path, ReadOptions(quaternion="wxyz"))
    assert told.R_world_part is not None and told.notes == ()
    np.testing.assert_allclose(told.R_world_part, R_WORLD, atol=1e-7)
    (note,) = read_pose_log(path).notes
    assert "contradict the path" in note and "--quaternion wxyz" in note


@pytest.mark.parametrize("turn_deg", [0.0, 2.0, 40.0])
def test_a_tracker_that_turns_freely_is_no_sign_of_another_order(
    tmp_path: Path, turn_deg: float
) -> None:
    """A drawer whose marker turns by noise, or by a systematic error that follows no path."""
    rng = np.random.default_rng(0)
    turns = np.deg2rad(turn_deg) * rng.normal(size=(FRAMES, 3))
    quaternions = [gtsam.Rot3.Expmap(w).toQuaternion().coeffs() for w in turns]
    p_world = np.outer(np.linspace(0, 0.3, FRAMES), [1.0, 0, 0])
    rows = np.hstack([p_world, np.array(quaternions)])
    assert read_pose_log(_write(tmp_path, _text(rows))).notes == ()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_drawer_whose_marker_tilts_as_it_slides_is_no_sign_either(
    tmp_path: Path, axis: int
) -> None:
    """By 2 deg in all: with a lever of ten metres some turn would explain any path."""
    tilts = np.linspace(0, np.deg2rad(2), FRAMES)
    quaternions = [gtsam.Rot3.Expmap(a * np.eye(3)[axis]).toQuaternion().coeffs() for a in tilts]
    for slides in np.eye(3):
        p_world = np.outer(np.linspace(0, 0.3, FRAMES), slides)
        rows = np.hstack([p_world, np.array(quaternions)])
        assert read_pose_log(_write(tmp_path, _text(rows))).notes == ()


def test_a_number_after_the_pose_is_no_stamp_before_it(tmp_path: Path) -> None:
    """A confidence at the end: read as TUM, such rows would be another path altogether."""
    for last in (0.0, 1.0, 0.93):
        rows = np.hstack([POSES, np.full((FRAMES, 1), last)])
        with pytest.raises(InputError, match="looks like x y z qx qy qz qw and one number more"):
            read_pose_log(_write(tmp_path, _text(rows)))
        with pytest.raises(InputError, match="looks like x y z and one number more"):
            read_pose_log(_write(tmp_path, _text(np.delete(rows, [3, 4, 5, 6], axis=1))))
    turned_round = np.hstack([P_WORLD[::-1], np.ones((FRAMES, 1))])  # x grows, unevenly
    with pytest.raises(InputError, match="or stamps that do not tick evenly"):
        read_pose_log(_write(tmp_path, _text(turned_round)))


def test_positions_after_stamps_are_read_and_that_is_said(tmp_path: Path) -> None:
    jitter_s = 0.03 * np.random.default_rng(0).random(FRAMES)
    for stamps in (0.1 * np.arange(FRAMES), 1.7e9 + 0.1 * np.arange(FRAMES) + jitter_s):
        rows = np.hstack([stamps[:, None], P_WORLD])
        lines = [" ".join([f"{row[0]:.4f}", *(f"{x:.9g}" for x in row[1:])]) for row in rows]
        track = read_pose_log(_write(tmp_path, "\n".join(lines)))
        np.testing.assert_allclose(track.p_world, P_WORLD, atol=1e-8)
        assert track.notes == ("four columns were read as stamp, x, y, z",)


def test_stamps_count_from_the_first_and_must_grow(tmp_path: Path) -> None:
    tum = read_pose_log(_write(tmp_path, FORMATS["TUM"]()))
    np.testing.assert_allclose(tum.stamps_s, 0.1 * np.arange(FRAMES))
    euroc = read_pose_log(_write(tmp_path, FORMATS["EuRoC"]()))
    assert euroc.stamps_s is not None
    np.testing.assert_allclose(euroc.stamps_s[-1], 33333312e-9 * (FRAMES - 1), atol=1e-6)
    back = STAMPED.copy()
    back[5, 0] = 0.0
    (note,) = read_pose_log(_write(tmp_path, _text(back))).notes
    assert "stamps do not grow at line 6" in note


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3 4\n", "line 1: 2 columns, looks like pixels"),
        ("5 1 2 3\n4 1 2 3\n", "line 1: 4 columns, looks like x y z and one number more"),
        ("1 2 3 .1 .2 .3\n1 2 3 .1 .2 .3\n", "line 1: 6 columns, looks like"),
        ("0,1,0,2,0,3\n0,1,0,2,0,4\n", "positions with decimal commas between commas"),
        ("0.1 1 2 3 .1 .2 .3\n0.2 1 2 3 .1 .2 .3\n", "line 1: columns 4 to 7 are no unit"),
        ("1 0 0 1 0 9 0 1 0 0 1 1\n" * 2, "line 1: holds no rotation matrix"),
        ('{"poses": []}\n', "looks like JSON"),
        ("<poses>\n</poses>\n", "looks like XML"),
        ("x y z\n", "a.log: has no rows"),
        ("1;2,5;3\n1.5;2;x\n", "line 2: 'x' is not a number"),
        ("1 2 3\x00\n1 2 3\n", "a.log: holds zero bytes"),
        ("1_0 2 3\n1 2 3\n", "'1_0' is not a number"),
    ],
)
def test_what_cannot_be_read_is_said_with_what_it_looks_like(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_pose_log(_write(tmp_path, text))
    assert message in str(caught.value)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("start", "what"),
    [(b"PK\x03\x04\xff", "a zip archive"), (b"#ROSBAG V2.0\n\xff", "a ROS 1 bag")],
)
def test_binary_files_are_named(tmp_path: Path, start: bytes, what: str) -> None:
    (tmp_path / "a.log").write_bytes(start)
    with pytest.raises(InputError, match=f"is not text.*looks like {what}"):
        read_pose_log(tmp_path / "a.log")


def test_text_of_sixteen_bits_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_bytes(_text(POSES).encode("utf-16"))
    np.testing.assert_allclose(read_pose_log(tmp_path / "a.log").p_world, P_WORLD, atol=1e-8)


@pytest.mark.parametrize("suffix", [".csv", ".tum", ".tsv", ".kitti", ".TXT"])
def test_endings_of_other_tools_are_taken(tmp_path: Path, suffix: str) -> None:
    from akm_fg.io.inputs import read_input
    from akm_fg.records import PoseTrack

    path = _write(tmp_path, FORMATS["TUM"](), f"a{suffix}")
    assert isinstance(read_input(path), PoseTrack)
