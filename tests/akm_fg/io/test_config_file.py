"""Configuration files: what they may set, and one clear line for what they may not."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from akm_fg.config import AkmConfig
from akm_fg.errors import InputError
from akm_fg.estimation.config import GraspConfig
from akm_fg.io.config_file import config_as_dict, config_as_toml, read_config, write_config


@dataclass(frozen=True, slots=True)
class Spring:
    stiffness_n_m: float  # no default: the tree has one all the same
    rest_m: float = 0.1

    def __post_init__(self) -> None:
        if self.stiffness_n_m <= 0.0:
            raise ValueError(f"stiffness {self.stiffness_n_m}, expected a number above 0")


@dataclass(frozen=True, slots=True)
class Filter:
    frames: int = 4


@dataclass(frozen=True, slots=True)
class Machine:
    spring: Spring = field(default_factory=lambda: Spring(500.0, rest_m=0.3))
    name: str = "press"
    speed: Literal["slow", "fast"] = "slow"
    rounds: int = 3
    quiet: bool = False
    limit_m: float | None = 0.5
    smoothing: Filter | None = None
    corner: tuple[float, float] = (0.0, 1.0)
    gates: tuple[int, ...] = (1, 2)
    shares: dict[str, float] = field(default_factory=lambda: {"a": 0.25, "b": 0.75})


def read(tmp_path: Path, text: str) -> Machine:
    path = tmp_path / "my.toml"
    path.write_text(text)
    return read_config(path, Machine())


def test_a_file_sets_any_leaf_by_tables_or_dotted_keys_and_leaves_the_others(tmp_path: Path):
    text = """
        spring.stiffness_n_m = 700
        rounds = 5
        quiet = true
        limit_m = "none"
        corner = [2.0, inf]
        gates = [1, 2, 3]
        speed = "fast"
        shares.a = 0.5

        [smoothing]
        frames = 8
    """
    assert read(tmp_path, text) == Machine(
        spring=Spring(700.0, rest_m=0.3),
        speed="fast",
        rounds=5,
        quiet=True,
        limit_m=None,
        smoothing=Filter(8),
        corner=(2.0, np.inf),
        gates=(1, 2, 3),
        shares={"a": 0.5, "b": 0.75},
    )
    assert read(tmp_path, "") == Machine()
    assert read(tmp_path, 'name = "none"').name == "none"  # text stays text


def test_an_absent_table_is_filled_up_from_its_own_defaults(tmp_path: Path):
    path = tmp_path / "grasp.toml"
    path.write_text("fit.grasp.dof = 5.0")
    assert read_config(path, AkmConfig()).fit.grasp == GraspConfig(dof=5.0)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("round = 4", "round = 4: is no setting; expected rounds"),
        ("spring.stifness_n_m = 4", "is no setting; expected spring.stiffness_n_m"),
        ("frames = 4", "frames = 4: is no setting; expected smoothing.frames"),
        ("shares.c = 0.1", "shares.c = 0.1: is no setting; expected shares.b or shares.a"),
        ("smoothing.fames = 1", "smoothing.fames = 1: is no setting; expected smoothing.frames"),
        ("xyz = 1", "xyz = 1: is no setting; expected one of corner, gates, limit_m, name,"),
        ("rounds = 3.5", "rounds = 3.5: is of the wrong type; expected a whole number"),
        ("rounds = true", "rounds = true: is of the wrong type; expected a whole number"),
        ('rounds = "none"', 'rounds = "none": is of the wrong type; expected a whole number'),
        ('limit_m = "1"', 'limit_m = "1": is of the wrong type; expected a number'),
        ("limit_m = 1979-05-27", "is of the wrong type; expected a number"),
        ("limit_m = nan", "limit_m = NaN: is no value; expected a number"),
        ("quiet = 1", "quiet = 1: is of the wrong type; expected true or false"),
        ("name = 1", "name = 1: is of the wrong type; expected text in quotes"),
        ("spring = 3", "spring = 3: is of the wrong type; expected a table of settings"),
        ("shares = 3", "shares = 3: is of the wrong type; expected a table of settings"),
        ("gates = 3", "gates = 3: is of the wrong type; expected a list in brackets"),
        ("corner = [1.0]", "corner = [1.0]: is too short"),
        ("corner = [1.0, 2.0, 3.0]", "corner = [1.0, 2.0, 3.0]: is too long; expected a list of 2"),
        ('speed = "warp"', "speed = \"warp\": is no choice; expected 'slow' or 'fast'"),
        (
            "spring.stiffness_n_m = -1",
            "spring.stiffness_n_m = -1: stiffness -1.0; expected a number above 0",
        ),
        ("rounds == 3", "is not TOML: "),
    ],
)
def test_what_cannot_be_used_gets_one_line_with_key_value_and_what_is_expected(
    tmp_path: Path, text: str, line: str
):
    with pytest.raises(InputError) as refused:
        read(tmp_path, text)
    said = str(refused.value)
    assert said.startswith(str(tmp_path / "my.toml")) and "\n" not in said
    assert line in said and "expected" in said


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="cannot be read"):
        read_config(tmp_path / "absent.toml", Machine())
    with pytest.raises(InputError, match="cannot be read"):
        read_config(tmp_path, Machine())
    (tmp_path / "image.toml").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="is not TOML"):
        read_config(tmp_path / "image.toml", Machine())


def test_other_commands_tables_are_left_alone_where_that_is_asked_for(tmp_path: Path):
    path = tmp_path / "my.toml"
    path.write_text("rounds = 4\n[sim]\ncamera.focal_px = 450.0\n")
    assert read_config(path, Machine(), others=("sim",)).rounds == 4
    with pytest.raises(InputError, match=r"sim = .* is no setting"):
        read_config(path, Machine())


@pytest.mark.parametrize(
    "tree",
    [
        Machine(),
        Machine(limit_m=None, smoothing=Filter(2), corner=(1e-17, np.pi), gates=()),
        AkmConfig(),
    ],
)
def test_a_tree_that_is_written_is_read_again_to_the_last_digit(tmp_path: Path, tree):
    path = tmp_path / "whole.toml"
    write_config(path, tree, ["of a test", "to be read"])
    assert path.read_text().startswith("# of a test\n# to be read\n")
    assert read_config(path, type(tree)()) == tree
    assert config_as_dict(read_config(path, type(tree)())) == tomllib.loads(path.read_text())


def test_every_leaf_is_in_what_is_written():
    written = tomllib.loads(config_as_toml(Machine(limit_m=None)))
    assert set(written) == set(Machine.__dataclass_fields__)
    assert written["limit_m"] == written["smoothing"] == "none"
    assert written["shares"] == {"a": 0.25, "b": 0.75}


def test_a_change_shows_in_what_is_written():
    whole = AkmConfig()
    changed = replace(whole, fit=replace(whole.fit, dof=4.0))
    assert tomllib.loads(config_as_toml(changed))["fit"]["dof"] == 4.0
