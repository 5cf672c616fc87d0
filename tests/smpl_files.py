"""Tiny body models in the exact layout of SMPL's, SMPL-H's and SMPL-X's files: an octahedron around each joint.

A vertex's weights are the same all over its octahedron, so that skinning is affine there and what lies on a triangle
stays on it.
"""

import pickle
import struct
import sys
import types
from pathlib import Path

import numpy as np
from scipy import sparse

from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES, PARENTS

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
TRIANGLES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
FINGERS = ("index", "middle", "pinky", "ring", "thumb")


def parents_of(joints: int) -> list[int]:
    """Parents in the files' order; the root's as the largest unsigned integer."""
    parents = [4294967295, *PARENTS[1:]]
    if joints == 24:
        return parents
    parents = parents[:22] + ([15, 15, 15] if joints == 55 else [])
    for wrist in (20, 21):
        for _ in FINGERS:
            first = len(parents)
            parents += [wrist, first, first + 1]
    return parents


def make_model(joints: int = 24, shapes: int = 10, seed: int = 0) -> dict[str, np.ndarray]:
    """Arrays as the files name them, all dense."""
    rng = np.random.default_rng(seed)
    parents = parents_of(joints)
    body = load_person("man", 100).rest_joints.astype(np.float64)
    centres = np.zeros((joints, 3))
    centres[:22] = body[:22]
    if joints == 24:
        centres[22:] = body[22:]
    for joint in range(22, joints if joints > 24 else 22):
        side = 1 if centres[parents[joint], 0] > 0 else -1
        depth = 0.02 * ((joint - 22) // 3 % 5 - 2)
        step = np.array([0.0, 0.03, 0.05]) if parents[joint] == 15 else np.array([side * 0.04, 0, depth])
        centres[joint] = centres[parents[joint]] + step
    centres += (0.002, -0.223, 0.028)  # the pelvis is not at the origin of SMPL's frame
    radius = np.where(np.arange(joints) < 22, 0.06, 0.012)
    radius[15] = 0.12
    vertices = (centres[:, None] + radius[:, None, None] * OCTAHEDRON).reshape(-1, 3)
    share = np.zeros((joints, joints))
    for joint in range(joints):
        share[joint, joint] = 1.0 if joint == 0 else 0.7
        if joint:
            share[joint, parents[joint]] = 0.3
    count = len(vertices)
    return {
        "v_template": vertices,
        "shapedirs": rng.normal(0, 0.004, (count, 3, shapes)),
        "posedirs": rng.normal(0, 0.003, (count, 3, 9 * (joints - 1))),
        "J_regressor": np.repeat(np.eye(joints), 6, axis=1) / 6,
        "weights": np.repeat(share, 6, axis=0),
        "kintree_table": np.array([parents, range(joints)], np.uint32),
        "f": (TRIANGLES + 6 * np.arange(joints)[:, None, None]).reshape(-1, 3).astype(np.uint32),
    }


class Python2Pickler(pickle._Pickler):  # pyright: ignore[reportAttributeAccessIssue]
    """Writes text and bytes as Python 2 wrote `str`."""

    dispatch = dict(pickle._Pickler.dispatch)  # pyright: ignore[reportAttributeAccessIssue] # noqa: RUF012

    def save_text(self, text):
        raw = text if isinstance(text, bytes) else text.encode("latin1")
        self.write(b"T" + struct.pack("<i", len(raw)) + raw)
        self.memoize(text)

    dispatch[str] = save_text
    dispatch[bytes] = save_text


def pickle_model(path: Path, model: dict, protocol: int = 2, chumpy: bool = True) -> Path:
    """As SMPL 1.0 and 1.1 were written: `J_regressor` sparse, `shapedirs` and `v_template` of chumpy, Python 2."""
    values = dict(model) | {"J_regressor": sparse.csc_matrix(model["J_regressor"]), "bs_style": "lbs"}
    modules = chumpy_modules()
    if chumpy:
        ch, select = modules["chumpy.ch"].Ch, modules["chumpy.reordering"].Select
        values["v_template"] = ch(model["v_template"])
        wide = np.concatenate([model["shapedirs"], np.zeros_like(model["shapedirs"])], axis=2)
        places = np.arange(wide.size).reshape(wide.shape)[:, :, : model["shapedirs"].shape[2]]
        values["shapedirs"] = select(ch(wide), places.ravel(), model["shapedirs"].shape)
    sys.modules.update(modules)
    try:
        with path.open("wb") as file:
            Python2Pickler(file, protocol).dump(values)
    finally:
        for name in modules:
            del sys.modules[name]
    renamed = path.read_bytes().replace(b"numpy._core.multiarray\n", b"numpy.core.multiarray\n")
    path.write_bytes(renamed.replace(b"scipy.sparse._csc\n", b"scipy.sparse.csc\n"))
    return path


def chumpy_modules() -> dict[str, types.ModuleType]:
    """Enough of chumpy to be pickled: its classes' names and the state that they keep."""
    modules = {name: types.ModuleType(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")}

    def ch_init(self, array):
        self.__dict__.update(x=array, dterms=["x"], _dirty_vars={"x"}, _itr=None)

    def select_init(self, array, places, shape):
        self.__dict__.update(a=array, idxs=places, preferred_shape=shape, _dirty_vars=set())

    for module, name, init in (("chumpy.ch", "Ch", ch_init), ("chumpy.reordering", "Select", select_init)):
        kind = type(name, (), {"__init__": init, "__module__": module})
        setattr(modules[module], name, kind)
    return modules


def smpl_vertices(model: dict, betas: np.ndarray, pose: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """SMPL by the book (Loper et al. 2015, eqs. 2 to 10), joint by joint in float64: vertices (V, 3).

    Args:
        pose: axis-angle of every joint, (K, 3). pelvis: where the pelvis joint goes, (3,).
    """
    from scipy.spatial.transform import Rotation

    shaped = model["v_template"] + np.einsum("vcs,s->vc", model["shapedirs"][:, :, : len(betas)], betas)
    rest = model["J_regressor"] @ shaped
    local = Rotation.from_rotvec(pose).as_matrix()
    feature = (local[1:] - np.eye(3)).ravel()
    corrected = shaped + np.einsum("vcp,p->vc", model["posedirs"], feature)
    world = []
    for joint, parent in enumerate(model["kintree_table"][0]):
        step = np.eye(4)
        step[:3, :3] = local[joint]
        step[:3, 3] = rest[joint] if joint == 0 else rest[joint] - rest[parent]
        world.append(step if joint == 0 else world[parent] @ step)
    posed = np.zeros_like(shaped)
    for joint, transform in enumerate(world):
        moved = (corrected - rest[joint]) @ transform[:3, :3].T + transform[:3, 3]
        posed += model["weights"][:, [joint]] * moved
    return posed - rest[0] + pelvis


JOINT = {name: index for index, name in enumerate(JOINT_NAMES)}
