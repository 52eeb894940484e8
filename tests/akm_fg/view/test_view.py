"""The page in three dimensions: what is on it, that it stands alone, that a browser opens it."""

from __future__ import annotations

import html
import json
import re
import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.io.recording import write_recording
from akm_fg.model.write import write_model
from akm_fg.view.contents import Contents, axis_cone, contents_of
from akm_fg.view.page import html_page
from tests.akm_fg.io.sources.conftest import write_tum
from tests.akm_fg.view.browser import BROWSER, opened


@pytest.fixture(scope="module")
def contents(door_model, fitted_door) -> Contents:
    return contents_of(door_model, "a <door>", fitted_door.observed)


def test_the_cone_holds_the_sampled_axes(door_model) -> None:
    part = door_model.parts[0]
    joint = part.joint
    cone = axis_cone(part)
    T = joint.T_world_joint
    rng = np.random.default_rng(0)
    xi = rng.multivariate_normal(np.zeros(6), joint.cov, 4000, method="eigh")
    local = (cone.p_world - T[:3, 3]) @ T[:3, :3]
    s = local[:, 2].reshape(-1, 32)[:, 0]
    radius = np.linalg.norm(local[:, :2], axis=1).reshape(-1, 32)
    assert np.ptp(radius, axis=1).max() < 1e-9
    assert radius[0, 0] > 0.999999 * radius.max() and radius[:, 0].argmin() == len(s) // 2
    # Where a sampled axis crosses the rings: pivot's offset and tilt, to first order.
    x = xi[:, 3][:, None] + xi[:, 1][:, None] * s
    y = xi[:, 4][:, None] - xi[:, 0][:, None] * s
    inside = (np.hypot(x, y) <= radius[:, 0]).all(axis=1).mean()
    assert inside >= 0.90
    middle = np.hypot(x, y)[:, len(s) // 2] <= radius[len(s) // 2, 0]
    assert abs(middle.mean() - 0.95) < 0.02


def test_parts_stay_where_they_were_while_they_are_not_seen(contents: Contents) -> None:
    (moving,) = contents.parts
    q = np.array([0.0, np.nan, 0.2, np.nan])
    unseen = replace(contents, parts=(replace(moving, q=q, sd=np.full(4, 0.01)),))
    assert list(unseen.frames()) == [(0, [0.0]), (2, [0.2])]
    two = replace(unseen, parts=(*unseen.parts, replace(moving, q=np.full(4, 0.1))))
    assert list(two.frames())[1] == (1, [0.0, 0.1])


def test_parts_of_several_recordings_are_played_one_after_the_other(two_part_model) -> None:
    door, drawer = two_part_model.parts
    best = drawer.posterior.best
    shorter = replace(best.states, mean=best.states.mean[:-1], sd=best.states.sd[:-1])
    kinds = {**drawer.posterior.alternatives, drawer.posterior.kind: replace(best, states=shorter)}
    drawer = replace(drawer, posterior=replace(drawer.posterior, alternatives=kinds))
    told = contents_of(two_part_model.with_part(drawer), "two")
    frames = list(told.frames())
    n, m = len(door.states.mean), len(drawer.states.mean)
    assert frames[-1][0] == n + m - 1
    for number, (q_door, q_drawer) in frames:
        if number < n:  # while the door is opened the drawer is closed, and the other way round
            assert q_drawer == drawer.closed_state
        else:
            assert q_door == door.closed_state
            assert np.isfinite(told.parts[1].sd[number])
    assert max(abs(q) for _, (q, _) in frames) > 0.1 and max(abs(q) for _, (_, q) in frames) > 0.05
    assert "<title>two</title>" in html_page(told)


def test_tracks_are_those_of_the_part_and_of_what_rests(contents: Contents, door) -> None:
    tracks = contents.tracks
    assert tracks is not None and tracks.moving.any() and (~tracks.moving).any()
    way = np.linalg.norm(np.diff(tracks.segments_world, axis=1)[:, 0], axis=1)
    assert np.median(way[tracks.moving]) > 3 * np.median(way[~tracks.moving])


def test_words_are_short_and_say_what_is_sure(contents: Contents) -> None:
    (moving,) = contents.parts
    assert re.fullmatch(r"revolute, ± [\d.]+ deg, ± [\d.]+ cm", moving.axis_in_words)
    assert moving.state_in_words(np.radians(30), np.radians(1)) == "part-0: 30.0 ± 2 deg"
    assert moving.state_in_words(-1e-9) == "part-0: 0.0 deg"


@pytest.fixture(scope="module")
def page(contents: Contents) -> str:
    pytest.importorskip("viser")
    from akm_fg.view.page import html_page

    return html_page(contents)


def test_the_file_asks_for_nothing_from_elsewhere(page: str) -> None:
    outside = re.findall(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//[^"'> ]+""", page)
    assert outside == []
    assert set(re.findall(r"https?://[\w./-]+", page)) <= {"http://www.w3.org/2000/svg"}
    assert "__VISER_EMBED_DATA__" in page
    assert "a &lt;door&gt;" in page and "a <door>" not in page
    assert len(page) < 8e6


def test_a_small_one_stands_in_a_report_whole_and_folded(door_model) -> None:
    pytest.importorskip("viser")
    from akm_fg.view.embedded import embedded_view

    view = embedded_view(door_model, "a <door>")
    inside = re.fullmatch(r"<details .*? data-page=\"([^\"]*)\"></iframe></details>", view)
    assert inside is not None and "<door>" not in view and len(view) < 3e6
    page = html.unescape(inside[1])
    assert "__VISER_EMBED_DATA__" in page
    assert re.findall(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//[^"'> ]+""", page) == []


def test_without_viser_a_report_says_how_to_get_it(
    door_model, monkeypatch: pytest.MonkeyPatch
) -> None:
    from akm_fg.view.embedded import embedded_view

    monkeypatch.setitem(sys.modules, "viser", None)
    assert "needs viser; install akm-fg[view]" in embedded_view(door_model, "door")


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser is found")
@pytest.mark.parametrize("size", ["1280,800", "500,900"])
def test_a_browser_without_network_shows_it_without_errors(
    page: str, size: str, tmp_path: Path
) -> None:
    from PIL import Image

    assert BROWSER is not None
    file, picture = tmp_path / "door.html", tmp_path / "door.png"
    file.write_text(page)
    command = [BROWSER, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage"]
    command += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    command += [f"--window-size={size}", "--host-resolver-rules=MAP * ~NOTFOUND"]
    command += ["--enable-logging=stderr", "--v=0", "--virtual-time-budget=15000"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}"]
    done = subprocess.run([*command, file.as_uri()], capture_output=True, text=True, timeout=180)
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert any("Embedded data loaded" in line for line in said)
    assert not [line for line in said if "error" in line.lower() or "exception" in line.lower()]
    rgb = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    wood = (np.abs(rgb - [170, 130, 90]).max(axis=2) < 45).mean()
    red = ((rgb[..., 0] > 150) & (rgb[..., 1] < 110) & (rgb[..., 2] < 130)).mean()
    assert wood > 0.02 and red > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_it_is_unfolded_in_a_report_without_errors(
    door, door_model, size: tuple[int, int], tmp_path: Path
) -> None:
    pytest.importorskip("viser")
    from akm_fg.report.summary import RunSummary
    from akm_fg.report.write import write_report
    from akm_fg.view.embedded import embedded_view

    summary = RunSummary("door", "akm-fg fit door", 0, "0", door.recording, None, None)
    view = embedded_view(door_model, "door")
    write_report(tmp_path / "report.html", summary, drawn=(), view=view)
    with opened(tmp_path / "report.html", size, tmp_path / "profile") as page:
        assert page.said == []  # nothing is run before it is unfolded
        assert page.run("document.documentElement.scrollWidth <= innerWidth")
        page.run("document.querySelector('details').open = true")
        page.run("document.querySelector('details').scrollIntoView()")
        assert page.hears("Embedded data loaded")
        assert page.shows(_door_and_axis)
        assert not [line for line in page.said if line.startswith(("error", "exception"))]


def _door_and_axis(rgb: np.ndarray) -> bool:
    wood = (np.abs(rgb - [170, 130, 90]).max(axis=2) < 45).mean()
    red = ((rgb[..., 0] > 150) & (rgb[..., 1] < 110) & (rgb[..., 2] < 130)).mean()
    return bool(wood > 0.01 and red > 1e-4)


def test_the_live_page_answers_and_its_slider_moves_the_part(contents: Contents) -> None:
    pytest.importorskip("viser")
    from akm_fg.view.page import serving

    (moving,) = contents.parts
    with serving(contents, port=18_931) as server:
        url = f"http://{server.get_host()}:{server.get_port()}"
        with urllib.request.urlopen(url, timeout=10) as answer:
            assert answer.status == 200
        handles = server.gui._gui_input_handle_from_uuid.values()
        (slider,) = [each for each in handles if hasattr(each, "min")]
        slider.value = slider.max
        frame = server.scene._handle_from_node_name["/part-0"]
        _, high = moving.part.range_seen()
        expected = moving.part.T_world_part(np.radians(slider.max)).translation()
        _until(lambda: np.allclose(frame.position, expected, atol=1e-6))
        assert abs(np.radians(slider.max) - high) < 0.001


def _until(holds) -> None:
    import time

    for _ in range(100):
        if holds():
            return
        time.sleep(0.05)
    raise AssertionError("it did not come about within five seconds")


def test_the_command_writes_files_of_a_model(
    door_model, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    write_model(tmp_path, door_model)
    out = tmp_path / "page.html"
    assert main(["view", str(tmp_path), "--html", str(out)]) == 0
    captured = capfd.readouterr()
    assert captured.out.split() == [str(out)] and captured.err == ""
    assert "__VISER_EMBED_DATA__" in out.read_text()


def test_rerun_gets_the_same(contents: Contents, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    from akm_fg.view.rerun_log import write_rerun

    write_rerun(tmp_path / "door.rrd", contents)
    data = (tmp_path / "door.rrd").read_bytes()
    assert data[:3] == b"RRF" and len(data) > 100_000


def test_a_recording_is_fitted_and_shown(door, tmp_path: Path, monkeypatch) -> None:
    write_recording(tmp_path / "run" / "recording", door.recording)
    shown: list[Contents] = []
    monkeypatch.setattr("akm_fg.cli.models.view._serve", lambda _, found: shown.append(found))
    assert main(["view", str(tmp_path / "run")]) == 0
    assert shown[0].tracks is not None and shown[0].parts[0].part.posterior.kind == "revolute"


def test_a_recording_of_another_format_is_shown_as_well(door, tmp_path: Path, monkeypatch) -> None:
    folder = write_tum(tmp_path / "my_tum", door.recording)
    shown = []
    monkeypatch.setattr("akm_fg.cli.models.view._serve", lambda _, found: shown.append(found))
    assert main(["view", str(folder)]) == 0
    (contents,) = shown
    assert contents.title == str(folder)


@pytest.mark.parametrize("command", ["fit", "check"])
def test_the_folder_of_a_run_is_no_recording_but_says_where_one_is(
    command: str, door_model, door, tmp_path: Path, capsys
) -> None:
    (tmp_path / "run").mkdir()
    write_model(tmp_path / "run", door_model)
    assert main([command, str(tmp_path / "run")]) == 2
    assert "holds an answer (model.json), and no recording" in capsys.readouterr().err
    write_recording(tmp_path / "run" / "recording", door.recording)
    assert main([command, str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert f"expected its recording, {tmp_path / 'run' / 'recording'}" in said
    assert len(said.splitlines()) == 1


def test_nothing_to_show_is_one_line(
    still, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "other.json").write_text(json.dumps({"schema": "akm-fg/run/1"}))
    for place, words in (
        ("empty", "holds nothing to show"),
        ("gone", "does not exist"),
        ("other.json", "expected 'akm-fg/model/1'"),
    ):
        assert main(["view", str(tmp_path / place)]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert words in line and place in line
    assert main(["view", str(tmp_path), "--port", "0"]) == 2
