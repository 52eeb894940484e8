import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from akm_fg.errors import OutputError
from akm_fg.posterior import StatePosterior
from akm_fg.report.page import render_page
from akm_fg.report.pictures import band_magnification
from akm_fg.report.plots import kinds_svg
from akm_fg.report.summary import ArmRecord
from akm_fg.report.write import write_report


def text_of(page: str) -> str:
    """What a person reads: no tags, no styles, no no-break spaces."""
    body = re.sub(r"<(style|svg).*?</\1>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", body)))


@pytest.fixture(scope="module")
def page(scenes):
    return render_page(scenes.summary("revolute"))


@pytest.fixture(scope="module")
def text(page):
    return text_of(page)


@pytest.fixture
def words():
    """Renders the text of a page."""
    return lambda summary: text_of(render_page(summary))


def test_the_page_stands_alone(page):
    assert "http://" not in page and "https://" not in page
    assert "<script" not in page and "<link" not in page and "url(#" in page
    sources = re.findall(r'src="([^"]{0,22})', page)
    assert len(sources) == 3 and set(sources) == {"data:image/jpeg;base64"}


def test_names_inside_the_plots_are_unique_and_resolve(page):
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))
    used = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', page)
    assert {a or b for a, b in used} <= set(names)


@pytest.mark.parametrize(
    "piece",
    [
        "furniture-dev/cabinet-003",
        "A robot pulled at an object",
        "Target reached. Revolute, probability > 99.9 %. Final error −0.57° (tolerance 3°).",
        "moving part (36 points)",
        "axis with its 95 % band",
        "Frame 7 (of 0–11), pull",
        "Frame 11 (of 0–11), closed loop",
        "95 % probability true to 1.4°",
        "joint kind",
        "axis direction",
        "pivot",
        "state, frame 11",
        "95 % bound",
        "true error",
        "move 2",
        "How to read this",
        "How to reproduce",
        "akm-fg demo --seed 3",
        "fit 12 ms",
        "explore 12.3 s",
        "0.1.0",
    ],
)
def test_the_page_says(text, piece):
    assert piece in text


def test_the_plots_are_there(page):
    assert page.count("<svg") == 2


def test_strings_are_escaped(scenes):
    bad = "<script>alert('x')</script>&"
    fit = {"parametric": False, "warnings": (bad,)}
    posterior = scenes.posterior("revolute", **fit)
    texts = {"title": bad, "command": bad, "version": bad, "failure": bad, "time_s": {bad: 1.0}}
    summary = scenes.summary("revolute", posterior=posterior, **texts)
    summary = replace(summary, recording=replace(summary.recording, name=bad))
    page = render_page(summary)
    assert "<script" not in page and page.count("&lt;script&gt;") >= 6


def test_the_same_run_gives_the_same_page(scenes, page):
    assert render_page(scenes.summary("revolute")) == page


def test_a_look_is_no_move(words, scenes):
    moved = scenes.summary("revolute").rounds
    text = words(scenes.summary("revolute", rounds=(replace(moved[0], commanded=None), moved[1])))
    assert "first look –" in text and "move 1" in text and "move 2" not in text


def test_the_surface_is_told_where_it_is_in_the_fit(words, scenes):
    fit = {"keyframes_registered": (0, 5, 11), "patches_used": 321, "patches_rms_m": 0.0006}
    text = words(scenes.summary("revolute", posterior=scenes.posterior("revolute", **fit)))
    assert "RGB-D camera and the part's surface in 3 of them" in text
    assert "surface in the fit 321 patches of 3 frames, 0.060 cm rms" in text
    assert "surface" not in words(scenes.summary("revolute"))


def test_what_the_simulator_measured_of_the_arm_is_told(words, scenes):
    shares = {"speed": 0.412, "torque": 0.07}
    text = words(scenes.summary("revolute", arm=ArmRecord(0.0021, np.deg2rad(1.5), shares)))
    assert "slip of the grasp 0.21 cm and 1.5° at the end" in text
    assert "most of the arm's limits speed 41 %, torque 7 %" in text
    text = words(scenes.summary("revolute", arm=ArmRecord(None, None, {})))
    assert "slip" not in text and "limits" not in text


def test_a_drawer_has_no_pivot(words, scenes):
    text = words(scenes.summary("prismatic"))
    assert "none: a sliding joint has no pivot" in text and "cone" in text


def with_joint(posterior, joint):
    fits = dict(posterior.alternatives)
    fits[joint.kind] = replace(fits[joint.kind], joint=joint)
    return replace(posterior, alternatives=fits)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_band_too_thin_to_be_seen_is_magnified_and_says_so(words, scenes, kind):
    sharp = with_joint(scenes.posterior(kind), scenes.joint(kind, 1e-4, 1e-4))
    text = words(scenes.summary(kind, posterior=sharp))
    factor = int(re.search(r"drawn (\d+) × as wide", text)[1])
    assert factor > 1 and f"it is drawn {factor} times as wide as it is" in text
    vague = with_joint(scenes.posterior(kind), scenes.joint(kind, 0.1, 0.03))
    text = words(scenes.summary(kind, posterior=vague))
    assert "is to scale" in text and "× as wide" not in text


