"""Frame by frame is all at once: what was seen is never taken back, and asking changes nothing."""

from dataclasses import replace

import numpy as np
import pytest

from akm_fg.errors import TracksLost
from akm_fg.perception.kept_frames import KeptFramesConfig
from akm_fg.perception.observe import MotionObserver, ObserveConfig, observe_motion
from akm_fg.perception.tracking.seeding import SeedingConfig, SeedingSchedule
from akm_fg.records import Recording


def watched(clip, frames: slice, **options) -> MotionObserver:
    observer = MotionObserver(**options)
    for frame in clip.frames[frames]:
        observer.watch(frame)
    return observer


def assert_equal(a, b) -> None:
    np.testing.assert_array_equal(a.tracks.p_world, b.tracks.p_world)
    np.testing.assert_array_equal(a.tracks.cov_world, b.tracks.cov_world)
    np.testing.assert_array_equal(a.pixels.uv, b.pixels.uv)
    np.testing.assert_array_equal(a.segmentation.moving, b.segmentation.moving)
    np.testing.assert_array_equal(a.segmentation.static, b.segmentation.static)


def test_frame_by_frame_is_what_the_recording_gives(drawer) -> None:
    assert_equal(watched(drawer, slice(None)).observed(), observe_motion(drawer.recording))


def test_asking_on_the_way_changes_nothing(drawer) -> None:
    observer = MotionObserver()
    for t, frame in enumerate(drawer.frames[:10]):
        observer.watch(frame)
        if t in (3, 6):
            short = Recording("short", drawer.frames[: t + 1])
            assert_equal(observer.observed(), observe_motion(short))
    assert_equal(observer.observed(), watched(drawer, slice(10)).observed())


def test_a_later_frame_changes_no_earlier_track(door_behind_robot) -> None:
    """Points set later are more tracks; the others stay, to the last digit."""
    short, whole = (watched(door_behind_robot, slice(n)).store for n in (7, 15))
    assert whole.points > short.points
    for t in range(7):
        np.testing.assert_array_equal(short[t].pixels.index, whole[t].pixels.index)
        np.testing.assert_array_equal(short[t].p_world, whole[t].p_world)
        np.testing.assert_array_equal(short[t].cov_world, whole[t].cov_world)


def test_what_moved_is_judged_by_few_frames_and_told_of_all_tracks(door) -> None:
    """Ten frames spread along the motion tell what fifteen tell."""
    few = replace(ObserveConfig(), kept=KeptFramesConfig(most=10))
    observer = watched(door, slice(None), config=few)
    numbers = observer.kept.numbers
    assert numbers[0] == 0 and numbers[-1] == 14 and len(numbers) == 10
    assert np.diff(numbers).max() <= 2
    observed, everything = observer.observed(), watched(door, slice(None)).observed()
    assert observed.tracks.p_world.shape == everything.tracks.p_world.shape
    decided = observed.segmentation.moving | observed.segmentation.static
    same = observed.segmentation.moving == everything.segmentation.moving
    assert decided.mean() > 0.85 and same[decided].mean() > 0.98
    some = observer.observed([2, 5])
    np.testing.assert_array_equal(some.tracks.p_world, observed.tracks.p_world[[2, 5]])


def test_frames_at_rest_do_not_crowd_out_the_motion(still, door) -> None:
    """Twelve frames closed, then the door opens: the places are the motion's."""
    few = replace(ObserveConfig(), kept=KeptFramesConfig(most=9))
    observer = watched(still, slice(None), config=few)
    for frame in door.frames:
        observer.watch(frame)
    assert (observer.kept.numbers > 12).sum() >= 6


def test_a_stream_begins_with_the_first_frame_that_shows_an_object(drawer) -> None:
    first = drawer.frames[0]
    dark = replace(first, depth_m=np.full_like(first.depth_m, np.nan))
    observer = MotionObserver()
    with pytest.raises(ValueError, match="no frame was watched"):
        observer.observed()
    with pytest.raises(TracksLost, match="no object"):
        observer.watch(dark)
    for frame in drawer.frames[:6]:
        observer.watch(frame)
    assert_equal(observer.observed(), observe_motion(Recording("short", drawer.frames[:6])))


def test_the_memory_of_tracking_is_that_of_the_living(door_behind_robot) -> None:
    """Two frames after they were lost, points are forgotten but for what was seen of them."""
    patient = ObserveConfig()
    config = replace(patient, tracker=replace(patient.tracker, max_coast=2))
    observer = watched(door_behind_robot, slice(None), config=config)
    coasting = observer._session._points.index.size
    last = [set(observer.store[t].pixels.index.tolist()) for t in (12, 13, 14)]
    assert coasting == len(set.union(*last)) < observer.store.points


def schedule(seen: list[int]) -> list[int]:
    """Frames in which points are set, where so many of the first hundred are still seen."""
    s, frames = SeedingSchedule(SeedingConfig()), []
    for t, n in enumerate(seen):
        if s.due(n):
            frames.append(t)
            s.seeded(100)
    return frames


def test_points_are_set_ever_more_seldom_unless_they_get_lost() -> None:
    steady = schedule([100] * 100)
    assert steady[:3] == [0, 5, 10] and len(steady) < 12
    assert (np.diff(np.diff(steady)) >= 0).all()
    lossy = schedule([100] * 60 + [50] * 10 + [100] * 30)
    assert [t for t in lossy if 60 <= t < 70] == [60, 65]
