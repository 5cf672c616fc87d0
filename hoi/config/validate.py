"""From what Hydra composed to a checked config: every problem at once, each a line that names field, value and rule."""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.config import CONF, Config, HumanKind, MaterialConf, ObjectKind, PlaneContact
from hoi.config.acts import check_acts, typed_act
from hoi.errors import InputError
from hoi.motion.sentence import limbs_in
from hoi.stages.contract import Requirements

AUTO, ANY = "auto", "any"
"""A limb that the sentence or the motion names; no limb in particular."""
LIMB_KEYS = ("striking_limb", "expected_limb", "contact_joint")
SAYS = "scene.motion_prompt names"
LARGEST = 2**63 - 1
"""What a record's and a generator's numbers can hold."""
MOST_SEEDS = 4096
MOST_CONTACTS = 32


def to_config(composed: DictConfig) -> Config:
    """The composed, checked configuration as dataclasses.

    Raises:
        InputError: a missing value, or anything `validate` finds; one line a problem.
    """
    if deleted := sorted({field.name for field in fields(Config)} - set(composed.keys())):
        raise InputError(f"{', '.join(deleted)}: no value given; ~{deleted[0]} takes it away")
    composed = completed(composed)
    missing = sorted(OmegaConf.missing_keys(composed))
    if missing:
        raise InputError(f"{', '.join(missing)}: no value given")
    if strange := list(_strange(composed)):
        raise InputError("\n".join(strange))
    config: Any = OmegaConf.to_object(composed)
    problems = validate(config)
    if problems:
        raise InputError("\n".join(problems))
    return config


def _strange(node: DictConfig, prefix: str = "") -> Iterator[str]:
    """A line for each key that has no place in the schema (`+key=` puts any there), and each one taken out of it."""
    schema = OmegaConf.get_type(node)
    if not is_dataclass(schema):
        return
    known = [field.name for field in fields(schema)]
    for key in map(str, node):
        if key not in known:
            near = [f"; the nearest is {prefix}{name}" for name in get_close_matches(key, known, 1, cutoff=0)]
            yield f"{prefix}{key}: there is no such key{''.join(near)}"
    for key in known:
        inner = node._get_node(key)
        if inner is None:
            yield f"{prefix}{key}: no value given; ~{prefix}{key} takes it away"
        elif isinstance(inner, DictConfig) and not inner._is_none():
            yield from _strange(inner, f"{prefix}{key}.")


def completed(composed: DictConfig) -> DictConfig:
    """What is recorded: with the materials of regions, and with the limbs that the sentence names for each `auto`.

    Raises:
        InputError: as `with_materials`, or the sentence names another limb than the one that was asked for.
    """
    return with_limbs(with_acts(with_materials(composed)))


def with_acts(composed: DictConfig) -> DictConfig:
    """The same with whole acts, and with the limb that its sentence names for each one's `auto`; the first that strikes
    is the scene's too, where that one is `auto`, and the sentences together are the scene's, where it has none.

    Raises:
        InputError: an act has a field that there is not, lacks one, or has a value of the wrong type.
    """
    if not composed.scene.acts:
        return composed
    composed = composed.copy()
    scene = composed.scene
    scene.acts = acts = [typed_act(act, f"scene.acts.{index}") for index, act in enumerate(scene.acts)]
    if OmegaConf.is_missing(scene, "motion_prompt"):
        scene.motion_prompt = ", then ".join(act.prompt for act in acts)
    striking = sorted((act for act in acts if act.strikes), key=lambda act: act.start)
    if striking and striking[0].strikes in LIMBS:
        limb = striking[0].strikes
        joint = limb if limb in JOINT_NAMES else JOINT_NAMES[LIMBS[limb][-1]]
        values = {"striking_limb": limb, "expected_limb": limb, "contact_joint": joint}
        for key in LIMB_KEYS:
            if not OmegaConf.is_missing(scene, key) and scene[key] == AUTO:
                scene[key] = values[key]
    return composed


