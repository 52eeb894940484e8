"""What goes wrong in a run on purpose: when it happens, what counts, and what comes of it."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from akm_fg.cli.exploring.explore import ExploreArguments, explore_request
from akm_fg.cli.exploring.simulated import explore_in_simulator
from akm_fg.records import PinholeCamera, RgbdFrame
from experiments import faults
from experiments.faults import FaultRow, run_fault
from experiments.trials import mishaps
from experiments.trials.mishaps import BLOCKED, JAMMED, MISHAPS, OPENED, OTHERS, Mishap, Way

ROW = FaultRow(
    name="furniture-dev/drawer-001", fault=BLOCKED, number=2, happened=True, start=0.1, target=0.3,
    claimed=True, within=True, final=0.301, failure=None, probability=0.97, rounds=1, looks=1,
    regrasps=0, blind=0, pressed_n=0.0, limit_share=0.4, cpu_s=20.0,
)  # fmt: skip
WAY = Way(0.1, 0.3, 0.4)


def test_a_fault_is_unnoticed_where_a_claim_is_false_and_counts_where_it_happened():
    assert not ROW.unnoticed
    false = replace(ROW, within=False)
    assert false.unnoticed
    ended = replace(ROW, within=False, claimed=False, failure="the part is not found at 3.5 cm")
    assert not ended.unnoticed
    never = replace(false, happened=False)
    last = faults.table([ROW, never, false, ended, ended]).splitlines()[-1]
    assert last.startswith("| all | 4 | 25.0 ")
    assert "| the part is not found at # cm | 2 |" in faults.reasons([ROW, never, ended, ended])


def test_every_model_is_tried_before_any_comes_again():
    drawn = [faults._model_of(number, 7) for number in range(14)]
    assert sorted(drawn[:7]) == sorted(drawn[7:]) == list(range(7))
    assert drawn[:7] != drawn[7:]


def test_without_models_it_says_what_makes_them(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["faults", "--models", str(tmp_path / "runs" / "models")])
    with pytest.raises(SystemExit, match=r"has no models: run experiments\.closed_loop"):
        faults.main()
    assert not (tmp_path / "runs").exists()


class World:
    """A part and a hand that exist on paper, as a mishap sees them."""

    def __init__(self, state=0.1):
        self.state, self.time_s, self.every_step, self.jams = state, 0.0, [], 0
        self.opened = self.held = False
        gripper = SimpleNamespace(open=self.open, squeezing=False)
        self.arm = SimpleNamespace(gripper=gripper, holding=lambda: self.held)
        self.camera, self.world = self, self

    def part_state(self):
        return self.state

    def jam(self):
        self.jams += 1

    def open(self):
        self.opened = True

    def capture(self):
        camera = PinholeCamera(4, 3, 4.0, 4.0, 1.5, 1.0)
        rgb, depth = np.full((3, 4, 3), 9, np.uint8), np.ones((3, 4), np.float32)
        return RgbdFrame(self.time_s, rgb, depth, camera, gtsam.Pose3())

    def step(self, state):
        self.state = state
        self.time_s += 0.001
        for call in self.every_step:
            call()


def test_a_camera_is_blocked_for_ten_frames_and_no_more():
    mishap = Mishap(World(), BLOCKED, WAY, np.random.default_rng(0))
    dark = [np.isnan(mishap.capture().depth_m).all() for _ in range(30)]
    assert sum(dark) == 10 and not dark[0]
    first = dark.index(True)
    assert all(dark[first : first + 10])
    assert mishap.happened


@pytest.mark.parametrize("way", [WAY, Way(0.3, 0.1, 0.4)])
def test_a_joint_jams_once_on_its_way(way):
    world = World(way.start)
    mishap = Mishap(world, JAMMED, way, np.random.default_rng(0))
    states = np.linspace(way.start, way.target, 200)
    jammed = []
    for state in states:
        world.step(float(state))
        jammed.append(world.jams)
    assert mishap.happened and world.jams == 1
    assert 0.3 <= jammed.index(1) / len(states) <= 0.71


def test_fingers_open_where_they_hold_on_the_way_and_not_before():
    world = World()
    mishap = Mishap(world, OPENED, WAY, np.random.default_rng(0))
    world.step(0.299)
    assert not world.opened and not mishap.happened
    world.held = True
    world.step(0.299)
    assert world.opened and mishap.happened


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A drawer's and a door's, explored under a camera and an arm that err."""
    made = {}
    for name in ("furniture-dev/drawer-004", "furniture-dev/drawer-003"):
        out = tmp_path_factory.mktemp("explored")
        asked = ExploreArguments(object=name, seed=53, rig_errors=True, out=out)
        explored = explore_in_simulator(explore_request(asked))
        assert explored.model is not None
        made[name] = explored.model.parent
    return made


@pytest.mark.slow
@pytest.mark.parametrize("fault", MISHAPS)
def test_in_the_simulator_it_is_noticed_and_cured_or_ends_with_a_reason(fault, models):
    (name, model), (_, other) = models.items()
    for number in range(6):
        row = run_fault(name, fault, number, 53, model, other)
        if row.happened:
            break
    assert row.happened, "no run came as far"
    assert not row.unnoticed
    assert row.claimed or row.failure
    assert row.blind == 0
    if fault in (mishaps.JAMMED, mishaps.STOPPED):
        assert "does not go on" in row.failure
    if fault == OTHERS:
        assert "not found" in row.failure and row.rounds == 0
    if fault in (mishaps.PUSHED, mishaps.TELEPORTED, mishaps.OPENED, BLOCKED):
        assert row.claimed and row.within
