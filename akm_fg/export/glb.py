"""Descriptions as one binary glTF file: coloured meshes, and the joint as an animation.

glTF has y up; the root node turns the world, whose z is taken to be up. The part's node lies at
the joint's origin, moves through its range and back, and says in its `extras` what the joint is.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from akm_fg.errors import MissingDependency
from akm_fg.export.description import Description, ExportedJoint, Link
from akm_fg.export.uncertainty import uncertainty_json
from akm_fg.model.records import ObjectModel
from akm_fg.records import FloatArray

_STEPS = 31  # of the animation, there and back
_SECONDS = 4.0
_ROOT = "world"
_Z_TO_Y = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # a quarter turn back about x, as (x, y, z, w)
_FLOAT = 5126  # glTF's number of a 32 bit float


def glb(description: Description, model: ObjectModel) -> bytes:
    """The file's bytes.

    Args:
        description: the object.
        model: that it is of; says how sure its joints are.

    Raises:
        MissingDependency: trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError as error:
        raise MissingDependency("GLB needs trimesh; install akm-fg[export]") from error
    scene = trimesh.Scene()
    links = [(description.static, np.zeros(3))]
    links += [(link, joint.origin_world) for joint, link in description.parts]
    for link, origin in links:
        place = np.eye(4)
        place[:3, 3] = origin
        scene.add_geometry(_coloured(trimesh, link), node_name=link.name, transform=place)
    said = json.loads(uncertainty_json(model, description))["joints"]

    def with_joints(tree: dict[str, Any]) -> None:
        number = {node.get("name"): i for i, node in enumerate(tree["nodes"])}
        (shown,) = tree["scenes"]
        tree["nodes"].append({"name": _ROOT, "rotation": _Z_TO_Y, "children": shown["nodes"]})
        shown["nodes"] = [len(tree["nodes"]) - 1]
        for (joint, link), extras in zip(description.parts, said, strict=True):
            node = tree["nodes"][number[link.name]]
            node.pop("matrix", None)  # what is animated has no matrix
            node["translation"] = joint.origin_world.tolist()
            node["extras"] = {"joint": extras}
            _animate(tree, number[link.name], joint)

    data = trimesh.exchange.gltf.export_glb(scene, tree_postprocessor=with_joints)
    return bytes(data)


def _coloured(trimesh: Any, link: Link) -> Any:
    mesh = link.visual
    return trimesh.Trimesh(mesh.points, mesh.triangles, vertex_colors=mesh.rgb, process=False)


def _animate(tree: dict[str, Any], node: int, joint: ExportedJoint) -> None:
    """Adds a movement from one end of the range to the other and back."""
    share = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, _STEPS))
    q = joint.lower + (joint.upper - joint.lower) * share
    angle = q if joint.kind.turns else np.zeros_like(q)
    way = q * joint.pitch_m_per_rad if joint.kind.turns else q
    half = angle[:, None] / 2
    rotation = np.hstack([np.sin(half) * joint.axis_world, np.cos(half)])
    translation = joint.origin_world + way[:, None] * joint.axis_world
    times = _accessor(tree, np.linspace(0, _SECONDS, _STEPS)[:, None], "SCALAR")
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for path, values, kind in (
        ("rotation", rotation, "VEC4"),
        ("translation", translation, "VEC3"),
    ):
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": times, "output": _accessor(tree, values, kind)})
    made = {"name": joint.name, "samplers": samplers, "channels": channels}
    tree.setdefault("animations", []).append(made)


def _accessor(tree: dict[str, Any], values: FloatArray, kind: str) -> int:
    """Adds numbers (N, k) in a buffer of their own; the number of their accessor."""
    data = values.astype("<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    tree["buffers"].append({"byteLength": len(data), "uri": uri})
    view = {"buffer": len(tree["buffers"]) - 1, "byteOffset": 0, "byteLength": len(data)}
    tree["bufferViews"].append(view)
    ends = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
    made = {"bufferView": len(tree["bufferViews"]) - 1, "componentType": _FLOAT, "type": kind}
    tree["accessors"].append({**made, "count": len(values), **ends})
    return len(tree["accessors"]) - 1
