"""From remembered contacts to a new object (the paper's Eq. 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.exploration.analogy.contacts import ContactMemory
from akm_fg.exploration.analogy.front import front_axes, front_normal
from akm_fg.exploration.analogy.transfer import (
    TransferConfig,
    kind_prior,
    most_similar,
    transfer,
)

from .conftest import NORMAL, ColourFeatures, front


def told(memory: ContactMemory, seen, k: int = 2, **config: float):
    features = ColourFeatures().describe(seen.frame.rgb, seen.mask)
    return transfer(memory, features, seen.frame, seen.mask, k, TransferConfig(**config))


def test_the_best_place_is_the_handle_that_looks_like_a_remembered_one(memory) -> None:
    seen = front((100, 85))
    prior = told(memory, seen)
    assert np.abs(prior.best_uv - seen.uv).max() <= 6
    assert prior.score.max() == prior.score[tuple(prior.best_uv.astype(int)[::-1])] == 1.0
    assert [contact.family for contact in prior.memories] == ["chest", "desk"]


def test_similarity_is_the_mean_cosine_to_the_remembered_contacts(memory) -> None:
    seen = front((100, 85))
    features = ColourFeatures().describe(seen.frame.rgb, seen.mask)
    prior = transfer(memory, features, seen.frame, seen.mask, 2)
    for uv in ([100.0, 85.0], [60.0, 40.0], [90.0, 70.0]):
        here = features.at(np.array([uv]))[0]
        cosines = [
            here @ contact.feature / np.linalg.norm(here) / np.linalg.norm(contact.feature)
            for contact in prior.memories
        ]
        u, v = map(int, uv)
        np.testing.assert_allclose(prior.similarity[v, u], np.mean(cosines), atol=0.02)


def test_off_the_object_nothing_is_said(memory) -> None:
    seen = front((100, 85))
    prior = told(memory, seen)
    assert np.isnan(prior.similarity[~seen.mask]).all() and not prior.score[~seen.mask].any()
    assert np.isfinite(prior.similarity[seen.mask]).all()
    assert (prior.score[seen.mask] > 0).all()
    weights = prior.weights_at(np.array([prior.best_uv, [1.0, 1.0], [-5.0, 900.0]]))
    np.testing.assert_allclose(weights, [1.0, 0.0, 0.0])


def test_a_place_that_is_less_alike_by_the_temperature_weighs_a_third(memory) -> None:
    prior = told(memory, front((100, 85)), temperature=0.4)
    seen = np.isfinite(prior.similarity)
    below = np.nanmax(prior.similarity) - prior.similarity[seen]
    np.testing.assert_allclose(prior.score[seen], np.exp(-below / 0.4), rtol=1e-4)


def test_the_ways_to_pull_turn_with_the_front(memory) -> None:
    prior = told(memory, front((100, 85)), k=3)
    assert prior.directions_world is not None
    np.testing.assert_allclose(prior.weights, 1 / 3)
    np.testing.assert_allclose(prior.directions_world[0], NORMAL, atol=0.02)
    np.testing.assert_allclose(prior.directions_world[2], [-0.8, 0.6, 0.0], atol=0.02)
    turned = prior.directions_on(np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(turned[2], [-0.6, -0.8, 0.0], atol=1e-5)


def test_kinds_are_drawn_to_even_odds(memory) -> None:
    kinds = told(memory, front((100, 85)), trust_in_kinds=0.5).kinds
    assert kinds == {"prismatic": 0.75, "revolute": 0.25, "helical": 0.0}
    assert kind_prior(["revolute"], 0.0) == {"prismatic": 0.5, "revolute": 0.5, "helical": 0.0}
    default = told(memory, front((100, 85))).kinds
    assert sum(default.values()) == pytest.approx(1.0) and max(default.values()) < 0.9


def test_memories_are_asked_by_the_likeness_of_whole_objects(memory) -> None:
    green = front((100, 85), body=(60, 140, 60))
    descriptor = ColourFeatures().describe(green.frame.rgb, green.mask).descriptor
    assert most_similar(memory, descriptor, 1)[0].object_name == "toy/door"
    assert len(most_similar(memory, descriptor, 9)) == 3
    alone = memory.without_family("chest").without_family("desk")
    assert most_similar(alone, descriptor, 1)[0].object_name == "toy/door"


def test_a_memory_that_has_nothing_to_say_is_refused(memory) -> None:
    seen = front((100, 85))
    with pytest.raises(ValueError, match="0 memories"):
        told(ContactMemory("", ()), seen)
    with pytest.raises(ValueError, match="0 pixels"):
        features = ColourFeatures().describe(seen.frame.rgb, seen.mask)
        transfer(memory, features, seen.frame, np.zeros_like(seen.mask))
    with pytest.raises(ValueError, match="memory described by colours/20, object by other"):
        transfer(memory, replace(features, made_by="other"), seen.frame, seen.mask)


def test_the_front_is_the_face_and_not_the_handle() -> None:
    seen = front((80, 60))
    depth = seen.frame.depth_m.copy()
    _, u = np.mgrid[:120, :160]
    depth += 0.002 * (u - 80)  # the front turns away to the right
    handle = np.s_[56:65, 74:87]
    depth[handle] = 0.96 - 0.004 * (u[handle] - 80)
    frame = replace(seen.frame, depth_m=depth.astype(np.float32))
    normal = front_normal(frame, seen.mask, seen.uv)
    flat = depth[90, [50, 110]]
    a, b = (
        frame.camera.back_project(np.array([x, 90.0]), z)
        for x, z in zip((50, 110), flat, strict=True)
    )
    along = frame.T_world_cam.rotation().matrix() @ (b - a)
    assert normal is not None and abs(normal @ along / np.linalg.norm(along)) < 0.03
    assert normal[0] < 0 and abs(normal[2]) < 0.03
    blind = replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))
    assert front_normal(blind, seen.mask, seen.uv) is None


def test_axes_of_a_front_are_level_upright_and_right_handed() -> None:
    for out in ([-1.0, 0, 0], [-0.6, 0.7, 0.2], [0, 0, 1.0], [0.01, 0, 1.0]):
        R = front_axes(np.array(out))
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0) and R[:, 2] @ out > 0.9
    assert abs(front_axes(np.array([-0.6, 0.7, 0.2]))[2, 0]) < 1e-12
