import numpy as np
import pytest

from akm_fg.report.overlay import OverlayConfig, draw_frame

SCALE = 3  # 320 px wide frames reach 960


def _magenta(image: np.ndarray) -> np.ndarray:
    r, g, b = (image[..., i].astype(int) for i in range(3))
    return (r - g > 60) & (b - g > 30)


def test_pixels_change_where_the_hinge_axis_projects(scenes):
    frame = scenes.recording("revolute", scenes.states("revolute")).frames[0]
    plain = draw_frame(frame, 0, None, None)
    drawn = draw_frame(frame, 0, None, scenes.joint("revolute"))
    assert drawn.shape == (240 * SCALE, 320 * SCALE, 3)
    for height in (-0.3, -0.1, 0.15, 0.3):
        u, v = scenes.project(scenes.hinge + np.array([[0.003, -0.002, height]]))[0]
        row, column = round((v + 0.5) * SCALE - 0.5), round((u + 0.5) * SCALE - 0.5)
        patch = slice(row - 3, row + 4), slice(column - 9, column + 10)
        assert _magenta(drawn[patch]).any() and not _magenta(plain[patch]).any()
    changed = (drawn != plain).any(axis=2)
    assert 0.001 < changed.mean() < 0.05
    assert not changed[:, : 100 * SCALE].any()


def test_a_vaguer_axis_is_drawn_wider(scenes):
    frame = scenes.recording("revolute", scenes.states("revolute")).frames[0]
    sharp, vague = (
        draw_frame(frame, 0, None, scenes.joint("revolute", axis_sd=sd)) for sd in (0.002, 0.1)
    )
    plain = draw_frame(frame, 0, None, None)
    areas = [(image != plain).any(axis=2).sum() for image in (sharp, vague)]
    assert areas[1] > 3 * areas[0]


def test_the_frame_itself_is_left_alone(scenes):
    frame = scenes.recording("prismatic", scenes.states("prismatic")).frames[0]
    before = frame.rgb.copy()
    draw_frame(frame, 0, scenes.tracks("prismatic", scenes.states("prismatic")), None)
    np.testing.assert_array_equal(frame.rgb, before)


def test_each_part_has_its_colour_at_its_points(scenes):
    config = OverlayConfig()
    states = scenes.states("revolute")
    frame, tracks = (
        scenes.recording("revolute", states).frames[0],
        scenes.tracks("revolute", states),
    )
    image = draw_frame(frame, 0, tracks, None)
    rejected = ~(tracks.moving | tracks.static)
    groups = (
        (tracks.moving, config.moving),
        (tracks.static, config.static),
        (rejected, config.rejected),
    )
    for members, colour in groups:
        at = (tracks.pixels.uv[0, members] + 0.5) * SCALE - 0.5
        found = image[np.rint(at[:, 1]).astype(int), np.rint(at[:, 0]).astype(int)]
        assert (np.abs(found.astype(int) - colour).max(axis=1) < 40).mean() > 0.8


def test_tails_show_where_points_came_from(scenes):
    states = scenes.states("prismatic")
    frames, tracks = (
        scenes.recording("prismatic", states).frames,
        scenes.tracks("prismatic", states),
    )
    long = draw_frame(frames[8], 8, tracks, None, config=OverlayConfig(tail_frames=8))
    short = draw_frame(frames[8], 8, tracks, None, config=OverlayConfig(tail_frames=0))
    assert (long != short).any(axis=2).sum() > 500


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_unknown_states_and_lost_tracks_can_be_drawn(scenes, kind):
    states = scenes.states(kind)
    frame, tracks = scenes.recording(kind, states).frames[0], scenes.tracks(kind, states)
    image = draw_frame(frame, 6, tracks, scenes.joint(kind), float("nan"), scenes.truth(kind))
    assert _magenta(image).any()
    draw_frame(frame, 99, tracks, scenes.joint(kind), 0.0, scenes.truth("rigid"))


def test_an_axis_outside_the_picture_changes_nothing(scenes):
    frame = scenes.recording("revolute", scenes.states("revolute")).frames[0]
    joint = scenes.joint("revolute")
    joint.T_world_joint[:3, 3] = [-5.0, 0, 0]  # behind the camera
    np.testing.assert_array_equal(
        draw_frame(frame, 0, None, joint), draw_frame(frame, 0, None, None)
    )


def test_a_magnified_band_is_wider_says_so_and_leaves_the_axis_where_it_is(scenes):
    frame = scenes.recording("revolute", scenes.states("revolute")).frames[0]
    plain, true, wide = (
        draw_frame(frame, 0, None, scenes.joint("revolute", 1e-4, 1e-4), magnification=m)
        if m
        else draw_frame(frame, 0, None, None)
        for m in (0, 1, 200)
    )
    corner = slice(-20, None), slice(0, 200)
    assert (wide[corner] != plain[corner]).any() and (true[corner] == plain[corner]).all()
    above = slice(0, -30)  # the words are below
    changed = [(image[above] != plain[above]).any(axis=2) for image in (true, wide)]
    assert changed[1].sum() > 2 * changed[0].sum()
    u, v = (scenes.project(scenes.hinge + np.array([[0.003, -0.002, 0.0]]))[0] + 0.5) * SCALE - 0.5
    for image in changed:  # where the pivot is, the axis leaves the row in its middle
        columns = np.flatnonzero(image[round(v)])
        np.testing.assert_allclose((columns[0] + columns[-1]) / 2, u, atol=2)
