"""A run as glTF: the person skinned to 24 joints, the object moving, one animation.

glTF is Y up; (x, y, z) of the record is (x, z, -y) there, which Blender's importer turns back: its scene has the
record's coordinates. A frame of the record is a key of the animation at frame / fps.
"""

from pathlib import Path
from typing import Any

import numpy as np

from hoi.body.people import vertex_normals
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Array, Body, Motion, ObjectTrajectory, Run, SceneObject
from hoi.errors import InputError
from hoi.export.axes import Y_UP, linear
from hoi.export.gltf import INDICES, POINTS, TRIANGLES, VERTICES, Document
from hoi.export.person import local_turns, skinned_mesh
from hoi.export.surface import Faces
from hoi.export.thing import MovingMesh, moving_mesh, quaternions_xyzw, still_surface
from hoi.render.shown import scene_of

_FACTS = ("config_hash", "seed", "scene", "started")


def write_glb(run: Run, path: Path) -> None:
    """Write what the run shows as a .glb.

    Raises:
        InputError: as `hoi.render.shown.scene_of`, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    scene, motion, trajectory = scene_of(run), run.state.motion, run.state.trajectory
    document = Document(copyright=f"person: {scene.body.source}" if scene.body.source else "see the record")
    frames = len(motion) if motion is not None else len(trajectory.positions) if trajectory is not None else 0
    times = document.array(np.arange(frames) / scene.fps, bounds=True)
    animation = _Animation(document, times)
    roots = []
    if motion is not None:
        roots += _person(document, animation, scene.body, motion)
    if trajectory is not None:
        roots.append(_thing(document, animation, scene.thing, trajectory))
    document.add("animations", name=scene.name, channels=animation.channels, samplers=animation.samplers)
    facts = {name: run.provenance[name] for name in _FACTS if name in run.provenance}
    document.write(path, roots, prompt=scene.motion_prompt, fps=scene.fps, frames=frames, **facts)


def write_collider(run: Run, path: Path) -> None:
    """Write the object's surface as one still mesh, where it is in frame 0: what a physics engine takes for a collider.

    Raises:
        InputError: the run has no object or no surface holds through its Gaussians, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    scene, trajectory = scene_of(run), run.state.trajectory
    if trajectory is None:
        raise InputError("the run has no object, which --collider needs")
    vertices, faces = still_surface(scene.thing, trajectory)
    if len(faces) == 0:
        raise InputError("the object's Gaussians are too few for a surface, which --collider needs")
    document = Document()
    grey = np.full((len(vertices), 3), 0.7)
    shape = _mesh(document, scene.thing.name, vertices @ Y_UP.T, faces, grey, {})
    node = document.add("nodes", name="collider", mesh=shape)
    document.write(path, [node], mass=float(scene.thing.masses.sum()), volume=float(scene.thing.volumes.sum()))


class _Animation:
    """Its channels, all with the same keys."""

    def __init__(self, document: Document, times: int) -> None:
        self._document, self._times = document, times
        self.channels: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []

    def move(self, node: int, what: str, values: Array) -> None:
        """Key `what` ("translation", "rotation", "weights") of a node at every frame."""
        output = self._document.array(values)
        self.samplers.append({"input": self._times, "output": output, "interpolation": "LINEAR"})
        self.channels.append({"sampler": len(self.samplers) - 1, "target": {"node": node, "path": what}})


