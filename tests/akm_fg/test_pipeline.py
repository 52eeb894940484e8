"""The whole way of a rendered recording: what tracks, surfaces and both say of its joint."""

from dataclasses import replace
from functools import partial
from unittest import mock

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.calibrated import calibrated
from akm_fg.errors import AxisUnobservable, NoMotionObserved, TracksLost
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.observe import observe_motion
from akm_fg.pipeline import fit_input, fit_recording
from akm_fg.records import CalibrationErrors, PointTracks
from akm_fg.stages import ModelSettings, Stages
from akm_fg.steps import to_end
from akm_fg.stream.joint_estimate import better_than_tracks, estimate_joint

SOURCES = ("tracks", "surface", "both")


@pytest.fixture
def fitted(door, fit_of):
    """Fits of the door's recording by source."""
    return partial(fit_of, door)


def _axis_line_off(posterior, door):
    """Angle of the axis from the true one, and the true axis line's distance from the pivot."""
    joint = posterior.best.joint
    across = (np.array(door.scene.hinge) - joint.pivot)[:2]  # the hinge is upright
    return np.arccos(min(abs(joint.axis[2]), 1.0)), np.hypot(*across)


@pytest.mark.parametrize("sources", SOURCES)
def test_a_recorded_door_is_a_door_within_its_deviations(sources, fitted, door):
    posterior = fitted(sources).posterior
    assert posterior.kind == "revolute"
    assert posterior.fit.parametric
    angle, distance = _axis_line_off(posterior, door)
    joint = posterior.best.joint
    assert angle < 4 * joint.axis_sd_rad and np.degrees(joint.axis_sd_rad) < 1.0
    assert distance < 4 * joint.pivot_sd_m and joint.pivot_sd_m < 0.006
    states = posterior.best.states
    seen = np.isfinite(states.mean) & (np.arange(door.states.size) > 0)
    assert seen.sum() >= 9
    assert joint.axis[2] < 0  # the door opens about world -z
    assert_allclose(states.mean[seen], door.states[seen], atol=0.02)


def test_both_are_at_least_as_sure_as_tracks(fitted):
    tracks, both = (fitted(s).posterior.best.joint for s in ("tracks", "both"))
    assert both.axis_sd_rad <= 1.001 * tracks.axis_sd_rad
    assert both.pivot_sd_m <= 1.001 * tracks.pivot_sd_m


def test_the_report_says_what_was_in_the_graph(fitted):
    tracks, surface, both = (fitted(s).posterior.fit for s in SOURCES)
    assert tracks.keyframes_registered == () and tracks.patches_used == 0
    assert tracks.patches_rms_m is None and tracks.patches_as_one is None
    assert len(both.keyframes_registered) == 5 and both.keyframes_registered[0] == 0
    assert both.tracks_used == tracks.tracks_used > 50
    assert surface.tracks_used == 0 and len(surface.keyframes_registered) > 5
    for fit in (surface, both):
        assert fit.patches_used > 500
        assert 1e-4 < fit.patches_rms_m < 3e-3
        assert fit.patches_as_one > 5  # the renderer's noise is shared by neighbouring pixels


def test_json_carries_the_report_on_the_surface(fitted):
    posterior = fitted("both").posterior
    fields = posterior_as_dict(posterior)["fit"]
    assert fields["keyframes_registered"] == list(posterior.fit.keyframes_registered)
    assert fields["patches_used"] == posterior.fit.patches_used
    assert fields["patches_rms_m"] == posterior.fit.patches_rms_m
    assert fields["patches_as_one"] == posterior.fit.patches_as_one


def test_times_add_up(fitted):
    times = fitted("tracks").posterior.time_s
    assert_allclose(times["perception"] + times["fit"], times["total"])
    assert min(times.values()) > 0


def test_a_recording_given_as_input_is_fitted_under_its_new_name(fitted, door):
    posterior = fit_input(door.recording, "somewhere/else")
    assert posterior.name == "somewhere/else"
    assert_allclose(
        posterior.best.joint.T_world_joint, fitted("both").posterior.best.joint.T_world_joint
    )


def _plain(recording):
    """The same without any texture, edge or shade: nothing to follow."""
    frames = (replace(f, rgb=np.full_like(f.rgb, 120)) for f in recording.frames)
    return replace(recording, frames=tuple(frames))


@pytest.mark.parametrize("sources", ["surface", "both"])
def test_a_wholly_plain_door_is_found_by_depth_alone(sources, door):
    found = fit_recording(_plain(door.recording), sources=sources)
    assert found.observed.tracks.p_world.shape[1] == 0
    joint = found.posterior.best.joint
    assert joint.kind.turns  # a plane that turns hardly tells whether it climbs as well
    assert found.posterior.kind in ("revolute", "undecided")
    angle, distance = _axis_line_off(found.posterior, door)
    assert angle < 4 * joint.axis_sd_rad and np.degrees(angle) < 3.0
    assert distance < 4 * joint.pivot_sd_m and distance < 0.02
    assert found.posterior.fit.tracks_used == 0


def test_without_anything_to_follow_tracks_alone_say_so(door, still):
    with pytest.raises(TracksLost, match=r"^clip: fewer than 3 of 0 tracks"):
        fit_recording(_plain(door.recording), sources="tracks")
    with pytest.raises(TracksLost, match="expected a part that moves"):
        fit_recording(_plain(still.recording))


