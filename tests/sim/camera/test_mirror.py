from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np

from sim.bullet import load_urdf, p, quiet
from sim.camera.camera import CameraConfig
from sim.camera.mirror import LocalScene, bodies_of, poses_of, shapes_of
from sim.camera.pictures import take
from sim.camera.views import look_at

LAMP = """<robot name="lamp">
<link name="foot"><inertial><origin xyz="0.1 -0.2 0.3" rpy="0.4 0 0.2"/><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><origin xyz="0.05 0.1 -0.1" rpy="0.3 0.2 0.1"/>
<geometry><box size="0.3 0.2 0.1"/></geometry></visual></link>
<link name="arm"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><origin xyz="0.1 0 0.2" rpy="0 0.5 0"/>
<geometry><cylinder radius="0.05" length="0.4"/></geometry></visual>
<visual><origin xyz="-0.1 0 0.3"/><geometry><sphere radius="0.08"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="foot"/><child link="arm"/>
<origin xyz="0 0.1 0.1" rpy="0.2 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_a_mirrored_body_looks_as_it_does_in_its_own_world(tmp_path: Path):
    """Also where its shapes and its centre of mass are off its links' frames."""
    urdf = tmp_path / "lamp.urdf"
    urdf.write_text(LAMP, encoding="utf-8")
    with quiet():
        client = p.connect(p.DIRECT)
    body = load_urdf(client, urdf, gtsam.Pose3(gtsam.Rot3.Rz(0.7), np.array([1.2, 0.1, 0.2])))
    p.resetJointState(body, 0, 0.6, physicsClientId=client)
    shot = CameraConfig().scaled(0.5).shot(look_at(np.zeros(3), np.array([1.2, 0.1, 0.3])))
    there = take(client, shot)
    shapes = shapes_of(client, bodies_of(client))
    scene = LocalScene()
    scene.show(shapes)
    here = scene.draw(poses_of(client, shapes), shot)
    scene.close()
    p.disconnect(client)
    assert sorted(np.unique(here.body)) == [-1, 0, 1, 2]  # each shape is in the picture
    assert (np.isfinite(here.depth_m) == np.isfinite(there.depth_m)).mean() > 0.999
    assert np.nanpercentile(np.abs(here.depth_m - there.depth_m), 99) < 1e-4
