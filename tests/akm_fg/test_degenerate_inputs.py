"""Inputs that leave equations singular or selections empty: an answer or one line, no traceback."""

import json
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from akm_fg.errors import AkmError
from akm_fg.estimation.fit import fit_poses, fit_tracks
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.pipeline import fit_input, fit_recording
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import PinholeCamera, PointTracks, PoseTrack, Recording

NO_DEPTH = np.float32(np.nan)


def _each(recording, change):
    frames = tuple(change(i, frame) for i, frame in enumerate(recording.frames))
    return replace(recording, frames=frames)


def _with_mask(recording, mask):
    return replace(recording, object_masks=(mask,) * len(recording.frames))


def _everywhere(recording):
    return _with_mask(recording, np.ones(recording.frames[0].depth_m.shape, dtype=bool))


def _cropped(side):
    def crop(_, frame):
        c, at = frame.camera, np.s_[110 : 110 + side, 150 : 150 + side]
        camera = PinholeCamera(side, side, c.fx, c.fy, c.cx - 150, c.cy - 110)
        rgb, depth_m = (np.ascontiguousarray(x[at]) for x in (frame.rgb, frame.depth_m))
        return replace(frame, rgb=rgb, depth_m=depth_m, camera=camera)

    return lambda recording: _everywhere(_each(recording, crop))


def _depth(change):
    return lambda recording: _each(
        recording, lambda i, f: replace(f, depth_m=change(i, f.depth_m).astype(np.float32))
    )


def _corner(_, depth_m):
    kept = np.full_like(depth_m, NO_DEPTH)
    kept[:20, :20] = depth_m[:20, :20]
    return kept


def _leaving(i, frame):
    if i < 8:
        return frame
    rgb, depth_m = frame.rgb.copy(), frame.depth_m.copy()
    rgb[:, 60:], depth_m[:, 60:] = 30, NO_DEPTH
    return replace(frame, rgb=rgb, depth_m=depth_m)


def _one_pixel(recording):
    mask = np.zeros(recording.frames[0].depth_m.shape, dtype=bool)
    mask[120, 160] = True
    return _with_mask(recording, mask)


HARD = {
    "equal depth": _depth(lambda _, d: np.ones_like(d)),
    "equal depth everywhere": lambda r: _everywhere(_depth(lambda _, d: np.ones_like(d))(r)),
    "no depth": lambda r: _everywhere(_depth(lambda _, d: np.full_like(d, NO_DEPTH))(r)),
    "depth of a corner": _depth(_corner),
    "depth of a corner everywhere": lambda r: _everywhere(_depth(_corner)(r)),
    "depth in every other frame": _depth(lambda i, d: d if i % 2 == 0 else d * NO_DEPTH),
    "depth in the first frame": _depth(lambda i, d: d if i == 0 else d * NO_DEPTH),
    "no depth in the first frame": lambda r: _everywhere(
        _depth(lambda i, d: d if i else d * NO_DEPTH)(r)
    ),
    "random depth": _depth(lambda i, d: np.random.default_rng(i).uniform(0.5, 2, d.shape)),
    "one colour": lambda r: _each(r, lambda _, f: replace(f, rgb=np.full_like(f.rgb, 128))),
    "random colours": lambda r: _each(
        r,
        lambda i, f: replace(
            f, rgb=np.random.default_rng(i).integers(0, 255, f.rgb.shape).astype(np.uint8)
        ),
    ),
    "one pixel": _one_pixel,
    "no pixel": lambda r: _with_mask(r, np.zeros(r.frames[0].depth_m.shape, dtype=bool)),
    "identical frames": lambda r: _each(r, lambda *_: r.frames[0]),
    "two frames": lambda r: replace(r, frames=(r.frames[0], r.frames[-1])),
    "one frame": lambda r: replace(r, frames=r.frames[:1]),
    "a part that leaves": lambda r: _each(r, _leaving),
    **{f"{side} x {side} pixels": _cropped(side) for side in (1, 8, 12, 40)},
}


def _clean(clip) -> Recording:
    depths = np.where(np.isfinite(clip.depth), clip.depth, np.nan)
    return _depth(lambda i, _: depths[i])(clip.recording)


def _said(fit) -> ArticulationPosterior | None:
    """The posterior, which must be finite where it says something; None where one line is said."""
    try:
        posterior = fit()
    except AkmError as error:
        assert "\n" not in str(error) and str(error)
        return None
    assert np.isfinite(list(posterior.kind_probability.values())).all()
    json.dumps(posterior_as_dict(posterior), allow_nan=False)
    return posterior


