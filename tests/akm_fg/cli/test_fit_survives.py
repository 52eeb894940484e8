"""`akm-fg fit` whatever happens: each input on its own, one line each, nothing lost."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg import __version__, pipeline
from akm_fg.cli.main import main
from akm_fg.pipeline import InputFit
from akm_fg.posterior import ArticulationPosterior

COMMAND = [sys.executable, "-m", "akm_fg.cli.main"]
ROOT = Path(__file__).resolve().parents[3]


def _write_drawer(path: Path, noise_m: float = 0.001, travel_m: float = 0.15) -> Path:
    rng = np.random.default_rng(0)
    shape, q = rng.uniform(-0.2, 0.2, (12, 3)), np.linspace(0.0, travel_m, 8)
    points = shape + q[:, None, None] * np.array([0.0, 0.0, 1.0])
    np.savez(path, points=points + rng.normal(0.0, noise_m, points.shape), sigma_m=noise_m)
    return path


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return _write_drawer(tmp_path / "good.npz")


def _run(*arguments: object, **more: object) -> subprocess.CompletedProcess[str]:
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.run(
        words, capture_output=True, cwd=ROOT, check=False, encoding="utf-8", **more
    )


def _broken_by(monkeypatch: pytest.MonkeyPatch, name: str, change: object) -> None:
    """Let the fit of one input end otherwise."""
    fit_input = pipeline.observe_and_fit

    def changed(data: object, path: str, *more: object) -> InputFit:
        fit = fit_input(data, path, *more)
        return InputFit(change(fit.posterior)) if path.endswith(name) else fit

    monkeypatch.setattr(pipeline, "observe_and_fit", changed)


def test_numbers_that_are_not_finite_are_null_and_the_batch_goes_on(
    good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bad, out = _write_drawer(tmp_path / "bad.npz"), tmp_path / "out.jsonl"

    def with_nan(posterior: ArticulationPosterior) -> ArticulationPosterior:
        fit = replace(posterior.fit, rms_m=np.nan, log_evidence=-np.inf)
        return replace(posterior, fit=fit)

    _broken_by(monkeypatch, "bad.npz", with_nan)
    assert main(["fit", str(bad), str(good), "--json", str(out)]) == 0
    first, second = (
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
        for line in out.read_text().splitlines()
    )
    assert first["fit"]["rms_m"] is None and first["fit"]["log_evidence"] is None
    assert first["fit"]["warnings"] == ["not finite, null here: fit.log_evidence, fit.rms_m"]
    assert second["fit"]["warnings"] == [] and second["fit"]["rms_m"] > 0


@pytest.mark.parametrize("error", [ValueError("of\nsome kind"), MemoryError(), RecursionError()])
def test_an_error_nobody_thought_of_costs_one_input_one_line(
    good: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    error: Exception,
) -> None:
    bad, out = _write_drawer(tmp_path / "bad.npz"), tmp_path / "out.jsonl"

    def fails(posterior: ArticulationPosterior) -> ArticulationPosterior:
        raise error

    _broken_by(monkeypatch, "bad.npz", fails)
    assert main(["fit", str(bad), str(good), "--json", str(out)]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert str(bad) in line and type(error).__name__ in line and "--debug" in line
    assert json.loads(out.read_text())["input"] == str(good)
    assert main(["fit", str(bad), "--debug"]) == 2
    assert "Traceback" in capfd.readouterr().err


@pytest.mark.parametrize("error", [RuntimeError("it\nfails"), OSError(5, "broken", "a.png")])
def test_an_error_nobody_thought_of_is_one_line_of_any_command(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fails(arguments: object) -> int:
        raise error

    monkeypatch.setattr("akm_fg.cli.looking.check.check", fails)
    assert main(["check", "recording"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("akm-fg: check: ended by an error (") and "AKM_FG_LOG=DEBUG" in line
    monkeypatch.setenv("AKM_FG_LOG", "DEBUG")
    with pytest.raises(type(error)):
        main(["check", "recording"])


def test_one_point_without_noise_is_an_answer_of_valid_json(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.npz"
    np.savez(path, points=np.linspace(0, 0.15, 8)[:, None, None] * np.array([0.0, 0.0, 1.0]) + 1)
    code = main(["fit", str(path), "--json", "-"])
    captured = capfd.readouterr()
    posterior = json.loads(
        captured.out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON")
    )
    assert (posterior["kind"], code) in (("prismatic", 0), ("undecided", 1))
    assert captured.err == ""


def test_an_old_file_survives_inputs_that_give_nothing(good: Path, tmp_path: Path) -> None:
    out, config = tmp_path / "out.jsonl", tmp_path / "out.jsonl.config.toml"
    out.write_text("old\n")
    assert main(["fit", str(tmp_path / "nowhere"), "--json", str(out)]) == 2
    assert out.read_text() == "old\n" and not config.exists()
    assert main(["fit", str(good), "--json", str(out)]) == 0
    assert json.loads(out.read_text())["input"] == str(good) and config.exists()


def test_a_full_disk_is_one_line_that_says_what_was_kept(good: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.jsonl"
    one = len(_run("fit", good, "--json", "-").stdout)

    def small_disk() -> None:
        resource.setrlimit(
            resource.RLIMIT_FSIZE, (max(3 * one // 2, 20000), resource.RLIM_INFINITY)
        )

    done = _run("fit", *[good] * 4, "--json", out, preexec_fn=small_disk)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    kept = out.read_text().splitlines()
    assert [json.loads(text)["input"] for text in kept] == [str(good)] * len(kept)
    assert 1 <= len(kept) < 4
    assert f"{len(kept)} of 4 inputs done, kept in {out}" in line and "cannot be written" in line


@pytest.mark.parametrize("json_to", ["/dev/full", None, "-"])
def test_a_full_device_is_one_line(good: Path, json_to: str | None) -> None:
    more = [] if json_to is None else ["--json", json_to]
    with Path("/dev/full").open("w") as full:
        words = [*COMMAND, "fit", str(good), *more]
        done = subprocess.run(
            words, stdout=full, stderr=subprocess.PIPE, cwd=ROOT, check=False, encoding="utf-8"
        )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "cannot be written (No space left on device)" in line
    assert not Path("/dev/full.config.toml").exists()


def test_a_reader_that_leaves_ends_the_command_quietly(good: Path) -> None:
    process = subprocess.Popen(
        [*COMMAND, "fit", str(good)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        encoding="utf-8",
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 141


@pytest.mark.parametrize(
    "environment", [{"LANG": "C", "LC_ALL": "C"}, {"PYTHONIOENCODING": "ascii"}]
)
def test_a_terminal_without_signs_gets_words(
    good: Path, tmp_path: Path, environment: dict[str, str]
) -> None:
    umlaut = _write_drawer(tmp_path / "türe.npz")
    done = _run("fit", good, umlaut, env={**os.environ, **environment})
    assert done.returncode == 0 and done.stderr == ""
    assert "prismatic" in done.stdout
    if "PYTHONIOENCODING" in environment:
        assert "+-" in done.stdout and done.stdout.isascii() and r"t\xfcre.npz" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "a.npz", "--seed", "-1"], "--seed: is -1; expected a whole number from 0"),
        (["demo", "--seed", "-5"], "--seed: is -5; expected a whole number from 0"),
        (["fit", "a.npz", "--json", "/proc/nothing/x"], "/proc/nothing/x: cannot be written"),
    ],
)
def test_wrong_arguments_are_one_line(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert words in line


def test_a_log_level_that_is_none_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("AKM_FG_LOG", "loud")
    assert main(["doctor"]) == 2
    assert "AKM_FG_LOG: is 'LOUD'; expected DEBUG" in capfd.readouterr().err


def test_names_cannot_write_to_the_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")  # folders of tests have long names
    evil = tmp_path / "a\x1b]0;owned\x07\n.npz"
    evil.write_bytes(b"")
    shown = _write_drawer(tmp_path / "b\x1b[31m.npz")
    assert main(["fit", str(evil), str(shown)]) == 2
    captured = capfd.readouterr()
    (line,) = captured.err.splitlines()
    assert r"a\x1b]0;owned\x07\n.npz" in line
    assert "\x1b" not in captured.out and r"b\x1b[31m" in captured.out


def _until(path: Path, lines: int) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if path.exists() and path.read_text().count("\n") >= lines:
            return
        time.sleep(0.02)
    raise TimeoutError(path)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
def test_a_signal_leaves_whole_lines(good: Path, tmp_path: Path, how: signal.Signals) -> None:
    out = tmp_path / "out.jsonl"
    out.write_text("old\n" * 3)
    inputs = [str(good)] * 4000
    process = subprocess.Popen(
        [*COMMAND, "fit", *inputs, "--json", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        encoding="utf-8",
        # A run in the background of a shell hands down that interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while out.read_text().startswith("old") and time.monotonic() < deadline:
        time.sleep(0.02)
    _until(out, 2)
    process.send_signal(how)
    _, errors = process.communicate(timeout=60)
    lines = out.read_text().splitlines()
    assert 2 <= len(lines) < 4000
    assert {json.loads(line)["input"] for line in lines} == {str(good)}
    assert not list(tmp_path.glob(".out*"))
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert f"{len(lines)} of 4000 inputs done, kept in {out}" in errors


def test_a_kind_that_is_not_sure_is_exit_code_1(
    good: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    short = tmp_path / "short.npz"
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.2, (4, 3)) + np.linspace(0, 0.01, 5)[:, None, None]
    np.savez(short, points=points + rng.normal(0, 2e-3, points.shape), sigma_m=2e-3)
    assert main(["fit", str(short), str(good)]) == 1
    assert "undecided" in capfd.readouterr().out
    assert main(["fit", str(short), str(tmp_path / "nowhere")]) == 2


def test_the_version_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capfd.readouterr().out == f"akm-fg {__version__}\n"


def test_help_names_the_exit_codes(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "Exit codes: 0 done; 1 ran" in " ".join(capfd.readouterr().out.split())
