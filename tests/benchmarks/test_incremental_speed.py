"""Timings of the incremental fit beside its alternative, a batch fit of all frames: `make bench`.

Every round is the frame after 300; which piece of work it has to do differs from frame to frame,
hence as many rounds as a comparison of kinds comes round in, and the median. Times are the process'
own on its one thread, so that other work on the machine does not count.
"""

import time
from itertools import count

import numpy as np
import pytest

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.stream.incremental import IncrementalFit
from experiments.trials.openings import make_opening

FRAMES, ROUNDS = 300, 60
pytestmark = pytest.mark.benchmark(timer=time.process_time)


@pytest.mark.parametrize("points", [40, 200])
def test_the_frame_after_three_hundred(benchmark, points):
    opening = make_opening(0, "revolute", points=points, frames=FRAMES + ROUNDS)
    fit = IncrementalFit()
    p, cov = opening.tracks.p_world, opening.tracks.cov_world
    for t in range(FRAMES):
        fit.add(p[t], cov[t])
    frame = count(FRAMES)

    def next_frame():
        t = next(frame)
        return (p[t], cov[t]), {}

    update = benchmark.pedantic(fit.add, setup=next_frame, rounds=ROUNDS)
    assert update.kind == "revolute"
    assert abs(update.state - opening.q[-1]) < 5 * update.state_sd
    assert benchmark.stats.stats.median < 0.02


@pytest.mark.parametrize("points", [40, 200])
def test_a_batch_fit_of_three_hundred_frames(benchmark, points):
    opening = make_opening(0, "revolute", points=points, frames=FRAMES)
    posterior = benchmark.pedantic(fit_tracks, args=(opening.tracks,), rounds=5)
    assert posterior.kind == "revolute"


@pytest.mark.parametrize("points", [40, 200])
def test_the_whole_posterior_after_three_hundred_frames(benchmark, points):
    """All kinds compared on the keyframes, for whoever will not wait for the next comparison."""
    opening = make_opening(0, "revolute", points=points, frames=FRAMES + 5)
    fit = IncrementalFit()
    p, cov = opening.tracks.p_world, opening.tracks.cov_world
    for t in range(FRAMES):
        fit.add(p[t], cov[t])
    frame = count(FRAMES)

    def one_more():
        t = next(frame)
        fit.add(p[t], cov[t])

    posterior = benchmark.pedantic(fit.posterior, setup=one_more, rounds=5)
    assert posterior.kind == "revolute"
    assert np.isfinite(posterior.best.states.sd).all()
