"""The paper's models behind the Protocols: real architectures, tiny, from folders on this disk."""

from __future__ import annotations

import builtins
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.backends import features, segmenters, trackers
from akm_fg.backends.registry import make
from akm_fg.config import AkmConfig, StageNames
from akm_fg.errors import InputError, MissingDependency, TracksLost
from akm_fg.perception.tracking.clips import track_clip

from . import tiny_models

DIFT = {"side_px": 128, "draws": 2, "prompt": "a"}


def backend(package: object, name: str, **own: object):
    own = {key: str(value) if isinstance(value, Path) else value for key, value in own.items()}
    return make(package, name, AkmConfig(stages=StageNames(own={name: own})))


@pytest.fixture(scope="module")
def sam2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_models.sam2(tmp_path_factory.mktemp("sam2"))


@pytest.fixture(scope="module")
def dinov2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_models.dinov2(tmp_path_factory.mktemp("dinov2"))


@pytest.fixture(scope="module")
def diffusion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_models.diffusion(tmp_path_factory.mktemp("diffusion"))


@pytest.fixture
def cotracker(tmp_path: Path):
    clone, weights = tiny_models.cotracker(tmp_path / "clone")
    return lambda **own: backend(trackers, "cotracker3", clone=clone, checkpoint=weights, **own)


def scene() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
    mask = np.zeros((120, 160), dtype=bool)
    mask[20:90, 30:120] = True
    return rgb, mask


def check_features(dense, grid: tuple[int, int, int]) -> None:
    rgb, mask = scene()
    found = dense.describe(rgb, mask)
    assert found.features.shape == grid and np.isfinite(found.features).all()
    assert found.features.std() > 0
    np.testing.assert_array_equal(found.features, dense.describe(rgb, mask).features)
    corners = found.uv_first + found.step_px * (np.array([[0, 0], grid[1::-1]]) - 0.5)
    np.testing.assert_allclose(corners.mean(axis=0), [74.5, 54.5], atol=1e-6)
    np.testing.assert_allclose(corners[1] - corners[0], 1.1 * 90)
    with pytest.raises(ValueError, match="mask"):
        dense.describe(rgb, mask[1:])


def test_dinov2_gives_a_feature_a_patch_with_and_without_registers(dinov2, tmp_path) -> None:
    plain = backend(features, "dinov2", checkpoint=dinov2, cells=8)
    check_features(plain, (8, 8, 24))
    folder = tiny_models.dinov2(tmp_path, registers=True)
    other = backend(features, "dinov2", checkpoint=folder, cells=8)
    check_features(other, (8, 8, 24))
    made = [dense.describe(*scene()).made_by for dense in (plain, other)]
    assert made == ["dinov2-24/last/112", "dinov2_with_registers-24/last/112"]


def test_dift_gives_what_passes_the_second_upward_block(diffusion) -> None:
    dense = backend(features, "dift", checkpoint=diffusion, **DIFT)
    check_features(dense, (8, 8, 16))  # of latents of 16 x 16
    assert not dense._parts.unet.up_blocks[1]._forward_hooks
    other = backend(features, "dift", checkpoint=diffusion, **{**DIFT, "prompt": "b"})
    one, two = (d.describe(*scene()).features for d in (dense, other))
    assert not np.allclose(one, two)  # the prompt is heard
    again = backend(features, "dift", checkpoint=diffusion, **DIFT, seed=1)
    assert not np.allclose(one, again.describe(*scene()).features)


def test_dift_refuses_a_block_that_the_network_lacks(diffusion) -> None:
    with pytest.raises(InputError, match="has 4 upward blocks and 1000 steps"):
        backend(features, "dift", checkpoint=diffusion, block=4)


