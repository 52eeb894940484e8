"""Frames that are only asked about now and then: the same answers, and prepared as they come."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.perception.surface import remembered_planes
from akm_fg.stream.answering_stream import AnsweringStream
from akm_fg.stream.frame_stream import FrameStream


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_it_answers_as_a_stream_that_thinks_on_every_frame(name, request):
    frames = request.getfixturevalue(name).frames
    streams = AnsweringStream("clip"), FrameStream("clip")
    for number, frame in enumerate(frames, 1):
        for stream in streams:
            stream.add(frame)
        if number in (len(frames) // 2, len(frames)):
            ours, theirs = (stream.posterior().posterior for stream in streams)
            assert ours.kind == theirs.kind
            a, b = ours.best, theirs.best
            assert a.joint is not None and b.joint is not None
            assert a.states is not None and b.states is not None
            sd = np.sqrt(np.diag(b.joint.cov))
            off = np.abs(a.joint.T_world_joint - b.joint.T_world_joint)
            assert off.max() < 0.1 * sd.max()
            assert_allclose(a.states.sd, b.states.sd, rtol=0.02)


def test_no_answer_fits_planes_to_a_frame_that_came_after_the_last_one(door, monkeypatch):
    frames = [replace(f, rgb=np.full_like(f.rgb, 120)) for f in door.frames]  # its surface leads
    fitted, fit = [], remembered_planes.depth_planes

    def counted(frame, *rest):
        fitted.append(frame.stamp_s)
        return fit(frame, *rest)

    monkeypatch.setattr(remembered_planes, "depth_planes", counted)
    stream, some = AnsweringStream("clip"), len(frames) - 3
    for frame in frames[:some]:
        stream.add(frame)
    stream.posterior()
    assert fitted
    fitted.clear()
    for frame in frames[some:]:
        stream.add(frame)
    later = [frame.stamp_s for frame in frames[some:]]
    assert fitted == later
    stream.posterior()
    assert fitted == later
