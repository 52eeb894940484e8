import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from akm_fg.report.tables import posterior_table, score_table


def show(table, width=120) -> str:
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(table)
    return console.file.getvalue()


def test_each_posterior_gets_a_row_with_its_bounds(scenes):
    text = show(posterior_table([scenes.posterior("revolute"), scenes.posterior("prismatic")]))
    for piece in ("revolute", "prismatic", "> 99.9 %", "± 1.4°", "± 0.98 cm", "23.97 cm", "38"):
        assert piece in text


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_fits_a_terminal(scenes, width):
    posteriors = [scenes.posterior("revolute"), scenes.posterior("prismatic", "undecided")]
    text = show(posterior_table(posteriors), width)
    assert "…" not in text and "undecided" in text and "most probable: prismatic" in text


def test_a_part_that_did_not_move_has_no_joint_to_list(scenes):
    text = show(posterior_table([scenes.posterior("rigid", warnings=("too short",))]))
    assert "rigid" in text and "°" not in text.split("rigid")[1] and "too short" in text


def test_names_are_not_read_as_markup(scenes):
    posterior = replace(scenes.posterior("revolute"), name="[red]a[/]")
    assert "[red]a[/]" in show(posterior_table([posterior]))
    assert "[b]t" in show(score_table(scenes.summary("revolute", title="[b]t")))


def test_the_score_stands_beside_its_bound(scenes):
    lines = show(score_table(scenes.summary("revolute"))).splitlines()
    axis = next(line for line in lines if "axis direction" in line)
    assert "1.4°" in axis and "0.57°" in axis
    assert any("target 52.14° ± 3°" in line for line in lines)


def test_a_run_without_posterior_gives_an_empty_table(scenes):
    assert score_table(scenes.summary("revolute", posterior=None, rounds=())).row_count == 0


@pytest.mark.parametrize("lengths", [(6, 6), (1, 1), (0, 1), (0, 2)])
def test_vectors_stay_on_one_line_in_eighty_columns_beside_long_names(scenes, lengths):
    names = [f"/data/{'kitchen-' * n}{i}/recording" for i, n in enumerate(lengths)]
    posteriors = [replace(scenes.posterior("revolute"), name=name) for name in names]
    text = show(posterior_table(posteriors), width=80)
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    assert all(line[-1] in "┓┃┩│┤┘" for line in text.splitlines() if line[0] in "┏┃┡│├└")
    assert text.count("(0.010, 0.000, 1.000)") == 2 or text.count(", 1.000)") == 2
    assert "/data" not in text  # what the names share


def test_a_table_in_ascii_says_the_same(scenes):
    posteriors = [scenes.posterior("revolute", warnings=("grün",)), scenes.posterior("prismatic")]
    console = Console(width=80, file=io.TextIOWrapper(io.BytesIO(), "ascii", "backslashreplace"))
    console.print(posterior_table(posteriors, plain=True))
    console.file.flush()
    text = console.file.buffer.getvalue().decode("ascii")
    for piece in ("> 99.9 %", "+- 1.4 deg", "+- 0.98 cm", "23.97 cm"):
        assert piece in text


def test_control_characters_of_a_name_are_escaped(scenes):
    posterior = replace(scenes.posterior("revolute"), name="a\x1b[2Jb\nc\u202e")
    text = show(posterior_table([posterior]))
    assert "\x1b" not in text and "\u202e" not in text
    assert r"a\x1b[2Jb\nc\u202e" in text


def test_the_table_says_where_a_part_that_leaves_was_last_seen(scenes):
    posterior = scenes.posterior("revolute")
    assert "last seen" not in show(posterior_table([posterior]))
    best = posterior.best
    mean, frames = best.states.mean.copy(), best.states.mean.size
    mean[-3:] = np.nan
    left = replace(best, states=replace(best.states, mean=mean))
    posterior = replace(posterior, alternatives={**posterior.alternatives, "revolute": left})
    text = show(posterior_table([posterior]))
    assert f"last seen in frame {frames - 4} of {frames}" in text