class Stub:
    """Answers as SAM 2 does, with the inside of the box that it is asked by."""

    def __init__(self, real: object, side: int = 128) -> None:
        self.config, self.side, self.grow = real.config, side, 0

    def __call__(self, pixel_values, input_boxes, multimask_output):
        import torch

        assert pixel_values.shape == (1, 3, self.side, self.side) and not multimask_output
        assert abs(float(pixel_values.mean())) < 3.0  # normalised
        assert input_boxes.shape == (1, 1, 4)
        u0, v0, u1, v1 = (input_boxes[0, 0] / 4).round().int().tolist()
        logits = -torch.ones(1, 1, 1, self.side // 4, self.side // 4)
        logits[..., v0 : v1 + self.grow, u0 : u1 + self.grow] = 1.0
        return type("Said", (), {"pred_masks": logits})()


class Rough:
    """Finds a given mask."""

    def __init__(self, mask: np.ndarray) -> None:
        self.mask = mask

    def segment(self, frame) -> np.ndarray:
        return self.mask


def test_sam2_runs_and_is_asked_by_the_box_of_what_depth_shows(sam2, door) -> None:
    segmenter = backend(segmenters, "sam2", checkpoint=sam2, least_overlap=0.0)
    frame = door.frames[0]
    mask = segmenter.segment(frame)
    assert mask.dtype == bool and mask.shape == frame.depth_m.shape
    rough = np.zeros_like(mask)
    rough[60:180, 80:240] = True
    asked = type(segmenter)(Stub(segmenter._model), Rough(rough), segmenter.config)
    found = asked.segment(frame)
    assert (found & rough).sum() / (found | rough).sum() > 0.85


def test_sam2_that_sees_something_else_finds_no_object(sam2, door) -> None:
    segmenter = backend(segmenters, "sam2", checkpoint=sam2)
    stub = Stub(segmenter._model)
    stub.grow = 90
    rough = np.zeros(door.frames[0].depth_m.shape, dtype=bool)
    rough[20:60, 20:60] = True
    with pytest.raises(TracksLost, match="SAM 2 agrees on only"):
        type(segmenter)(stub, Rough(rough), segmenter.config).segment(door.frames[0])


def test_cotracker_keeps_the_contract_of_trackers(cotracker, door) -> None:
    tracker = cotracker()
    uv = np.array([[100.0, 80], [120, 90], [140, 100], [110, 120]])
    starts = [0, 3, 0, 2]
    tracks = track_clip(tracker, door.frames[:6], uv, starts)
    np.testing.assert_array_equal(tracks.uv[starts, range(4)], uv)
    for i, start in enumerate(starts):
        assert not tracks.visible[:start, i].any() and tracks.visible[start, i]
    np.testing.assert_array_equal(tracks.visible, np.isfinite(tracks.uv).all(axis=-1))
    cov_px2 = tracks.cov_px2[tracks.visible]
    np.testing.assert_array_equal(cov_px2, np.broadcast_to(np.eye(2), cov_px2.shape))
    alone = track_clip(tracker, door.frames[:6], uv[:1], [0])
    np.testing.assert_allclose(tracks.uv[:, :1], alone.uv, atol=1e-3)
    assert track_clip(tracker, door.frames[:3], np.empty((0, 2)), []).visible.shape == (3, 0)


@pytest.mark.parametrize("uv", [[400.0, 1.0], [np.nan, 1.0]])
def test_cotracker_refuses_pixels_outside(cotracker, door, uv) -> None:
    session = cotracker().begin()
    with pytest.raises(ValueError, match="no frame yet"):
        session.follow(np.array([[1.0, 1.0]]))
    session.advance(door.frames[0])
    with pytest.raises(ValueError, match="outside the image, or is not finite"):
        session.follow(np.array([uv]))


def test_points_older_than_the_window_are_followed_on(cotracker, door) -> None:
    uv = np.array([[100.0, 80], [120, 90]])
    whole = track_clip(cotracker(), door.frames[:10], uv, [0, 1])
    short = cotracker(window=3)
    session = short.begin()
    for t, frame in enumerate(door.frames[:10]):
        seen = session.advance(frame)
        if t < 2:
            seen = seen.joined(session.follow(uv[[t]]))
        assert len(session.frames) < 3
        np.testing.assert_array_equal(seen.index, np.arange(min(t + 1, 2)))
        np.testing.assert_allclose(seen.uv, whole.uv[t][: len(seen.uv)], atol=0.5)


@pytest.mark.parametrize(
    ("package", "name", "setting"),
    [
        (features, "dinov2", "checkpoint"),
        (features, "dift", "checkpoint"),
        (segmenters, "sam2", "checkpoint"),
        (trackers, "cotracker3", "clone"),
    ],
)
def test_an_absent_checkpoint_is_said_in_a_line(tmp_path, package, name, setting) -> None:
    for module in ("torch", "transformers", "diffusers"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    with pytest.raises(InputError, match=rf"^stages.own.{name}.{setting}: is not given, and"):
        backend(package, name)
    with pytest.raises(InputError, match="gone: does not exist; expected "):
        backend(package, name, **{setting: tmp_path / "gone"})
    with pytest.raises(InputError, match=str(tmp_path)) as caught:
        backend(package, name, **{setting: tmp_path})
    assert "\n" not in str(caught.value)


def test_a_checkpoint_that_lacks_weights_or_is_another_model_is_refused(dinov2, tmp_path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    clone, weights = tiny_models.cotracker(tmp_path / "clone")
    torch.save({"other": torch.ones(1)}, weights)
    with pytest.raises(InputError, match="cannot be loaded"):
        backend(trackers, "cotracker3", clone=clone, checkpoint=weights)
    weights.write_bytes(b"no weights")
    with pytest.raises(InputError, match="cannot be loaded"):
        backend(trackers, "cotracker3", clone=clone, checkpoint=weights)
    with pytest.raises(InputError, match=r"lacks \d+ weights, such as \w+"):
        backend(segmenters, "sam2", checkpoint=dinov2)
    folder = tmp_path / "other"
    folder.mkdir()
    said = json.loads((dinov2 / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**said, "num_hidden_layers": 3}))
    (folder / "model.safetensors").write_bytes((dinov2 / "model.safetensors").read_bytes())
    with pytest.raises(InputError, match=r"lacks \d+ weights"):
        backend(features, "dinov2", checkpoint=folder)


@pytest.mark.parametrize(
    ("package", "name", "module"),
    [
        (features, "dinov2", "transformers"),
        (features, "dift", "diffusers"),
        (segmenters, "sam2", "transformers"),
        (trackers, "cotracker3", "torch"),
    ],
)
def test_an_absent_package_is_said_in_a_line(monkeypatch, package, name, module) -> None:
    real = builtins.__import__

    def without(what: str, *rest: object, **more: object) -> object:
        if what.partition(".")[0] == module:
            raise ModuleNotFoundError(f"No module named {what!r}", name=what)
        return real(what, *rest, **more)

    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingDependency, match=rf"{name} needs \w+, which .*; install ") as caught:
        backend(package, name)
    assert "\n" not in str(caught.value)


def test_settings_that_mean_nothing_are_refused() -> None:
    pytest.importorskip("transformers", reason="transformers is not installed")
    for package, name, own in (
        (features, "dinov2", {"cells": 0}),
        (segmenters, "sam2", {"least_overlap": 2.0}),
        (trackers, "cotracker3", {"window": 1}),
    ):
        with pytest.raises(InputError, match=rf"stages.own.{name}"):
            backend(package, name, **own)
    assert replace(StageNames(), segmenter="sam2").segmenter == "sam2"
