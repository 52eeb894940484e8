"""In which order the grasps of a contact are tried again."""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.exploration.explore import others_first
from akm_fg.exploration.records import Attempt, Contact, Exploration, Hypothesis

CONTACT = Contact(np.zeros(3), np.zeros(2), np.array([-1.0, 0.0, 0.0]), 0, 0.5)
HERE, ELSEWHERE = (Hypothesis(k, "outward", np.array([-1.0, 0.0, 0.0])) for k in (0, 1))


def grasp(turn_rad: float, x_m: float = 0.0) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.Rx(turn_rad), np.array([x_m, 0.0, 0.0]))


def lost(*grasps: gtsam.Pose3, hypothesis: Hypothesis = HERE) -> Exploration:
    attempts = [
        Attempt(hypothesis, CONTACT, 0.5, outcome="grasp_lost", T_world_grasp=T) for T in grasps
    ]
    return Exploration(attempts=attempts)


def test_the_best_comes_first_until_it_is_lost_and_then_what_is_least_like_it():
    best, turned = grasp(0.0), grasp(1.0)
    assert others_first([best, turned], lost(), HERE) == [best, turned]
    assert others_first([best, turned], lost(best), HERE) == [turned, best]
    assert others_first([best, turned], lost(best, hypothesis=ELSEWHERE), HERE) == [best, turned]


def test_what_was_lost_twice_is_not_tried_again_wherever_the_sampler_finds_it():
    best, turned, beside = grasp(0.0), grasp(1.0), grasp(0.0, 0.05)
    twice = lost(grasp(0.05, 0.01), grasp(-0.05, -0.01))
    assert others_first([best, turned, beside], twice, HERE) == [turned, beside]
    assert others_first([best], twice, HERE) == []
