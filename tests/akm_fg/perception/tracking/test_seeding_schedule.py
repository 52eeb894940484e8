"""When new points are set: as time goes on, or as points are lost."""

import pytest

from akm_fg.perception.tracking.seeding import SeedingConfig, SeedingSchedule

CONFIG = SeedingConfig(reseed_gap=5, reseed_growth=0.5, reseed_lost=0.2)


def frames_of_seeds(seen_in: dict[int, int], frames: int = 60) -> list[int]:
    """Frames in which points are set when 100 are seen, but where said otherwise."""
    schedule, result = SeedingSchedule(CONFIG), []
    for t in range(frames):
        if schedule.due(seen_in.get(t, 100)):
            result.append(t)
            schedule.seeded(100)
    return result


def test_where_nothing_is_lost_the_gaps_grow_by_half():
    """5 frames at least, then half of the number of frames so far."""
    assert frames_of_seeds({}) == [0, 5, 10, 15, 23, 35, 53]


@pytest.mark.parametrize(("seen", "due"), [(79, True), (81, False)])
def test_a_fifth_of_the_points_lost_calls_for_new_ones(seen: int, due: bool):
    """In frame 42, seven after the last: growth alone would wait until frame 53."""
    assert (42 in frames_of_seeds({42: seen})) is due


def test_however_many_are_lost_no_seeds_come_within_five_frames():
    assert frames_of_seeds(dict.fromkeys(range(36, 40), 0))[:7] == [0, 5, 10, 15, 23, 35, 53]
