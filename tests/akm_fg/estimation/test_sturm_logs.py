"""Real joints: the pose logs of Sturm et al., Learning Kinematic Models for Articulated Objects.

They are not part of the project: the tests are skipped where the folder is absent.
"""

from pathlib import Path

import pytest

from akm_fg.estimation.fit import fit_poses
from akm_fg.io.pose_log import read_pose_log

LOGS = Path(__file__).parents[4] / "shared" / "data" / "sturm"
SAMPLE = {
    "mechanisms_iros_2010/drawer/003",
    "mechanisms_iros_2010/dishwasher/003",
    "mechanisms_iros_2010/left_door/003",
    "kitchen/M2U00390",
    "cabinet_two/005",
    "cosine-synth/cosine-noise3",
}


def _slow_unless_sampled(folder, count):
    """The logs of a folder; all but the sample are slow. Placeholders where there are none."""
    names = [str(p.relative_to(LOGS).with_suffix("")) for p in sorted(LOGS.glob(f"{folder}/*.log"))]
    if len(names) != count:
        reason = f"{len(names)} of {count} logs of {folder} in ../shared/data/sturm"
        return [pytest.param(folder, marks=pytest.mark.skip(reason=reason))]
    return [pytest.param(n, marks=[] if n in SAMPLE else pytest.mark.slow) for n in names]


def _fit(log):
    return fit_poses(read_pose_log(LOGS / f"{log}.log"), name=log)


MECHANISMS = _slow_unless_sampled("mechanisms_iros_2010/*", 30) + _slow_unless_sampled("kitchen", 4)


@pytest.mark.parametrize("log", MECHANISMS)
def test_drawers_slide_and_doors_turn(log):
    kind = "prismatic" if "drawer" in log or "M2U00394" in log else "revolute"
    posterior = _fit(log)
    assert posterior.kind == kind
    assert posterior.kind_probability[kind] >= 0.95


@pytest.mark.parametrize("log", _slow_unless_sampled("cabinet_two", 10))
def test_a_cabinet_door_turns_or_is_left_undecided(log):
    assert _fit(log).kind in ("revolute", "undecided")


@pytest.mark.parametrize("log", _slow_unless_sampled("cosine-synth", 5))
def test_a_path_that_no_joint_makes_is_not_called_one(log):
    posterior = _fit(log)
    assert not posterior.fit.parametric
    assert posterior.kind == "undecided"