def with_limbs(composed: DictConfig) -> DictConfig:
    """The same with a limb for each `auto` of the scene: the sentence's, where a file moves the person its motion's.

    Raises:
        InputError: the sentence names another limb than the scene, or two of which none is the scene's.
    """
    scene = composed.scene
    given = {key: None if OmegaConf.is_missing(scene, key) else scene[key] for key in LIMB_KEYS}
    if OmegaConf.is_missing(scene, "motion_prompt"):
        return composed
    named, asked = limbs_in(scene.motion_prompt), given["striking_limb"]
    from_file = OmegaConf.select(composed, "stage.motion.path") is not None
    asked_joints = set(LIMBS.get(asked, ())) if asked else set()
    if scene.striking_joints:
        asked = list(scene.striking_joints)
        asked_joints = {JOINT_NAMES.index(joint) for joint in asked if joint in JOINT_NAMES}
    fits = [limb for limb in named if asked_joints & set(LIMBS[limb])]
    if AUTO not in given.values():
        return composed
    if len(named) > 1 and not fits and not from_file and asked == AUTO:
        raise InputError(f"{SAYS} {' and '.join(named)}: say which strikes the object, scene.striking_limb={named[0]}")
    limb = (fits or named or [None])[0]
    side, _, part = (limb or "").partition("_")
    either = {"feet": "right_foot", "hands": "right_hand", "knees": "right_knee", "head": "head"}
    joint = {"arm": f"{side}_elbow"}.get(part, limb) if part else either.get(limb or "", "right_foot")
    found = {
        "striking_limb": AUTO if from_file else limb,
        "expected_limb": ANY if from_file or limb is None else limb,
        "contact_joint": joint,
    }
    composed = composed.copy()
    for key, value in found.items():
        if given[key] == AUTO:
            composed.scene[key] = value
    return composed


def with_materials(composed: DictConfig) -> DictConfig:
    """The same with the whole material in the place of each region's (see `hoi.config.RegionConf`): what is recorded.

    Raises:
        InputError: an unknown name or field, or a value of the wrong type.
    """
    if not composed.object.regions:
        return composed
    composed = composed.copy()
    for index, region in enumerate(composed.object.regions):
        where = f"object.regions.{index}.material"
        if OmegaConf.is_missing(region, "material"):
            continue
        material = region.material
        if isinstance(material, str):
            material = _preset(material, where)
        elif not isinstance(material, DictConfig):
            raise InputError(f"{where} must be a name or a mapping, got {material}")
        base = OmegaConf.structured(MaterialConf) if "model" in material else composed.material
        try:
            region.material = OmegaConf.merge(base, material)
        except OmegaConfBaseException as error:
            raise InputError(f"{where}: {str(error).splitlines()[0]}") from None
    return composed


def _preset(name: str, where: str) -> Any:
    """conf/material/NAME.yaml without what is Hydra's."""
    path = CONF / "material" / f"{name}.yaml"
    known = sorted(file.stem for file in path.parent.glob("*.yaml"))
    if name not in known:
        raise InputError(f"{where}: unknown material {name!r}; allowed are {', '.join(known)}, or a mapping")
    preset: Any = OmegaConf.load(path)
    del preset["defaults"]
    return preset


def _numbers(node: Any, path: str = "") -> list[tuple[str, float]]:
    """Every number of a dataclass tree with its dotted name."""
    if hasattr(node, "__dataclass_fields__"):
        pairs = [(name, getattr(node, name)) for name in node.__dataclass_fields__]
    elif isinstance(node, list):
        pairs = [(str(i), value) for i, value in enumerate(node)]
    else:
        return [(path, node)] if isinstance(node, (int, float)) and not isinstance(node, bool) else []
    return [found for name, value in pairs for found in _numbers(value, f"{path}.{name}" if path else name)]