@pytest.fixture(scope="module")
def said_of(door, drawer):
    """What is said of a hard recording, once for all tests: said_of(name, kind)."""
    clips = {"revolute": door, "prismatic": drawer}

    @cache
    def said(hard, kind):
        return _said(lambda: fit_input(HARD[hard](clips[kind].recording), hard))

    return said


@pytest.mark.parametrize("hard", HARD)
def test_a_degenerate_recording_gets_an_answer_or_one_line(hard, kind, said_of):
    said_of(hard, kind)


def test_depth_without_noise_is_no_reason_to_fail(kind, door, drawer):
    clip = door if kind == "revolute" else drawer
    posterior = _said(lambda: fit_recording(_clean(clip)).posterior)
    assert posterior is not None and posterior.kind == kind


def test_frames_without_depth_have_no_state_and_the_others_do(kind, said_of):
    posterior = said_of("depth in every other frame", kind)
    assert posterior is not None and posterior.kind == kind
    assert np.isfinite(posterior.best.states.mean[::2]).all()


def _points(travel=0.5, frames=10):
    rng = np.random.default_rng(3)
    shape = rng.uniform(-0.2, 0.2, (20, 3))
    R = np.array([gtsam.Rot3.Rz(q).matrix() for q in np.linspace(0, travel, frames)])
    moved = (shape + np.array([0, 0.3, 0])) @ R.transpose(0, 2, 1)
    return moved + 1e-3 * rng.normal(size=moved.shape)


def _lost(keep):
    def change(p):
        out = np.full_like(p, np.nan)
        for t, n in keep:
            out[t, n] = p[t, n]
        return out

    return change


TRACKS = {
    "at the origin": np.zeros_like,
    "at rest": lambda p: np.repeat(p[:1], len(p), axis=0),
    "all at one place": lambda p: np.repeat(p[:, :1], p.shape[1], axis=1),
    "never in the same frame": _lost([(np.s_[::2], np.s_[:10]), (np.s_[1::2], np.s_[10:])]),
    "two frames each": _lost([(np.s_[t : t + 2], np.s_[2 * t : 2 * t + 2]) for t in range(9)]),
    "a kilometre away": lambda p: p + 1e3,
    "huge": lambda p: 1e6 * p,
    "tiny": lambda p: 1e-6 * p,
}


@pytest.mark.parametrize("sigma_m", [1e-3, 1e-9])
@pytest.mark.parametrize("hard", TRACKS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_degenerate_tracks_get_an_answer_or_one_line(hard, sigma_m):
    p = TRACKS[hard](_points())
    cov = np.broadcast_to(sigma_m**2 * np.eye(3), (*p.shape, 3))
    _said(lambda: fit_tracks(PointTracks(p, cov)))


PATHS = {
    "a point": np.zeros((10, 3)),
    "an exact line": np.linspace(0, 1, 10)[:, None] * np.array([1.0, 0, 0]),
    "an exact circle": np.stack(
        [np.cos(np.linspace(0, 1, 20)), np.sin(np.linspace(0, 1, 20)), np.zeros(20)], axis=1
    ),
    "two places": np.repeat([[0, 0, 0], [1.0, 0, 0]], 5, axis=0),
    "two rows": np.array([[0, 0, 0], [1.0, 0, 0]]),
}


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_degenerate_path_gets_an_answer_or_one_line(path, turned):
    p = PATHS[path]
    R = np.tile(np.eye(3), (len(p), 1, 1)) if turned else None
    _said(lambda: fit_poses(PoseTrack(p, R)))


def test_the_states_of_a_part_that_leaves_end_where_it_was_last_seen(kind, said_of, door, drawer):
    clip = door if kind == "revolute" else drawer
    posterior = said_of("a part that leaves", kind)
    assert posterior is not None and posterior.kind == kind
    states, last = posterior.best.states, 7
    assert states.last_seen == last and np.isnan(states.mean[last + 1 :]).all()
    assert abs(states.mean[last] - clip.states[last]) < 5 * states.sd[last]
    written = posterior_as_dict(posterior)["states"]
    assert written["last_seen_frame"] == last
    assert written["mean"][last + 1 :] == written["sd"][last + 1 :] == [None] * 7