def test_the_magnified_band_is_about_as_wide_as_a_line_can_show(scenes):
    sharp = scenes.summary("revolute", posterior=with_joint(
        scenes.posterior("revolute"), scenes.joint("revolute", 1e-4, 1e-4)))  # fmt: skip
    half_px = 1.96 * 1e-4 * 0.5 * 300 / 1.2 * 3  # tilt, reach, focal length, distance, enlargement
    factor = band_magnification(sharp)
    assert 5 < half_px * factor < 40


def test_a_kind_without_a_fit_has_no_odds(scenes):
    posterior = scenes.posterior("revolute")
    posterior = replace(posterior, kind_probability={**posterior.kind_probability, "helical": 0.0})
    assert kinds_svg(posterior, 0.95) != kinds_svg(scenes.posterior("revolute"), 0.95)
    assert "helical" not in posterior.alternatives
    render_page(scenes.summary("revolute", posterior=posterior))


def test_a_program_that_is_wrong_about_its_success_is_found_out(words, scenes):
    text = words(scenes.summary("revolute", final_state_true=0.1))
    assert "Target not reached." in text and "wrongly believed" in text


def test_a_lucky_end_is_not_a_success(words, scenes):
    rounds = (replace(scenes.summary().rounds[-1], p_within_tolerance=0.6),)
    text = words(scenes.summary("revolute", rounds=rounds))
    assert "Target not reached." in text and "was not sure" in text


def test_without_truth_no_error_is_invented(words, scenes):
    text = words(scenes.summary("revolute", truth=None, final_state_true=None))
    assert "the truth is not known" in text and "Not shown: no truth" in text
    legend = text.split("What the camera saw")[1][:300]
    assert "true axis" not in legend


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_an_undecided_answer_shows_the_most_probable_kind(words, scenes, kind):
    posterior = scenes.posterior(
        kind, "undecided" if kind == "prismatic" else None, parametric=False
    )
    text = words(scenes.summary(kind, posterior=posterior))
    assert "No joint kind explains the data." in text
    assert (f"undecided (most probable: {kind})" in text) == (kind == "prismatic")


def test_nothing_moved_is_a_result(scenes):
    posterior = scenes.posterior("rigid")
    changes = {"goal": None, "rounds": (), "truth": scenes.truth("revolute")}
    page = render_page(scenes.summary("rigid", posterior=posterior, **changes))
    assert "Wrong joint kind." in text_of(page) and "wrong: truly revolute" in text_of(page)
    assert page.count("<svg") == 1 and "axis direction" not in text_of(page)


def test_a_run_that_failed_early_still_gives_a_page(scenes):
    nothing = dict.fromkeys(("posterior", "tracks", "truth", "closed_loop_frame"))
    failure = "nothing moved in 25 attempts"
    summary = scenes.summary("revolute", rounds=(), failure=failure, **nothing)
    text = text_of(render_page(summary))
    assert "Target not reached." in text and "Cause: nothing moved in 25 attempts." in text
    assert "No joint could be estimated" in text and "looking again" not in text


def test_a_part_that_was_never_seen_has_no_plot_of_states(scenes):
    states = StatePosterior("rad", np.full(12, np.nan), np.full(12, np.nan))
    page = render_page(scenes.summary("revolute", states=states))
    assert "the part was not seen in any frame" in page and page.count("<svg") == 1


def test_a_wrong_kind_is_said_to_be_wrong(words, scenes):
    summary = scenes.summary("revolute", posterior=scenes.posterior("prismatic"))
    text = words(summary)
    assert "The true joint is revolute." in text and "wrong: truly revolute" in text


def test_one_frame_is_enough(scenes):
    recording = scenes.recording("revolute", np.zeros(1))
    page = render_page(
        scenes.summary("revolute", recording=recording, tracks=None, posterior=None, rounds=(),
                       goal=None, closed_loop_frame=None, truth=None)
    )  # fmt: skip
    assert "No joint found." in page and page.count("<img") == 1


def test_the_report_is_written_also_into_a_new_folder(scenes, tmp_path, page):
    path = tmp_path / "new" / "report.html"
    write_report(path, scenes.summary("revolute"))
    assert path.read_text(encoding="utf-8") == page
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_a_place_that_cannot_be_written_is_named_in_one_line(scenes, tmp_path):
    summary = scenes.summary("revolute", posterior=None, tracks=None, rounds=())
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "report.html"):
        with pytest.raises(OutputError) as caught:
            write_report(path, summary)
        assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)