def validate(config: Config) -> list[str]:
    """All that is wrong with a composed config, one sentence each; empty when it is fine.

    What needs a file or the physics is checked where the file is opened and in `hoi.plan`.
    """
    problems = [f"{name} must be finite, got {value}" for name, value in _numbers(config) if not math.isfinite(value)]
    if problems:
        return problems

    require = Requirements()
    scene, stage, placement = config.scene, config.stage, config.scene.placement
    require(config.seed >= 0, "seed", config.seed, "0 or more")
    require(config.seed <= LARGEST, "seed", config.seed, f"at most {LARGEST}")
    require(1 <= config.seeds <= MOST_SEEDS, "seeds", config.seeds, f"in [1, {MOST_SEEDS}]")
    require(config.threads is None or config.threads >= 1, "threads", config.threads, "1 or more, or null")
    require(config.human_points >= 100, "human_points", config.human_points, "100 or more")
    count, given = config.human.gaussians, config.human.kind is HumanKind.smpl
    rule = "1000 or more" if given else "1000 or more, or null for all there are"
    require(not given if count is None else count >= 1000, "human.gaussians", count, rule)
    if config.human.kind is HumanKind.avatar:
        require(
            config.human.path is not None,
            "human.path",
            config.human.path,
            "the path of an avatar's folder or 3DGS PLY file",
        )
    if config.human.kind is HumanKind.smpl:
        require(config.human.path is not None, "human.path", config.human.path, "the path of an SMPL .npz or .pkl file")
    shapeless = config.human.kind is not HumanKind.smpl
    rule = f"empty: human.kind is {config.human.kind.value}"
    require(not (shapeless and config.human.betas), "human.betas", config.human.betas, rule)
    if config.object.kind is ObjectKind.file:
        require(config.object.path is not None, "object.path", config.object.path, "the path of a 3DGS file")
    require(config.object.size > 0, "object.size", config.object.size, "greater than 0 [m]")
    axes = ("auto", "+x", "-x", "+y", "-y", "+z", "-z")
    require(config.object.up in axes, "object.up", config.object.up, f"one of {', '.join(axes)}")
    require(config.object.max_gaussians >= 100, "object.max_gaussians", config.object.max_gaussians, "100 or more")
    drawn = config.object.max_drawn
    require(drawn is None or drawn >= config.object.max_gaussians, "object.max_drawn", drawn,
            f"null or no less than object.max_gaussians, {config.object.max_gaussians}")  # fmt: skip
    materials = {"material": config.material}
    for index, region in enumerate(config.object.regions):
        name, box = f"object.regions.{index}", region.box
        materials[f"{name}.material"] = region.material
        for part, vector in (("centre", box.centre), ("half_size", box.half_size)):
            require(len(vector) == 3, f"{name}.box.{part}", vector, "a list of 3 numbers")
        require(all(half > 0 for half in box.half_size), f"{name}.box.half_size", box.half_size, "greater than 0")
    for name, material in materials.items():
        require(0 <= material.restitution <= 1, f"{name}.restitution", material.restitution, "in [0, 1]")
        require(material.ground_friction >= 0, f"{name}.ground_friction", material.ground_friction, "0 or more")

    require(scene.frames >= 2, "scene.frames", scene.frames, "2 or more")
    require(scene.fps > 0, "scene.fps", scene.fps, "greater than 0 [1/s]")
    for name, vector, length in (
        ("scene.gravity", scene.gravity, 3),
        ("scene.placement.position", placement.position, 3),
        ("scene.placement.velocity", placement.velocity, 3),
        ("scene.placement.angular_velocity", placement.angular_velocity, 3),
    ):
        require(len(vector) == length, name, vector, f"a list of {length} numbers")
    turn = placement.orientation
    require(len(turn) == 4 and any(turn), "scene.placement.orientation", turn, "a quaternion wxyz that is not zero")
    on_ground = len(placement.position) == 3 and placement.position[2] is None
    require(scene.ground or not on_ground, "scene.placement.position", placement.position, "a number in z: no ground")
    for index, plane in enumerate(scene.planes or []):
        name, coulomb = f"scene.planes.{index}", plane.contact is PlaneContact.coulomb
        require(len(plane.point) == 3, f"{name}.point", plane.point, "a list of 3 numbers")
        normal = plane.normal
        require(len(normal) == 3 and any(normal), f"{name}.normal", normal, "a list of 3 numbers, not all 0")
        friction = plane.friction
        require(friction is None or coulomb, f"{name}.friction", friction, f"null: contact is {plane.contact.value}")
        require(friction is None or friction >= 0, f"{name}.friction", friction, "0 or more, or null")
    xy = placement.position[:2]
    require(None not in xy, "scene.placement.position", placement.position, "numbers in x and y")
    expected = scene.expected_limb
    require(expected in (*LIMBS, ANY), "scene.expected_limb", expected, f"one of {', '.join(LIMBS)}, any or auto")
    limb = scene.striking_limb
    rule = f"null or one of {', '.join(LIMBS)} or auto"
    require(limb is None or limb in (*LIMBS, AUTO), "scene.striking_limb", limb, rule)
    joints = ", ".join(JOINT_NAMES)
    require(scene.contact_joint in JOINT_NAMES, "scene.contact_joint", scene.contact_joint, f"one of {joints}")
    together = scene.striking_joints
    if together is not None:
        rule = f"null, or two or more different ones of {joints}"
        known = set(together) <= set(JOINT_NAMES) and len(set(together)) == len(together) >= 2
        require(known, "scene.striking_joints", together, rule)
        rule = f"one of scene.striking_joints: {', '.join(together)}"
        require(not known or scene.contact_joint in together, "scene.contact_joint", scene.contact_joint, rule)
    rule = "0 or more [s]" if together else "0: scene.striking_joints is null"
    require(scene.hold == 0 or (together is not None and scene.hold > 0), "scene.hold", scene.hold, rule)
    count = scene.contacts
    require(count is None or 1 <= count <= MOST_CONTACTS, "scene.contacts", count, f"in [1, {MOST_CONTACTS}], or null")
    require(0.25 <= scene.tempo <= 4, "scene.tempo", scene.tempo, "in [0.25, 4]")
    if scene.fps > 0:
        check_acts(scene.acts, scene.frames / scene.fps, require)
    rule = "null: scene.acts say what strikes"
    require(not (scene.acts and together), "scene.striking_joints", together, rule)
    moved_by_file = getattr(stage.motion, "path", None) is not None
    rule = "empty: stage.motion.init is file, whose motion has a time of its own"
    require(not (scene.acts and moved_by_file), "scene.acts", f"{len(scene.acts)} acts", rule)
    last = scene.frames - 1
    require(0 <= scene.contact_frame <= last, "scene.contact_frame", scene.contact_frame, f"in [0, {last}]")

    for option in (stage.motion, stage.coordinate, stage.attraction, stage.contact, stage.object, stage.refine):
        option.check(config, require)
    config.render.check(config, require)
    if not require.problems and not scene.acts:
        _check_sentence(config, require)
    return require.problems


def _check_sentence(config: Config, require: Requirements) -> None:
    """The limb that the sentence names is the one that was asked for, where a sentence moves the person."""
    scene, limb = config.scene, config.scene.striking_limb
    named = limbs_in(scene.motion_prompt)
    striking = {JOINT_NAMES[joint] for joint in LIMBS.get(limb or "", ())}
    key, asked = ("striking_joints", scene.striking_joints) if scene.striking_joints else ("striking_limb", limb)
    striking = striking if not scene.striking_joints else set(scene.striking_joints)
    fits = not named or any(JOINT_NAMES[joint] in striking for name in named for joint in LIMBS[name])
    moved_by_file = getattr(config.stage.motion, "path", None) is not None
    rule = f"{' or '.join(named)}, which scene.motion_prompt names ({scene.motion_prompt!r}), or auto"
    require(fits or moved_by_file or not striking & set(JOINT_NAMES), f"scene.{key}", asked, rule)