def _person(document: Document, animation: _Animation, body: Body, motion: Motion) -> list[int]:
    """The roots of the scene that show the person: mesh and skeleton."""
    mesh = skinned_mesh(body)
    local = local_turns(motion)
    local[:, 0] = Y_UP @ local[:, 0]
    turns = quaternions_xyzw(local)
    root = motion.translation.astype(np.float64) @ Y_UP.T
    parents = np.array(PARENTS[1:])
    offsets = np.concatenate([root[:1], mesh.rest_joints[1:] - mesh.rest_joints[parents]])
    first, joints = document.count("nodes"), []
    for joint, name in enumerate(JOINT_NAMES):
        children = [first + child for child in range(JOINT_COUNT) if PARENTS[child] == joint]
        pose = {"translation": offsets[joint].tolist(), "rotation": turns[0, joint].tolist()}
        joints.append(document.add("nodes", name=name, **pose, children=children or None))
        animation.move(joints[joint], "rotation", turns[:, joint])
    animation.move(joints[0], "translation", root)
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    inverse_bind[:, :3, 3] = -mesh.rest_joints
    skin = document.add(
        "skins", name="smpl", joints=joints, skeleton=joints[0], inverseBindMatrices=document.array(inverse_bind)
    )
    skinning = {
        "JOINTS_0": document.array(mesh.joints, "u1", target=VERTICES),
        "WEIGHTS_0": document.array(_float_weights(mesh.weights), target=VERTICES),
    }
    shape = _mesh(document, body.name, mesh.vertices, mesh.faces, mesh.colours, skinning)
    return [document.add("nodes", name="person", mesh=shape, skin=skin), joints[0]]


def _thing(document: Document, animation: _Animation, thing: SceneObject, trajectory: ObjectTrajectory) -> int:
    """The root of the scene that shows the object."""
    mesh = moving_mesh(thing, trajectory)
    translation = mesh.translation @ Y_UP.T
    turns = quaternions_xyzw(Y_UP @ mesh.rotation @ Y_UP.T)
    shape = _mesh(document, thing.name, mesh.vertices @ Y_UP.T, mesh.faces, mesh.colours, {}, _targets(document, mesh))
    node = document.add("nodes", name="object", mesh=shape, translation=translation[0].tolist())
    animation.move(node, "translation", translation)
    animation.move(node, "rotation", turns)
    if mesh.offsets:
        keys = np.arange(len(translation))[:, None] == np.array(list(mesh.offsets))
        animation.move(node, "weights", keys.astype(np.float64).reshape(-1))
    return node


def _targets(document: Document, mesh: MovingMesh) -> list[dict[str, int]]:
    """A morph target for each frame in which the object has another shape."""
    targets = []
    normals = _normals(mesh.vertices, mesh.faces)
    for offsets in mesh.offsets.values():
        target = {"POSITION": document.array(offsets @ Y_UP.T, target=VERTICES, bounds=True)}
        if normals is not None:
            bent = _normals(mesh.vertices + offsets, mesh.faces)
            assert bent is not None
            target["NORMAL"] = document.array((bent - normals) @ Y_UP.T, target=VERTICES)
        targets.append(target)
    return targets


def _mesh(
    document: Document,
    name: str,
    vertices: Array,
    faces: Faces,
    colours: Array,
    skinning: dict[str, int],
    targets: list[dict[str, int]] | None = None,
) -> int:
    """A mesh of one primitive, triangles or points, with the colours of its vertices."""
    attributes = {"POSITION": document.array(vertices, target=VERTICES, bounds=True)}
    indices = None
    if (normals := _normals(vertices, faces)) is not None:
        attributes["NORMAL"] = document.array(normals, target=VERTICES)
        indices = document.array(faces.reshape(-1), "u4", target=INDICES)
    opaque = np.concatenate([linear(colours), np.ones((len(colours), 1))], axis=1)
    attributes["COLOR_0"] = document.array(np.rint(opaque * 65535), "u2", target=VERTICES, normalized=True)
    surface = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0.9}
    primitive = {
        "attributes": attributes | skinning,
        "indices": indices,
        "mode": POINTS if indices is None else TRIANGLES,
        "material": document.add("materials", name=name, pbrMetallicRoughness=surface),
        "targets": targets or None,
    }
    kept = {key: value for key, value in primitive.items() if value is not None}
    return document.add("meshes", name=name, primitives=[kept], weights=[0] * len(targets) if targets else None)


def _normals(vertices: Array, faces: Faces) -> Array | None:
    """Unit normals (V, 3); up where the faces around a vertex have none. None without faces."""
    if len(faces) == 0:
        return None
    normals = vertex_normals(vertices, faces)
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0, 1, 0)
    return normals


def _float_weights(weights: Array) -> Array:
    """Float32 rows that sum to 1 as nearly as float32 can."""
    rounded = weights.astype(np.float32)
    return rounded / rounded.sum(axis=1, keepdims=True)
