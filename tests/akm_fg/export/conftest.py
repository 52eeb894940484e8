"""Small descriptions of the door and the drawer, made once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from akm_fg.export.config import ExportConfig
from akm_fg.export.describe import describe
from akm_fg.export.description import joint_of

SMALL = ExportConfig(frames=3, triangles=3000, collision_triangles=600, poisson_depth=7)


@pytest.fixture(scope="session")
def described(door, drawer, door_model, drawer_model):
    """Model, description and clip by kind; what is closed is not the state zero."""
    made = {}
    for kind, clip, model in (
        ("revolute", door, door_model),
        ("prismatic", drawer, drawer_model),
    ):
        description = describe(model, clip.recording, one_hull=True, config=SMALL)
        made[kind] = (model, description, clip)
    return made


@pytest.fixture(scope="session")
def several_described(two_part_model):
    """The description of the door and the drawer, from the model's points alone."""
    return describe(two_part_model, one_hull=True, config=SMALL)


@pytest.fixture(scope="session")
def with_joint_of(described):
    """Meshes of the door, and the joint of another model: with_joint_of(model)."""
    _, description, _ = described["revolute"]
    ((_, link),) = description.parts

    def of(model):
        return replace(description, parts=((joint_of(model.parts[0]), link),))

    return of


@pytest.fixture(scope="session")
def screw_model(door_model):
    """A door that rises by 5 cm a radian."""
    from factors.joint import Joint, JointKind

    part = door_model.parts[0]
    best = part.posterior.best
    joint = replace(best.joint, joint=Joint(JointKind.HELICAL, part.joint.T_world_joint, 0.05))
    posterior = replace(
        part.posterior,
        kind="helical",
        kind_probability={"helical": 1.0},
        alternatives={"helical": replace(best, joint=joint)},
    )
    return replace(door_model, parts=(replace(part, posterior=posterior),))