def test_a_recording_in_which_nothing_moves_says_so_with_its_name(still):
    with pytest.raises(NoMotionObserved, match=r"^clip: .*expected a part that moves$"):
        fit_recording(still.recording)


def _with_false_tracks(observed):
    """Tracks of the body that creep by a centimetre instead of those of the part."""
    segmentation, p = observed.segmentation, observed.tracks.p_world.copy()
    body = np.flatnonzero(segmentation.static)[:12]
    creep = np.linspace(0.0, 0.01, len(p))[:, None, None]
    p[:, body] += creep * np.array([1.0, 0.0, 0.0])
    moving = np.zeros_like(segmentation.moving)
    moving[body] = True
    p[:, segmentation.moving] = np.nan  # nothing on the part could be followed
    return replace(
        observed,
        tracks=PointTracks(p, observed.tracks.cov_world),
        segmentation=replace(
            segmentation,
            moving=moving,
            static=segmentation.static & ~moving,
            rejected=np.zeros_like(moving),
        ),
    )


def test_tracks_that_explain_none_of_the_change_give_way_to_depth(door):
    observed = observe_motion(door.recording)
    found = estimate_joint(door.recording, _with_false_tracks(observed), ModelSettings())
    assert found.posterior.kind == "revolute"
    angle, distance = _axis_line_off(found.posterior, door)
    assert np.degrees(angle) < 3.0 and distance < 0.02
    body = np.flatnonzero(observed.segmentation.static)[:12]
    assert not found.observed.segmentation.moving[body].any()
    assert found.posterior.fit.keyframes_registered


def test_tracks_that_explain_the_change_are_kept(door):
    observed = observe_motion(door.recording)
    assert to_end(better_than_tracks(door.recording, observed, PerceptionConfig())) is None


def _in_another_world(recording, T_other_world):
    """The same frames where the world has other axes."""
    turned = (replace(f, T_world_cam=T_other_world * f.T_world_cam) for f in recording.frames)
    return replace(recording, frames=tuple(turned))


def _other_world(seed, clip):
    """A random world; for no seed, the camera's own axes: T_world_cam is the identity."""
    if seed is None:
        return clip.scene.T_world_cam.inverse()
    rng = np.random.default_rng(seed)
    return gtsam.Pose3(gtsam.Rot3.Expmap(rng.uniform(-np.pi, np.pi, 3)), rng.normal(size=3))


@pytest.mark.parametrize("seed", (None, 0, pytest.param(1, marks=pytest.mark.slow)))
@pytest.mark.parametrize("name", ("door", "drawer"))
def test_the_same_frames_give_the_same_joint_in_any_world(name, seed, request, fit_of):
    clip = request.getfixturevalue(name)
    level = fit_of(clip).posterior.best.joint
    T = _other_world(seed, clip)
    posterior = fit_recording(_in_another_world(clip.recording, T)).posterior
    joint = posterior.best.joint
    assert posterior.kind == level.kind
    axis = T.rotation().matrix().T @ joint.axis
    assert np.linalg.norm(axis - level.axis) < 0.1 * level.axis_sd_rad
    assert_allclose(joint.axis_sd_rad, level.axis_sd_rad, rtol=0.02)
    if level.pivot is not None:
        off = np.cross(T.transformTo(joint.pivot) - level.pivot, level.axis)
        assert np.linalg.norm(off) < 0.1 * level.pivot_sd_m


def test_a_singular_matrix_is_one_line_and_no_traceback(door):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    stages = Stages(estimator=singular)
    with pytest.raises(AxisUnobservable, match=r"the data leave a joint or state open \(Singular"):
        fit_recording(door.recording, stages=stages)


def test_a_part_that_is_not_on_what_was_taken_for_the_object_is_found(door):
    class Elsewhere:
        """Takes a piece of floor for the object."""

        def segment(self, frame):
            mask = np.zeros(frame.depth_m.shape, dtype=bool)
            mask[-30:, :60] = True
            return mask

    with mock.patch("akm_fg.perception.observe.DepthObjectSegmenter", lambda *_: Elsewhere()):
        assert fit_recording(door.recording).posterior.kind == "revolute"
    with pytest.raises((NoMotionObserved, TracksLost)):  # who says where it is, is believed
        fit_recording(door.recording, stages=Stages(segmenter=Elsewhere()))


def test_what_is_not_known_of_the_camera_is_in_the_posterior(fitted, door):
    """A millimetre and a tenth of a degree: in the covariance, and in nothing else."""
    errors = CalibrationErrors(np.diag([0.00175**2] * 3 + [1e-6] * 3))
    perfect = fitted("both").posterior
    posterior = fit_recording(replace(door.recording, calibration=errors)).posterior
    T_world_cam = door.recording.frames[0].T_world_cam
    camera = door.recording.frames[0].camera
    want = calibrated(perfect, errors, T_world_cam, camera).best.joint.cov
    assert_allclose(posterior.best.joint.cov, want, rtol=1e-9, atol=1e-15)
    assert posterior.best.joint.axis_sd_rad > 0.0017
    assert posterior.kind_probability == perfect.kind_probability
