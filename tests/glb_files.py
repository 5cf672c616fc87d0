"""A second reading of GLB files, by pygltflib and NumPy, to hold against what was written; the Khronos validator."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GLTF2 = pytest.importorskip("pygltflib", reason="pygltflib is not installed").GLTF2

TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
VALIDATE = """
const validator = require('gltf-validator');
const data = new Uint8Array(require('fs').readFileSync(process.argv[1]));
validator.validateBytes(data).then((report) => console.log(JSON.stringify(report.issues)));
"""


class Glb:
    """A file, and its nodes posed at each key of its one animation; positions come back with Z up."""

    def __init__(self, path: Path) -> None:
        self.gltf = GLTF2().load(str(path))
        self.animation = self.gltf.animations[0]
        inputs = {sampler.input for sampler in self.animation.samplers}
        assert len(inputs) == 1, "one clock for all channels"
        self.times = self.array(inputs.pop())

    def array(self, index: int) -> np.ndarray:
        accessor = self.gltf.accessors[index]
        view = self.gltf.bufferViews[accessor.bufferView]
        count = accessor.count * WIDTHS[accessor.type]
        values = np.frombuffer(self.gltf.binary_blob(), TYPES[accessor.componentType], count, view.byteOffset)
        values = values.reshape(accessor.count, -1) if accessor.type != "SCALAR" else values
        return values / np.float64(np.iinfo(values.dtype).max) if accessor.normalized else values

    def node(self, name: str) -> int:
        return next(i for i, node in enumerate(self.gltf.nodes) if node.name == name)

    def keys(self, node: int, path: str) -> np.ndarray | None:
        """What the animation sets there, one row a key."""
        for channel in self.animation.channels:
            if (channel.target.node, channel.target.path) == (node, path):
                return self.array(self.animation.samplers[channel.sampler].output).astype(np.float64)
        return None

    def local(self, node: int, key: int) -> np.ndarray:
        matrix = np.eye(4)
        turns, places = self.keys(node, "rotation"), self.keys(node, "translation")
        turn = self.gltf.nodes[node].rotation if turns is None else turns[key]
        place = self.gltf.nodes[node].translation if places is None else places[key]
        matrix[:3, :3] = np.eye(3) if turn is None else Rotation.from_quat(turn).as_matrix()
        matrix[:3, 3] = 0 if place is None else place
        return matrix

    def world(self, key: int) -> dict[int, np.ndarray]:
        found = {}

        def walk(node: int, above: np.ndarray) -> None:
            found[node] = above @ self.local(node, key)
            for child in self.gltf.nodes[node].children:
                walk(child, found[node])

        for root in self.gltf.scenes[0].nodes:
            walk(root, np.eye(4))
        return found

    def primitive(self, name: str):
        return self.gltf.meshes[self.gltf.nodes[self.node(name)].mesh].primitives[0]

    def faces(self, name: str) -> np.ndarray:
        return self.array(self.primitive(name).indices).reshape(-1, 3).astype(int)

    def colours(self, name: str) -> np.ndarray:
        """Linear RGB."""
        return self.array(self.primitive(name).attributes.COLOR_0)[:, :3]

    def joints(self, key: int) -> np.ndarray:
        world = self.world(key)
        return np.array([world[joint][:3, 3] for joint in self.gltf.skins[0].joints]) @ Z_UP.T

    def vertices(self, name: str, key: int) -> np.ndarray:
        """A mesh at a key, skinned or morphed and placed."""
        node, primitive = self.node(name), self.primitive(name)
        points = self.array(primitive.attributes.POSITION).astype(np.float64)
        world = self.world(key)
        if self.gltf.nodes[node].skin is not None:
            skin = self.gltf.skins[self.gltf.nodes[node].skin]
            inverse = self.array(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
            palette = np.stack([world[joint] @ bind for joint, bind in zip(skin.joints, inverse, strict=True)])
            joints = self.array(primitive.attributes.JOINTS_0).astype(int)
            weights = self.array(primitive.attributes.WEIGHTS_0)
            matrices = np.einsum("vk,vkij->vij", weights, palette[joints])
        else:
            weights = self.keys(node, "weights")
            if weights is not None:
                shares = weights.reshape(len(self.times), -1)[key]
                points = points + sum(
                    share * self.array(target["POSITION"] if isinstance(target, dict) else target.POSITION)
                    for share, target in zip(shares, primitive.targets, strict=True)
                )
            matrices = np.broadcast_to(world[node], (len(points), 4, 4))
        return (np.einsum("vij,vj->vi", matrices[:, :3, :3], points) + matrices[:, :3, 3]) @ Z_UP.T


def validate(path: Path) -> dict:
    """What the Khronos validator says; skips where it is not installed.

    `npm install gltf-validator` in the project's root, or anywhere that NODE_PATH names.
    """
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    root = Path(__file__).parents[1]
    done = subprocess.run([node, "-e", VALIDATE, str(path)], cwd=root, capture_output=True, text=True, timeout=60)
    if "Cannot find module 'gltf-validator'" in done.stderr:
        pytest.skip("npm's gltf-validator is not installed")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
