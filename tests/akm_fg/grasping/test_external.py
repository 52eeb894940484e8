"""Grasps by another program: what goes out, what comes back, and every way it can fail."""

import sys
from textwrap import dedent

import numpy as np
import pytest

from akm_fg.backends import grasps, registry
from akm_fg.config import AkmConfig, StageNames
from akm_fg.errors import InputError, MissingDependency
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter

OUT = np.array([-1.0, 0.0, 0.0])
GRASPS = """
    import json, sys
    import numpy as np
    asked = np.load(sys.argv[1], allow_pickle=False)
    assert asked["points_cam"].shape == asked["colours"].shape and asked["on_object"].any()
    off = np.linalg.norm(asked["points_cam"] - asked["contact_cam"], axis=1)
    assert off.min() < 0.01
    z = -asked["normal_cam"]
    y = np.cross(z, [0.3, 0.4, 0.5]); y /= np.linalg.norm(y)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([np.cross(y, z), y, z]), asked["contact_cam"]
    far = T.copy(); far[0, 3] += 1.0
    grasps = [{"T_cam_grasp": t.tolist(), "score": s, "width_m": 0.02}
              for t, s in ((T, 0.4), (T, 1.7), (far, 0.9))]
    json.dump({"grasps": grasps}, open(sys.argv[2], "w"))
"""


@pytest.fixture
def sample(tmp_path, make_chest):
    chest = make_chest()
    frame = chest.frame()
    mask = DepthObjectSegmenter().segment(frame)

    def run(script: str, **own):
        program = tmp_path / "program.py"
        program.write_text(dedent(script))
        own = {"command": [sys.executable, str(program)], **own}
        config = AkmConfig(stages=StageNames(own={"anygrasp": own}))
        sampler = registry.make(grasps, "anygrasp", config)
        return sampler.sample(frame, mask, chest.bars[1] + chest.bar_m / 2 * OUT, OUT)

    run.contact = chest.bars[1] + chest.bar_m / 2 * OUT
    return run


def test_its_grasps_come_back_in_the_world_the_best_first_and_none_far_away(sample):
    got = sample(GRASPS)
    assert [g.quality for g in got] == [1.0, 0.4]
    np.testing.assert_allclose(got[0].T_world_grasp.translation(), sample.contact, atol=1e-6)
    np.testing.assert_allclose(got[0].T_world_grasp.rotation().matrix()[:, 2], -OUT, atol=1e-6)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("import sys; sys.exit('no licence')", "no licence"),
        ("", "wrote no answer"),
        ("import sys; open(sys.argv[2], 'w').write('{')", "cannot be read"),
        ("import sys; open(sys.argv[2], 'w').write('[]')", "cannot be read"),
        (
            "import sys; open(sys.argv[2], 'w').write("
            '\'{"grasps": [{"T_cam_grasp": [[1]], "score": 1, "width_m": 0}]}\')',
            "no pose",
        ),
    ],
)
def test_a_program_that_fails_is_one_clear_line(sample, script, said):
    with pytest.raises(InputError, match=said) as caught:
        sample(script)
    assert "\n" not in str(caught.value)


def test_a_program_that_does_not_answer_is_given_up(sample):
    with pytest.raises(InputError, match=r"no answer in 0\.3 s"):
        sample("import time; time.sleep(30)", timeout_s=0.3)


def test_a_program_that_is_not_there_is_said(sample):
    with pytest.raises(MissingDependency, match="no-such-program"):
        sample("", command=["/no-such-program"])


def test_without_a_command_the_setting_is_named():
    with pytest.raises(MissingDependency, match=r"stages\.own\.anygrasp\.command"):
        registry.make(grasps, "anygrasp", AkmConfig())
