"""What Blender, three.js and hoi itself read of an exported run: the same joints and the same skin, to 0.1 mm."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from demo_run import make_run
from glb_files import Glb

from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_frames
from hoi.data import Run
from hoi.export.glb import write_glb
from hoi.export.motions import write_bvh, write_smpl
from hoi.importers.motions import read_motion

FRAMES = 6
NEAR = 1e-4
STRIDE = 97
"""Every so manieth vertex is compared."""
BLENDER = """
import bpy, json, sys
bvh, glb, frames, fps, stride = sys.argv[-5], sys.argv[-4], *map(int, sys.argv[-3:])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = fps
bpy.ops.import_anim.bvh(filepath=bvh, axis_forward="-Z", axis_up="Y", frame_start=1)
rig = bpy.context.object
bpy.ops.import_scene.gltf(filepath=glb)
mesh = next(each for each in bpy.data.objects if each.type == "MESH" and each.find_armature() is not None)
skeleton = mesh.find_armature()
place = lambda object, point: list(object.matrix_world @ point)
found = {"bvh": [], "glb": [], "skin": []}
for frame in range(frames):
    for name, armature, first in (("bvh", rig, 1), ("glb", skeleton, 0)):
        bpy.context.scene.frame_set(first + frame)
        found[name].append({bone.name: place(armature, bone.head) for bone in armature.pose.bones})
    moved = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found["skin"].append([place(moved, vertex.co) for vertex in list(moved.data.vertices)[::stride]])
print("FOUND" + json.dumps(found))
"""
THREE = """
const fs = require('fs'), { pathToFileURL } = require('url');
const loader = pathToFileURL(require.resolve('three/examples/jsm/loaders/GLTFLoader.js')).href;
const [file, frames, fps, stride] = [process.argv[1], ...process.argv.slice(2).map(Number)];
globalThis.self = globalThis;
(async () => {
  const { GLTFLoader } = await import(loader);
  const three = await import(new URL('../../../build/three.module.js', loader).href);
  const data = fs.readFileSync(file);
  const buffer = data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
  const gltf = await new GLTFLoader().parseAsync(buffer, '');
  let mesh;
  gltf.scene.traverse((each) => { if (each.isSkinnedMesh) mesh = each; });
  const mixer = new three.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(gltf.animations[0]);
  action.setLoop(three.LoopOnce); action.clampWhenFinished = true; action.play();
  const found = { glb: [], skin: [] }, point = new three.Vector3();
  for (let frame = 0; frame < frames; frame++) {
    mixer.setTime(frame / fps);
    gltf.scene.updateMatrixWorld(true);
    mesh.skeleton.update();
    found.glb.push(Object.fromEntries(mesh.skeleton.bones.map((bone) =>
      [bone.name, point.setFromMatrixPosition(bone.matrixWorld).toArray()])));
    const skin = [];
    for (let row = 0; row < mesh.geometry.attributes.position.count; row += stride)
      skin.push(mesh.getVertexPosition(row, point).applyMatrix4(mesh.matrixWorld).toArray());
    found.skin.push(skin);
  }
  console.log(JSON.stringify(found));
})();
"""


@pytest.fixture(scope="module")
def run() -> Run:
    """A person of the package who turns every joint."""
    made = make_run(frames=FRAMES, points=200, gaussians=300, particles=600, contact_frame=2.5)[0]
    motion, rng = made.state.motion, np.random.default_rng(3)
    assert made.scene is not None and motion is not None
    time = np.arange(FRAMES)[:, None, None] / 5
    pose = motion.body_pose + 0.4 * np.sin(time + rng.uniform(0, 6, (1, 23, 3))).astype(np.float32)
    scene = replace(made.scene, body=load_person("woman", 3000))
    return replace(made, scene=scene, state=replace(made.state, motion=replace(motion, body_pose=pose)))


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    write_bvh(run, folder / "motion.bvh")
    write_smpl(run, folder / "smpl.npz")
    write_glb(run, folder / "scene.glb")
    return folder


@pytest.fixture(scope="module")
def places(run) -> np.ndarray:
    return joint_frames(run.scene.body, run.state.motion)[1]


def of_frames(found: list[dict[str, list[float]]], to_z_up: np.ndarray) -> np.ndarray:
    return np.array([[frame[name] for name in JOINT_NAMES] for frame in found]) @ to_z_up.T


@pytest.mark.parametrize("name", ["motion.bvh", "smpl.npz"])
def test_hoi_reads_its_own_files(run, folder, places, name):
    """Up to where the motion begins and which way it faces there: a motion file's are its reader's to choose."""
    read, _ = read_motion(folder / name, run.scene.body, FRAMES, run.state.motion.fps)
    got = joint_frames(run.scene.body, read)[1]
    start, begin = got - got[0, 0], places - places[0, 0]
    first, second = start.reshape(-1, 3), begin.reshape(-1, 3)
    angle = np.arctan2((np.cross(first, second)[:, 2]).sum(), (first * second)[:, :2].sum())
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    np.testing.assert_allclose(start @ turn.T, begin, atol=NEAR)


def test_blender_shows_the_run(run, folder, places):
    """`pip install bpy` into any Python that HOI_BLENDER_PYTHON names, or blender itself."""
    files = [str(folder / "motion.bvh"), str(folder / "scene.glb"), str(FRAMES), "20", str(STRIDE)]
    (folder / "blender.py").write_text(BLENDER)
    python = os.environ.get("HOI_BLENDER_PYTHON") or (sys.executable if find_spec("bpy") else None)
    blender = shutil.which("blender")
    if python is None and blender is None:
        pytest.skip("neither bpy nor blender is installed")
    start = [python] if python else [blender, "--background", "--python-exit-code", "1", "--python"]
    command = [*start, str(folder / "blender.py"), *([] if python else ["--"]), *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": ""})
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.partition("FOUND")[2].splitlines()[0])
    np.testing.assert_allclose(of_frames(found["bvh"], np.eye(3)), places, atol=NEAR)
    np.testing.assert_allclose(of_frames(found["glb"], np.eye(3)), places, atol=NEAR)
    glb = Glb(folder / "scene.glb")
    for frame in range(FRAMES):
        np.testing.assert_allclose(found["skin"][frame], glb.vertices("person", frame)[::STRIDE], atol=NEAR)


def test_three_js_shows_the_run(run, folder, places):
    """`npm install three` in the project's root, or anywhere that NODE_PATH names."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    command = [node, "-e", THREE, str(folder / "scene.glb"), str(FRAMES), "20", str(STRIDE)]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=120)
    if "Cannot find module 'three" in done.stderr:
        pytest.skip("npm's three is not installed")
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(of_frames(found["glb"], z_up), places, atol=NEAR)
    glb = Glb(folder / "scene.glb")
    for frame in range(FRAMES):
        shown = np.array(found["skin"][frame]) @ z_up.T
        np.testing.assert_allclose(shown, glb.vertices("person", frame)[::STRIDE], atol=NEAR)
