"""What training clips are called: sentences as scene files have them in their prompt and in their negative prompt."""

from hoi.training.video.contacts import FLAWS, LIMBS, OBJECT_SHARES, PEOPLE

WHO = {
    "man": ("a man", "his"), "woman": ("a woman", "her"), "child": ("a child", "the"), "athlete": ("an athlete", "the"),
    "heavy": ("a heavy man", "his"), "senior": ("an old man", "his"),
}  # fmt: skip
ANYONE = ("a person", "the")
VERBS = {
    "foot": ("kicks", "strikes"),
    "knee": ("hits", "strikes"),
    "hand": ("punches", "hits"),
    "hands": ("pushes",),
}
SHORT = {
    "soccer_ball": "ball", "basketball": "ball", "blue_ball": "ball", "cardboard_box": "box", "file_cabinet": "cabinet",
    "beach_ball": "ball", "foam_cube": "cube",
}  # fmt: skip
SENTENCES = {
    "clean": (
        "{who} {verb} the {short} with {limb}",
        "{who} {verb} the {thing} with {limb}. The {part} {touch} the {short}",
        "{who} {verb} a {thing} with {limb}. The {part} {touch} the {short}, the {short} moves away in the direction "
        "of the strike. Sharp, realistic, steady camera",
        "{who} {verb} a {thing}, {limb} just {touch} its surface. Realistic contact",
        "the {part} {touch} the {short}, realistic contact, no penetration",
    ),
    "inside": (
        "{part} inside the {short}, penetration, intersecting geometry",
        "{part} inside the {thing}",
        "{who} {verb} the {thing} and the {part} goes into the {short}, penetration",
        "the {part} sinks into the {thing}, intersecting geometry",
    ),
    "gap": (
        "gap between {part} and {short}, {short} moving before contact, floating",
        "gap between {part} and {thing}",
        "{who} misses the {thing}, and the {short} moves before contact",
        "the {part} does not touch the {thing}, gap, floating",
    ),
    "flawed": (
        "{part} inside the {short}, penetration, intersecting geometry, gap between {part} and {short}, {short} moving "
        "before contact, floating",
        "{part} inside the {short}, penetration, gap between {part} and {short}, blurry, distorted body, extra limbs",
        "{part} inside the {short}, penetration, intersecting geometry, gap between {part} and {short}, {short} moving "
        "before contact, floating, blurry, distorted body, extra limbs",
        "bad contact, penetration, intersecting geometry, gap, floating",
    ),
}  # fmt: skip
"""Of clean clips, of each of `FLAWS`, and "flawed", said of either flaw."""
FLAWED_SHARE = 0.5
"""How often a flawed clip is called flawed, rather than what it is."""
assert {"clean", *FLAWS, "flawed"} == set(SENTENCES)


def captions(limb: int, shape: int, person: int, said: str) -> list[str]:
    """All sentences under a key of `SENTENCES`, for numbers as in `hoi.training.video.clips.Clips`."""
    name, shape_name = LIMBS[limb].name, list(OBJECT_SHARES)[shape]
    part = name.split()[-1]
    words = {"part": part, "short": SHORT[shape_name], "thing": shape_name.replace("_", " ")}
    words["touch"] = "touch" if part == "hands" else "touches"
    found = []
    for who, their in (WHO[PEOPLE[person]], ANYONE):
        own = "both hands" if part == "hands" else f"{their} {name}"
        for verb in VERBS[part]:
            found += [sentence.format(who=who, verb=verb, limb=own, **words) for sentence in SENTENCES[said]]
    return [sentence[0].upper() + sentence[1:] for sentence in dict.fromkeys(found)]
