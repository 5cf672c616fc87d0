"""A run as USD (.usdc): skinned person and moving object, Z up, metres, a time code a frame."""

# pyright: reportAttributeAccessIssue=false
# The types that usd-core brings do not know what its modules hold.

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.data import Array, Body, Motion, Run
from hoi.errors import InputError, RunError
from hoi.export.axes import linear
from hoi.export.person import local_turns, skinned_mesh
from hoi.export.surface import Faces
from hoi.export.thing import MovingMesh, moving_mesh, quaternions_xyzw
from hoi.files import whole_file
from hoi.render.shown import scene_of


def write_usd(run: Run, path: Path) -> None:
    """Write what the run shows as a .usdc.

    Raises:
        InputError: as `hoi.render.shown.scene_of`, usd-core is not installed, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError:
        raise InputError("--usd needs usd-core, which is not installed; pip install 'hoi[export]'") from None
    scene, motion, trajectory = scene_of(run), run.state.motion, run.state.trajectory
    stage: Any = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(scene.fps)
    stage.SetFramesPerSecond(scene.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(scene.frames - 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/scene").GetPrim())
    if motion is not None:
        _person(stage, scene.body, motion)
    if trajectory is not None:
        _thing(stage, moving_mesh(scene.thing, trajectory))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "scene.usdc"  # by its extension alone does the library know the format
        try:
            stage.GetRootLayer().Export(str(made))
        except Tf.ErrorException as error:
            raise RunError(f"cannot write {path}: {' '.join(str(error).split())}") from error
        with whole_file(path) as part:
            part.write_bytes(made.read_bytes())


def _person(stage: Any, body: Body, motion: Motion) -> None:
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    mesh = skinned_mesh(body)
    UsdSkel.Root.Define(stage, "/scene/person")
    paths: list[str] = []
    for name, parent in zip(JOINT_NAMES, PARENTS, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    bones = mesh.rest_joints - np.where(np.array(PARENTS)[:, None] < 0, 0, mesh.rest_joints[list(PARENTS)])
    skeleton: Any = UsdSkel.Skeleton.Define(stage, "/scene/person/skeleton")
    skeleton.CreateJointsAttr(paths)
    for create, places in (("Bind", mesh.rest_joints), ("Rest", bones)):
        matrices = [Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*place)) for place in places.tolist()]
        getattr(skeleton, f"Create{create}TransformsAttr")(matrices)

    turns = quaternions_xyzw(local_turns(motion))[..., [3, 0, 1, 2]]
    animation: Any = UsdSkel.Animation.Define(stage, "/scene/person/animation")
    animation.CreateJointsAttr(paths)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1)] * len(paths)))
    rotations, translations = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    for frame, root in enumerate(motion.translation):
        rotations.Set(Vt.QuatfArray([Gf.Quatf(*map(float, turn)) for turn in turns[frame]]), frame)
        translations.Set(_vectors(np.concatenate([root[None], bones[1:]])), frame)

    shape: Any = _shape(stage, "/scene/person/mesh", mesh.vertices, mesh.faces, mesh.colours)
    binding: Any = UsdSkel.BindingAPI.Apply(shape.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = mesh.joints.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray(mesh.joints.reshape(-1).tolist()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray(mesh.weights.reshape(-1).tolist()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    source: Any = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    source.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    UsdGeom.Boundable(shape).CreateExtentAttr(_vectors(np.stack([mesh.vertices.min(0), mesh.vertices.max(0)])))


def _thing(stage: Any, mesh: MovingMesh) -> None:
    from pxr import Gf

    shape: Any = _shape(stage, "/scene/object", mesh.vertices, mesh.faces, mesh.colours)
    place, turn, points = shape.AddTranslateOp(), shape.AddOrientOp(), shape.GetPointsAttr()
    turns = quaternions_xyzw(mesh.rotation)[:, [3, 0, 1, 2]]
    still = np.zeros_like(mesh.vertices)
    for frame in range(len(turns)):
        place.Set(Gf.Vec3d(*mesh.translation[frame].tolist()), frame)
        turn.Set(Gf.Quatf(*turns[frame].tolist()), frame)
        if mesh.offsets:
            points.Set(_vectors(mesh.vertices + mesh.offsets.get(frame, still)), frame)


def _shape(stage: Any, path: str, vertices: Array, faces: Faces, colours: Array) -> Any:
    """A mesh, or points where there are no faces."""
    from pxr import UsdGeom, Vt

    shape: Any = (UsdGeom.Mesh if len(faces) else UsdGeom.Points).Define(stage, path)
    shape.CreatePointsAttr(_vectors(vertices))
    shape.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(_vectors(linear(colours)))
    if len(faces):
        shape.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
        shape.CreateFaceVertexIndicesAttr(Vt.IntArray(faces.reshape(-1).tolist()))
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    else:
        shape.CreateWidthsAttr([0.01])
        shape.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    return shape


def _vectors(values: Array) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))
