"""`akm-fg score`: answers against the truth, as a table and as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from akm_fg.cli.main import main
from factors.joint import Joint

TRUE = {"kind": "prismatic", "axis": [0.0, 0.0, 1.0], "pivot": None}


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Posteriors of two drawers along z, 15 and 10 cm."""
    folder = tmp_path_factory.mktemp("answers")
    for seed, travel_m in enumerate((0.15, 0.10)):
        rng = np.random.default_rng(seed)
        shape = rng.uniform(-0.2, 0.2, (20, 3))
        R, t = Joint("prismatic", np.eye(4), 0.0).motion(np.linspace(0, travel_m, 8))
        points = np.einsum("tij,nj->tni", R, shape) + t[:, None]
        points += rng.normal(0, 0.001, points.shape)
        np.savez(folder / f"{seed}.npz", points=points, sigma_m=0.001)
    out = folder / "out.jsonl"
    assert main(["fit", *(str(folder / f"{i}.npz") for i in (0, 1)), "--json", str(out)]) == 0
    return out


def truth(path: Path, **other: object) -> str:
    path.write_text(json.dumps({**TRUE, **other}))
    return str(path)


def test_errors_stand_beside_their_bounds(answers: Path, tmp_path: Path, capfd):
    states = np.linspace(0, 0.15, 8).tolist()
    true = [truth(tmp_path / "a.json", states=states), truth(tmp_path / "b.json")]
    assert main(["score", str(answers), *true, "--json", "-"]) == 0
    first, second = map(json.loads, capfd.readouterr().out.splitlines())
    assert first["schema"] == "akm-fg/score/1" and first["input"].endswith("0.npz")
    assert first["kind_correct"] and first["probability_of_true_kind"] > 0.95
    assert 0.0 < first["axis_error_deg"] < 2.0 * first["axis_bound_deg"]
    said = json.loads(answers.read_text().splitlines()[0])["states"]
    errors, sd = np.array(said["mean"]) - states, np.array(said["sd"])
    assert first["state_rms"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    within = np.abs(errors[1:]) <= 1.96 * sd[1:]
    assert first["states_within_95"] == pytest.approx(within.mean())
    assert second["state_rms"] is None and second["axis_error_deg"] is not None
    assert main(["score", str(answers), *true]) == 0
    printed = capfd.readouterr().out
    assert "right" in printed and "axis direction" in printed
    assert max(map(len, printed.splitlines())) <= 80


def test_a_wrong_kind_and_a_wrong_axis_are_told_and_make_the_exit_code_1(
    answers: Path, tmp_path: Path, capfd
):
    door = truth(tmp_path / "door.json", kind="revolute", pivot=[0.0, 0.0, 0.0])
    assert main(["score", str(answers), door, "--json", "-"]) == 1  # one truth for all
    lines = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [line["kind_correct"] for line in lines] == [False, False]
    assert all(line["axis_error_deg"] is None is line["axis_bound_deg"] for line in lines)
    tilted = truth(tmp_path / "tilted.json", axis=[0.0, 0.6, 0.8])
    assert main(["score", str(answers), tilted, "--json", "-"]) == 0
    found = json.loads(capfd.readouterr().out.splitlines()[0])
    assert found["axis_error_deg"] == pytest.approx(36.9, abs=1.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "holds no truth"),
        ('{"kind": "sliding", "axis": [0, 0, 1]}', "`kind` is 'sliding'"),
        ('{"kind": "revolute", "axis": [0, 0, 1]}', "`pivot` is missing"),
        ('{"kind": "prismatic", "axis": [0, 0, 2]}', "has length 2"),
        ('{"kind": "prismatic"', "line 1"),
        (None, "does not exist"),
    ],
)
def test_a_broken_truth_is_one_line(
    answers: Path, tmp_path: Path, capfd, content: str | None, words: str
):
    path = tmp_path / "truth.json"
    if content is not None:
        path.write_text(content)
    assert main(["score", str(answers), str(path)]) == 2
    err = capfd.readouterr().err.strip()
    assert err.count("\n") == 0 and words in err and "truth.json" in err


def test_a_broken_answer_is_one_line(answers: Path, tmp_path: Path, capfd):
    true = truth(tmp_path / "true.json")
    lines = answers.read_text().splitlines()
    broken = tmp_path / "broken.jsonl"
    for content, words in (
        (f"{lines[0]}\nnonsense\n", "line 2 is not JSON"),
        (f"{lines[0]}\n[]\n", "line 2 is no JSON object"),
        (f"{lines[0]}\n{{}}\n", "line 2: schema"),
        ("\n", "holds no posterior"),
    ):
        broken.write_text(content)
        assert main(["score", str(broken), true]) == 2
        err = capfd.readouterr().err.strip()
        assert err.count("\n") == 0 and words in err and "broken.jsonl" in err
    assert main(["score", str(answers), true, true, true]) == 2
    assert "3 truths for 2 answers" in capfd.readouterr().err
    assert main(["score", str(answers)]) == 2  # tracks hold no truth
    assert "0.npz" in capfd.readouterr().err
