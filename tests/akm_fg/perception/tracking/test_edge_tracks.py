"""A point on a straight edge is known across it and not along it, all the way into space."""

from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.interfaces import SeenPixels
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.tracking.affine_match import (
    AffineMatchConfig,
    cut_templates,
    gradient_noise,
    no_more_than,
    smooth,
)
from akm_fg.perception.tracking.clips import track_clip
from akm_fg.perception.tracking.dense_flow import DisFlow
from akm_fg.perception.tracking.flow_tracker import FlowTracker
from akm_fg.perception.tracking.lifting import lift
from akm_fg.perception.tracking.seeding import SeedingConfig, seed_points
from akm_fg.records import PinholeCamera, PixelTracks, RgbdFrame

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
EDGE_RAD = np.deg2rad(25.0)
ALONG = np.array([np.cos(EDGE_RAD), np.sin(EDGE_RAD)])
ACROSS = np.array([-ALONG[1], ALONG[0]])
STEP_PX = 1.2 * ALONG + 0.5 * ACROSS  # a frame
ON_EDGE, ON_SPOT = np.array([60.0, 50.0]), np.array([120.0, 30.0])
FRAMES, NOISE_GRAY = 9, 2.0


def _image(t: int, rng: np.random.Generator, stairs: bool) -> np.ndarray:
    """A plain panel with one straight edge and one textured spot, shifted t steps."""
    fine = 1 if stairs else 4  # samples a pixel, each way: one makes stairs of the edge
    at = (np.arange(160 * fine) + 0.5) / fine - 0.5, (np.arange(120 * fine) + 0.5) / fine - 0.5
    uv = np.stack(np.meshgrid(*at), axis=-1) - t * STEP_PX
    gray = np.where((uv - ON_EDGE) @ ACROSS > 0.0, 150.0, 110.0)
    texture = cv2.GaussianBlur(np.random.default_rng(5).normal(size=(240, 240)), (0, 0), 6.0)
    place = ((uv - ON_SPOT) * 4 + 120).astype(np.float32)
    spot = cv2.remap(texture, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    gray = gray + 40.0 * spot / texture.std()
    gray = cv2.resize(gray, (160, 120), interpolation=cv2.INTER_AREA)
    rgb = gray[..., None] + rng.normal(scale=NOISE_GRAY, size=(120, 160, 3))
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def _clip(stairs: bool, seed: int = 0) -> list[RgbdFrame]:
    rng = np.random.default_rng(seed)
    depth = np.ones((120, 160), np.float32)
    return [
        RgbdFrame(0.1 * t, _image(t, rng, stairs), depth, CAMERA, gtsam.Pose3())
        for t in range(FRAMES)
    ]


@pytest.fixture(scope="module", params=[False, True], ids=["smooth", "stairs"])
def followed(request: pytest.FixtureRequest) -> tuple[list[RgbdFrame], PixelTracks]:
    frames = _clip(request.param)
    along_edge = np.linspace(-12.0, 12.0, 7)[:, None] * ALONG
    spots = ON_SPOT + np.array([[-6.0, 0.0], [0.0, 0.0], [5.0, 4.0]])
    uv = np.rint(np.concatenate([ON_EDGE + along_edge, spots]))
    return frames, track_clip(FlowTracker(), frames, uv, [0] * len(uv))


def _errors(tracks: PixelTracks) -> np.ndarray:
    """(T, N, 2) pixels."""
    return tracks.uv - (tracks.uv[0] + np.arange(FRAMES)[:, None, None] * STEP_PX)


def test_along_an_edge_the_claim_is_as_large_as_the_slip(followed) -> None:
    _, tracks = followed
    e, cov = _errors(tracks)[1:, :7], tracks.cov_px2[1:, :7]
    seen = tracks.visible[1:, :7]
    assert seen[:3].all()
    slip, sd = (e @ ALONG)[seen], np.sqrt(cov[seen] @ ALONG @ ALONG)
    assert np.abs(slip).max() > 1.5  # there is something to be honest about
    assert np.sqrt(np.mean((slip / sd) ** 2)) < 1.5


def test_across_an_edge_points_are_found_to_a_fraction_of_a_pixel(followed) -> None:
    _, tracks = followed
    seen = tracks.visible[1:, :7]
    off = (_errors(tracks)[1:, :7] @ ACROSS)[seen]
    cov = tracks.cov_px2[1:, :7][seen]
    sd = np.sqrt(cov @ ACROSS @ ACROSS)
    assert np.abs(off).max() < 1.0
    assert np.sqrt(np.mean((off / sd) ** 2)) < 1.5
    assert np.median(sd) < 0.6
    assert (sd < 0.4 * np.sqrt(cov @ ALONG @ ALONG)).all()


def test_the_long_axis_lies_along_the_edge(followed) -> None:
    _, tracks = followed
    _, V = np.linalg.eigh(tracks.cov_px2[3, :7])
    assert np.degrees(np.arccos(np.abs(V[:, :, 1] @ ALONG))).max() < 8.0


def test_on_texture_both_directions_are_known(followed) -> None:
    _, tracks = followed
    assert tracks.visible[:, 7:].all()
    e, cov = _errors(tracks)[1:, 7:], tracks.cov_px2[1:, 7:]
    assert np.sqrt(np.linalg.eigvalsh(cov)).max() < 0.4
    nees = np.einsum("tni,tnij,tnj->tn", e, np.linalg.inv(cov), e)
    assert nees.mean() < 4.0  # chi-square with two degrees of freedom has 2


def test_a_lifted_edge_point_is_vague_along_the_edge_in_space(followed) -> None:
    frames, tracks = followed
    seen = SeenPixels(np.arange(7), tracks.uv[3, :7], tracks.cov_px2[3, :7])
    cov = lift(seen, frames[3], DepthNoiseModel()).cov_world
    along, across = np.append(ALONG, 0.0), np.append(ACROSS, 0.0)
    focal = 150.0  # the panel faces the camera, one metre away
    sd_px = np.sqrt(tracks.cov_px2[3, :7] @ ALONG @ ALONG)
    np.testing.assert_allclose(np.sqrt(cov @ along @ along), sd_px / focal, rtol=0.05)
    assert (np.sqrt(cov @ across @ across) < 0.4 * np.sqrt(cov @ along @ along)).all()


def _seen_on(stairs: bool) -> tuple[SeenPixels, SeenPixels]:
    """What the first and the fourth frame show of three points on the edge and one on the spot."""
    session, frames = FlowTracker().begin(), _clip(stairs)
    session.advance(frames[0])
    uv = np.rint(np.vstack([ON_EDGE + np.linspace(-8.0, 8.0, 3)[:, None] * ALONG, ON_SPOT]))
    first = session.follow(uv)
    for frame in frames[1:4]:
        last = session.advance(frame)
    return first, last


@pytest.mark.parametrize("stairs", [False, True], ids=["smooth", "stairs"])
def test_a_slip_along_an_edge_lasts_and_a_patch_that_is_found_brings_nothing(stairs: bool) -> None:
    first, last = _seen_on(stairs)
    assert first.lasting_px2 is not None and not first.lasting_px2.any()
    assert last.lasting_px2 is not None and last.index.tolist() == [0, 1, 2, 3]
    np.linalg.cholesky(last.cov_px2 - last.lasting_px2)  # it is a part of all that may be off
    share = last.lasting_px2 @ ALONG @ ALONG / (last.cov_px2 @ ALONG @ ALONG)
    assert (share[:3] > 0.8).all()
    assert np.linalg.eigvalsh(last.lasting_px2[3]).max() < 0.02  # a seventh of a pixel


def test_what_points_bring_is_known_of_all_or_of_none() -> None:
    one = np.ones((1, 2, 2))
    known, unknown = SeenPixels(np.arange(1), one[0, :1], one, one), SeenPixels.none()
    joined = unknown.joined(known)
    assert joined.lasting_px2 is not None
    np.testing.assert_array_equal(joined.lasting_px2, one)
    assert joined.joined(replace(known, lasting_px2=None)).lasting_px2 is None
    with pytest.raises(ValueError, match="1 points, but lasting_px2"):
        replace(known, lasting_px2=np.ones((2, 2, 2)))


def test_noise_alone_has_no_information_and_is_measured() -> None:
    rng, config = np.random.default_rng(1), AffineMatchConfig()
    noisy = np.rint(120 + rng.normal(scale=NOISE_GRAY, size=(2, 120, 160, 3))).astype(np.uint8)
    plain = [smooth(rgb, config) for rgb in noisy]
    measured = gradient_noise(*plain)
    true = float(np.std((plain[0][:, 2:] - plain[0][:, :-2]) / 2))
    assert measured == pytest.approx(true, rel=0.1)
    columns, rows = np.meshgrid(np.arange(20.0, 140, 20), np.arange(20.0, 100, 20))
    uv = np.stack([columns.ravel(), rows.ravel()], axis=-1)
    known = cut_templates(plain[0], uv, config, measured).information
    blind = cut_templates(plain[0], uv, config, 0.0).information
    sums = [np.trace(m, axis1=1, axis2=2).mean() for m in (known, blind)]
    assert sums[0] < 0.05 * sums[1]


def test_limited_information_is_the_smaller_in_every_direction() -> None:
    a, b = np.diag([4.0, 1.0])[None], np.diag([1.0, 9.0])[None]
    np.testing.assert_allclose(no_more_than(a, b), np.eye(2)[None], atol=1e-6)
    np.testing.assert_allclose(no_more_than(a, 10 * a), a, rtol=1e-6)
    edge = 5.0 * np.outer(ACROSS, ACROSS)[None]
    np.testing.assert_allclose(no_more_than(20 * np.eye(2)[None], edge), edge, atol=1e-6)


def test_reseeding_takes_no_flow_twice() -> None:
    frames, calls = _clip(stairs=False), []

    class Counted(DisFlow):
        def both(self, a, b):
            calls.append(1)
            return super().both(a, b)

    masks = {t: np.ones((120, 160), bool) for t in (0, 3, 5)}
    masks[0][:, 80:] = False  # the spot is left to later seeds
    session, rng, begun = FlowTracker(flow=Counted).begin(), np.random.default_rng(0), set()
    for t, frame in enumerate(frames):
        seen = session.advance(frame)
        new_uv = seed_points(frame, masks[t], rng, None, seen.uv) if t in masks else []
        if len(session.follow(np.reshape(new_uv, (-1, 2))).index):
            begun.add(t)
    assert len(calls) == FRAMES - 1
    assert begun >= {0, 3}


def test_a_point_that_may_have_slipped_too_far_is_lost(followed) -> None:
    _, tracks = followed
    limit = FlowTracker().config.max_slip_px
    assert tracks.visible[-1, :7].mean() < 0.3  # 10 px along the edge
    sd = np.sqrt(np.linalg.eigvalsh(tracks.cov_px2[tracks.visible])[:, 1])
    assert 2.0 < sd.max() < 1.02 * limit


def test_neighbouring_seeds_do_not_share_a_corner() -> None:
    frame = _clip(stairs=False)[0]
    config = SeedingConfig(number=300)
    uv = seed_points(frame, np.ones((120, 160), bool), np.random.default_rng(0), config)
    gaps = np.linalg.norm(uv[:, None] - uv[None], axis=-1) + 99 * np.eye(len(uv))
    assert len(uv) > 10
    assert gaps.min() > 2.5  # pixels; four cells that meet at a corner chose it four times


def test_a_covariance_of_another_shape_is_refused(followed) -> None:
    _, tracks = followed
    with pytest.raises(ValueError, match="cov_px2"):
        replace(tracks, cov_px2=tracks.cov_px2[..., 0])


def test_a_patch_of_an_edge_does_not_shrink_to_a_line() -> None:
    """Along its edge it fits at any length; long streams let it wander until none is left."""
    session = FlowTracker().begin()
    frames = _clip(stairs=False)
    session.advance(frames[0])
    session.follow(ON_EDGE[None].round())
    session._points.shape[0] = np.outer(ACROSS, ACROSS) + 0.05 * np.outer(ALONG, ALONG)
    assert len(session.advance(frames[1]).index) == 1
    assert np.linalg.svd(session._points.shape[0], compute_uv=False).min() > 0.5  # taken anew
