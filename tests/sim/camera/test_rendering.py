from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.camera.camera import CameraConfig
from sim.camera.egl_process import EglScene, RendererFailed
from sim.camera.mirror import LocalScene
from sim.camera.rendering import (
    ENVIRONMENT,
    EXACT_M,
    Machine,
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


def test_the_other_renderers_pixel_convention_would_be_wrong(egl: EglScene):
    tiny = LocalScene()
    assert plane_error_m(tiny, (640, 480), "egl") > 3.0 * EXACT_M
    assert plane_error_m(egl, (640, 480), "tiny") > 3.0 * EXACT_M
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


WORKS = Trial("NVIDIA RTX A2000", None)


def machine(trial: Trial = WORKS, card: bool = True) -> Machine:
    """One of which that is found out."""
    return Machine(lambda: card, lambda: trial)


def test_without_a_card_tiny_draws(no_wish: None):
    assert choose_renderer(machine=machine(card=False)).name == "tiny"


def test_egl_draws_where_a_card_is_and_its_trial_comes_out_right(no_wish: None):
    for trial, name in (
        (WORKS, "egl"),
        (Trial("llvmpipe (LLVM 15)", None), "tiny"),  # software: slower than TinyRenderer
        (Trial("NVIDIA RTX A2000", "a plane comes out wrong by 3 mm"), "tiny"),
        (Trial("", "the EGL renderer ended with code -11"), "tiny"),
    ):
        choice = choose_renderer(machine=machine(trial))
        assert choice.name == name
        assert (trial.problem or trial.device) in choice.reason
    large = (1920, 1440)  # more than the plugin draws
    assert choose_renderer("auto", large, machine()).name == "tiny"


def test_the_environment_and_the_configuration_may_force_a_renderer(
    monkeypatch: pytest.MonkeyPatch,
):
    here = machine()
    monkeypatch.setenv(ENVIRONMENT, "egl")
    assert choose_renderer(machine=here).name == "egl"
    assert choose_renderer("tiny", machine=here).name == "tiny"
    monkeypatch.setenv(ENVIRONMENT, "tiny")
    assert choose_renderer(machine=here).name == "tiny"
    assert choose_renderer("egl", machine=here).name == "egl"
    monkeypatch.setenv(ENVIRONMENT, "vulkan")
    with pytest.raises(ValueError, match="auto, tiny, egl"):
        choose_renderer(machine=here)


def test_asking_for_egl_where_it_does_not_work_says_why():
    here = machine(Trial("", "no driver"))
    with pytest.raises(RendererFailed, match="no driver"):
        choose_renderer("egl", machine=here)
    with pytest.raises(RendererFailed, match="1920 x 1440"):
        choose_renderer("egl", (1920, 1440), here)


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


class CountedScene(LocalScene):
    """Draws, and counts what it draws."""

    drawn = 0

    def draw(self, *given):
        self.drawn += 1
        return super().draw(*given)


def test_a_world_is_drawn_by_the_scene_that_is_handed_in():
    scene = CountedScene()
    camera = CameraConfig(renderer="egl").scaled(0.25)  # what the configuration says does not count
    with open_world("drawer", 0, "clean", camera_config=camera, scene=scene) as opened:
        before = scene.drawn
        opened.camera.exact()
        assert scene.drawn == before + 1
        assert opened.camera.renderer.name == "tiny"


def test_a_scene_is_opened_by_the_renderer_that_was_chosen(no_wish: None):
    scene = open_scene(choose_renderer("tiny"))
    assert isinstance(scene, LocalScene)
    scene.close()


def _nowhere():
    import gtsam

    return gtsam.Pose3()
