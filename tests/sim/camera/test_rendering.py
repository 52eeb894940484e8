from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.camera import rendering
from sim.camera.camera import CameraConfig
from sim.camera.egl_process import EglScene, RendererFailed
from sim.camera.mirror import LocalScene
from sim.camera.pictures import SAMPLED_AT
from sim.camera.rendering import (
    ENVIRONMENT,
    EXACT_M,
    Trial,
    choose_renderer,
    has_card,
    open_scene,
    plane_error_m,
    try_egl,
)
from sim.episode import open_world


@pytest.fixture
def no_wish(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever runs the tests may have named a renderer."""
    monkeypatch.delenv(ENVIRONMENT, raising=False)


@pytest.fixture(scope="module")
def egl() -> EglScene:
    trial = try_egl()
    if not trial.device:  # where it starts but draws wrongly, the tests fail
        pytest.skip(f"no EGL on this machine: {trial.problem}")
    scene = EglScene()
    yield scene
    scene.close()


def test_a_plane_drawn_by_tiny_projects_back_within_a_tenth_of_a_millimetre():
    scene = LocalScene()
    assert plane_error_m(scene, (640, 480)) < EXACT_M
    assert plane_error_m(scene, (1280, 960)) < EXACT_M
    scene.close()


def test_a_plane_drawn_by_egl_projects_back_within_a_tenth_of_a_millimetre(egl: EglScene):
    assert plane_error_m(egl, (640, 480)) < EXACT_M
    assert plane_error_m(egl, (1024, 768)) < EXACT_M


def test_the_other_renderers_pixel_convention_would_be_wrong(
    egl: EglScene, monkeypatch: pytest.MonkeyPatch
):
    tiny = LocalScene()
    monkeypatch.setitem(SAMPLED_AT, "tiny", (0.5, 0.5))
    monkeypatch.setitem(SAMPLED_AT, "egl", (0.0, 1.0))
    assert plane_error_m(tiny, (640, 480)) > 3.0 * EXACT_M
    assert plane_error_m(egl, (640, 480)) > 3.0 * EXACT_M
    tiny.close()


def test_both_renderers_show_the_same_world(egl: EglScene):
    half = CameraConfig().scaled(0.5)
    seen = []
    for renderer in ("tiny", "egl"):
        config = CameraConfig(
            width=half.width, height=half.height, focal_px=half.focal_px, renderer=renderer
        )
        with open_world("drawer", 0, "clean", camera_config=config) as opened:
            camera = opened.camera
            assert camera.renderer.name == renderer
            rgb, depth = camera.exact()
            again = camera.exact()
            np.testing.assert_array_equal(rgb, again[0])
            np.testing.assert_array_equal(depth, again[1])
            seen.append((rgb.astype(float), depth))
    apart_m = np.abs(seen[0][1] - seen[1][1])
    assert np.nanmedian(apart_m) < 0.01  # half a pixel on tilted surfaces
    assert np.median(np.abs(seen[0][0] - seen[1][0])) < 12.0  # light and shadows differ a little


def test_without_a_card_tiny_draws(no_wish: None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rendering, "has_card", lambda: False)
    assert choose_renderer().name == "tiny"


def test_egl_draws_where_a_card_is_and_its_trial_comes_out_right(
    no_wish: None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(rendering, "has_card", lambda: True)
    for trial, name in (
        (Trial("NVIDIA RTX A2000", None), "egl"),
        (Trial("llvmpipe (LLVM 15)", None), "tiny"),  # software: slower than TinyRenderer
        (Trial("NVIDIA RTX A2000", "a plane comes out wrong by 3 mm"), "tiny"),
        (Trial("", "the EGL renderer ended with code -11"), "tiny"),
    ):
        monkeypatch.setattr(rendering, "try_egl", lambda trial=trial: trial)
        choice = choose_renderer()
        assert choice.name == name
        assert (trial.problem or trial.device) in choice.reason
    monkeypatch.setattr(rendering, "try_egl", lambda: Trial("NVIDIA RTX A2000", None))
    assert choose_renderer("auto", (1920, 1440)).name == "tiny"  # more than the plugin draws


def test_the_environment_and_the_configuration_may_force_a_renderer(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(rendering, "try_egl", lambda: Trial("NVIDIA RTX A2000", None))
    monkeypatch.setenv(ENVIRONMENT, "egl")
    assert choose_renderer().name == "egl"
    assert choose_renderer("tiny").name == "tiny"
    monkeypatch.setenv(ENVIRONMENT, "tiny")
    assert choose_renderer().name == "tiny"
    assert choose_renderer("egl").name == "egl"
    monkeypatch.setenv(ENVIRONMENT, "vulkan")
    with pytest.raises(ValueError, match="auto, tiny, egl"):
        choose_renderer()


def test_asking_for_egl_where_it_does_not_work_says_why(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rendering, "try_egl", lambda: Trial("", "no driver"))
    with pytest.raises(RendererFailed, match="no driver"):
        choose_renderer("egl")
    with pytest.raises(RendererFailed, match="1920 x 1440"):
        choose_renderer("egl", (1920, 1440))


def test_a_renderer_that_dies_is_an_error_here_and_not_the_end(monkeypatch: pytest.MonkeyPatch):
    # A library that is not one: the child cannot even start its Python.
    monkeypatch.setattr("sim.camera.egl_process.sys.executable", "/bin/false")
    with pytest.raises(RendererFailed, match="ended with code 1"):
        EglScene()


def test_a_renderer_that_is_killed_between_pictures_is_an_error(egl: EglScene):
    scene = EglScene()
    scene._child.kill()
    with pytest.raises(RendererFailed, match="ended with code -9"):
        plane_error_m(scene)


def test_what_fails_in_the_child_is_told(egl: EglScene):
    scene = EglScene()
    with pytest.raises(RendererFailed, match="ValueError"):
        scene.draw([((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))], CameraConfig().shot(_nowhere()))
    assert scene._child.returncode is not None  # and the child is gone


def test_cards_are_looked_for_under_dev(tmp_path: Path):
    assert not has_card(tmp_path)
    (tmp_path / "dri").mkdir()
    (tmp_path / "dri" / "card0").touch()  # a display without a renderer
    assert not has_card(tmp_path)
    (tmp_path / "dri" / "renderD128").touch()
    assert has_card(tmp_path)


def test_a_scene_is_opened_by_the_renderer_that_was_chosen(no_wish: None):
    scene = open_scene(choose_renderer("tiny"))
    assert isinstance(scene, LocalScene)
    scene.close()


def _nowhere():
    import gtsam

    return gtsam.Pose3()
