"""The timeline of a scene: its limbs from its sentences, and what acts must be."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import combinations
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.body.skeleton import LIMBS
from hoi.config.scene import ActConf
from hoi.errors import InputError
from hoi.motion.sentence import limbs_in
from hoi.stages.contract import Requirements

PARTS = ("left_arm", "right_arm", "legs", "head", "spine")
"""As `hoi.motion.features.PARTS`, which needs torch."""
SHORTEST = 0.5
"""As long as an act fades into the next [s]."""
LEAST_SECONDS = 2.0
"""What the motion priors know the least [s]."""
AUTO = "auto"


def limb_of(prompt: str, strikes: str | None) -> str | None:
    """The limb of an act: what it says, or for auto what its sentence names, auto where that names none or several."""
    if strikes != AUTO:
        return strikes
    named = limbs_in(prompt)
    return named[0] if len(named) == 1 else AUTO


def typed_act(said: Any, where: str) -> ActConf:
    """An act from what a config says of it, its limb with it.

    Raises:
        InputError: it has a field that there is not, lacks one, or has a value of the wrong type.
    """
    if isinstance(said, ActConf):
        return said
    known = [each.name for each in fields(ActConf)]
    if not isinstance(said, Mapping | DictConfig):
        raise InputError(f"{where} must be a mapping of {', '.join(known)}, got {said}")
    act = OmegaConf.structured(ActConf)
    for key, value in said.items():
        if key not in known:
            raise InputError(f"{where}.{key}: there is no such key; an act has {', '.join(known)}")
        try:
            act[key] = value
        except OmegaConfBaseException as error:
            raise InputError(f"{where}.{key}: {str(error).splitlines()[0]}") from None
    if missing := sorted(OmegaConf.missing_keys(act)):
        raise InputError(f"{where}.{missing[0]}: no value given")
    found: Any = OmegaConf.to_object(act)
    return replace(found, strikes=limb_of(found.prompt, found.strikes))


def check_acts(acts: Sequence[ActConf], seconds: float, require: Requirements) -> None:
    """State what the acts of a scene of so many seconds must be."""
    if acts:
        require(seconds >= LEAST_SECONDS, "scene.frames", f"{seconds:g} s", f"{LEAST_SECONDS:g} s or more with acts")
    for index, act in enumerate(acts):
        own = require.of(f"scene.acts.{index}")
        own(bool(act.prompt.strip()), "prompt", repr(act.prompt), "a sentence")
        own(0 <= act.start < seconds, "start", act.start, f"in [0, {seconds:g}), the scene's time [s]")
        rule = f"at least {SHORTEST:g} s after its start, {act.start:g}, and at most {seconds:g}, the scene's end [s]"
        if 0 <= act.start < seconds:
            own(act.start + SHORTEST <= act.end <= seconds, "end", act.end, rule)
        for part in act.parts:
            own(part in PARTS, "parts", part, f"of {', '.join(PARTS)}")
        own(len(set(act.parts)) == len(act.parts), "parts", act.parts, "each once")
        limb, named = act.strikes, limbs_in(act.prompt)
        rule = f"null or one of {', '.join(LIMBS)} or auto"
        if limb == AUTO:
            said = f"; its sentence names {' and '.join(named) or 'no limb'}"
            own(False, "strikes", AUTO, f"{', '.join(named or LIMBS)} or null{said}")
        else:
            own(limb is None or limb in LIMBS, "strikes", limb, rule)
        if limb in LIMBS:
            fits = not named or any(set(LIMBS[limb]) & set(LIMBS[name]) for name in named)
            own(fits, "strikes", limb, f"{' or '.join(named)}, which its sentence names ({act.prompt!r}), or auto")
            moved = set(act.parts or PARTS)
            own(_part_of(limb) <= moved, "strikes", limb, f"a limb of its parts, {', '.join(act.parts)}")
        if act.at is not None:
            own(limb is not None, "at", act.at, "null: nothing strikes")
            own(act.start <= act.at <= act.end, "at", act.at, f"in [{act.start:g}, {act.end:g}], the act's time [s]")
        sends = act.sends
        own(sends is None or limb is not None, "sends", sends, "null: nothing strikes")
        rule = "null or a list of 3 numbers, not all 0"
        own(sends is None or (len(sends) == 3 and any(sends)), "sends", sends, rule)
        own(0.25 <= act.tempo <= 4, "tempo", act.tempo, "in [0.25, 4]")
        own(act.flesh is None or 0 <= act.flesh <= 1, "flesh", act.flesh, "in [0, 1], or null")
        own(act.flesh is None or limb is not None, "flesh", act.flesh, "null: nothing strikes")
        own(act.tempo == 1 or limb is not None, "tempo", act.tempo, "1: nothing strikes")
    for (first, one), (second, other) in combinations(enumerate(acts), 2):
        if one.start < other.end and other.start < one.end and bool(one.parts) == bool(other.parts):
            shared = sorted(set(one.parts) & set(other.parts)) if one.parts else ["all parts"]
            times = f"{other.start:g} to {other.end:g} s"
            rule = f"free of what scene.acts.{first} moves from {one.start:g} to {one.end:g} s ({', '.join(shared)})"
            require(not shared, f"scene.acts.{second}", times, rule)


def _part_of(limb: str) -> set[str]:
    """The body parts that a limb is in."""
    if limb == "head":
        return {"head"}
    side, _, part = limb.partition("_")
    if limb == "hands":
        return {"left_arm", "right_arm"}
    return {f"{side}_arm"} if part in ("hand", "arm") else {"legs"}
