"""A run over time as Gaussians, as USD's `ParticleField3DGaussianSplat` and Rerun's `GaussianSplats3D`.

Both hold the record's coordinates, Z up, in metres: linear scales, opacities and harmonics of the 3DGS basis, a time
sample a frame. Person and object are a field each; what does not change is written once.
"""

# pyright: reportAttributeAccessIssue=false
# The types that usd-core brings do not know what its modules hold.

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hoi.data import Array, GaussianCloud, Run
from hoi.errors import InputError, RunError
from hoi.export.clouds import moving_parts
from hoi.files import whole_file
from hoi.gaussians import colours, sh_degree
from hoi.render.shown import scene_of


def write_usd_splats(run: Run, path: Path) -> None:
    """Write what the run shows as a .usdc of Gaussians.

    Raises:
        InputError: as `hoi.render.shown.scene_of`, usd-core is missing or too old, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    try:
        from pxr import Tf, Usd, UsdGeom, UsdVol, Vt
    except ImportError:
        raise InputError("--usd-splats needs usd-core, which is not installed; pip install 'hoi[export]'") from None
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        have = ".".join(map(str, Usd.GetVersion()[1:]))
        raise InputError(f"--usd-splats needs usd-core 26.3 or newer, this is {have}; pip install -U usd-core")
    scene = scene_of(run)
    stage: Any = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(scene.fps)
    stage.SetFramesPerSecond(scene.fps)
    stage.SetStartTimeCode(0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/scene").GetPrim())

    def vectors(values: Array) -> Any:
        return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))

    frames = 0
    for name, clouds in moving_parts(run).items():
        field: Any = UsdVol.ParticleField3DGaussianSplat.Define(stage, f"/scene/{name}")
        written: dict[str, tuple[Array, int]] = {}
        for frame, cloud in enumerate(clouds):
            frames = max(frames, frame + 1)
            reach = 3 * cloud.scales.max(1, keepdims=True)
            extent = np.stack([(cloud.means - reach).min(0), (cloud.means + reach).max(0)])
            samples = {
                "Positions": (cloud.means, vectors),
                "Orientations": (cloud.quaternions[:, [1, 2, 3, 0]], _turns),
                "Scales": (cloud.scales, vectors),
                "Opacities": (cloud.opacities, lambda v: Vt.FloatArray.FromNumpy(np.ascontiguousarray(v, np.float32))),
                "RadianceSphericalHarmonicsCoefficients": (cloud.sh.reshape(-1, 3), vectors),
                "Extent": (extent, vectors),
                "DisplayColor": (np.clip(colours(cloud), 0, 1), vectors),
            }
            if frame == 0:
                field.CreateRadianceSphericalHarmonicsDegreeAttr(sh_degree(cloud))
            for name_of, (values, typed) in samples.items():
                attribute = getattr(field, f"Create{name_of}Attr")()
                old, since = written.get(name_of, (None, frame))
                if old is not None and np.array_equal(old, values):
                    continue
                if old is not None and since < frame - 1:
                    attribute.Set(typed(old), frame - 1)  # held until then: samples are interpolated
                attribute.Set(typed(values), frame)
                written[name_of] = values, frame
    stage.SetEndTimeCode(max(frames - 1, 0))
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "splats.usdc"  # by its extension alone does the library know the format
        try:
            stage.GetRootLayer().Export(str(whole))
        except Tf.ErrorException as error:
            raise RunError(f"cannot write {path}: {' '.join(str(error).split())}") from error
        with whole_file(path) as part:
            part.write_bytes(whole.read_bytes())


def _turns(xyzw: Array) -> Any:
    from pxr import Vt

    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(xyzw, np.float32))


def write_rerun_splats(run: Run, path: Path) -> None:
    """Write what the run shows as a .rrd of Gaussians.

    Raises:
        InputError: as `hoi.render.shown.scene_of`, rerun-sdk is missing or too old, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    try:
        import rerun
    except ImportError:
        raise InputError("--rerun-splats needs rerun-sdk, which is not installed; pip install 'hoi[rerun]'") from None
    if not hasattr(rerun, "GaussianSplats3D"):
        raise InputError(f"--rerun-splats needs rerun-sdk 0.41 or newer, this is {rerun.__version__}")
    scene = scene_of(run)
    with whole_file(path) as part:
        stream = rerun.RecordingStream(f"hoi {scene.name}")
        stream.save(str(part))
        stream.log("scene", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, clouds in moving_parts(run).items():
            for frame, cloud in enumerate(clouds):
                stream.set_time("frame", sequence=frame)
                stream.set_time("time", duration=frame / scene.fps)
                stream.log(f"scene/{name}", _splats(rerun, cloud))
        stream.flush()
        stream.disconnect()


def _splats(rerun: Any, cloud: GaussianCloud) -> Any:
    rgba = np.column_stack([np.clip(colours(cloud), 0, 1), cloud.opacities])
    degree = sh_degree(cloud)
    higher = np.zeros((len(cloud), 15, 3), np.float32)
    higher[:, : cloud.sh.shape[1] - 1] = cloud.sh[:, 1:]
    return rerun.GaussianSplats3D(
        centers=cloud.means,
        scales=cloud.scales,
        quaternions=cloud.quaternions[:, [1, 2, 3, 0]],
        colors=np.rint(255 * rgba).astype(np.uint8),
        sh_coefficients=higher if degree else None,
        spherical_harmonics_degree=degree,
    )
