"""Which limb an English sentence says that somebody strikes with."""

import re

NOUNS = {
    "foot": r"foot|feet|toes?|heels?|insteps?|shoes?|boots?|soles?|legs?|shins?|kick",
    "knee": r"knees?",
    "hand": r"hands?|fists?|palms?|fingers?|knuckles?|punch|jab|cross|hook|uppercut|slap",
    "arm": r"elbows?|forearms?|arms?",
}
"""What follows a side."""
VERBS = {
    "knee": r"knee(s|d|ing)?|knee strikes?",
    "foot": r"(\w+-)?kick(s|ed|ing)?|stomp(s|ed|ing)?|feet",
    "head": r"head(s|ed|ing|er|butts?)",
    "hand": r"punch(es|ed|ing)?|jab(s|bed|bing)?|slap(s|ped|ping)?|box(es|ed|ing)|uppercuts?|push(es|ed|ing)?"
    r"|shov(es?|ed|ing)|hands",
}
"""What is done with either side, the clearest first."""
ADJECTIVES = 2
"""Words that may stand between a side and its limb."""
BOTH = {"foot": "feet", "knee": "knees", "hand": "hands"}
_PARTS = "|".join(f"(?P<{part}>{words})" for part, words in NOUNS.items())
_NO_ADJECTIVE = r"(?!(?:and|then|to|with|while|or)\b)"
SIDED = re.compile(
    rf"\b(?P<side>left|right|both|two)\b(?:[ -]+{_NO_ADJECTIVE}[a-z]+){{0,{ADJECTIVES}}}?[ -]+(?:{_PARTS})\b"
)


def limbs_in(sentence: str) -> list[str]:
    """The limbs that it names, by the names of `hoi.body.skeleton.LIMBS`.

    "left_foot" where it says the side, "feet" where both strike or either may, none where it names no limb.
    """
    text = sentence.lower()
    named = []
    for found in SIDED.finditer(text):
        part = next(part for part in NOUNS if found[part])
        side = found["side"]
        limb = f"{side}_{part}" if side in ("left", "right") else BOTH.get(part)
        if limb and limb not in named:
            named.append(limb)
    if named:
        return named
    part = next((part for part, words in VERBS.items() if re.search(rf"\b({words})\b", text)), None)
    return [] if part is None else [BOTH.get(part, part)]
