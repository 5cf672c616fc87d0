"""Who is baked: bodies of `scripts.bake_people`, and what they wear of MakeHuman's core assets."""

from dataclasses import dataclass, field
from typing import Any

SHIRT_LOGO = {"spot": (0.511, 0.196, 0.112, -0.375)}
"""Where MakeHuman's own logo is on the shirts, which CC0 does not cover."""
WOMANS_LOGO = {"spot": (0.789, 0.225, 0.102, -0.485)}
WHITE_SHIRT_LOGO = {"spot": (0.60, 0.14, 0.07, -0.28)}


@dataclass(frozen=True)
class Outfit:
    skin: str
    clothes: tuple[str, ...]
    hair: str
    brows: str
    lashes: str = "Eyelashes01"
    eyes: str = "brown"
    retouched: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Item -> arguments of `scripts.dress_people.makehuman.retouch`."""


OUTFITS = {
    "man": Outfit(
        "young_caucasian_male/textures/young_lightskinned_male_diffuse2.png", ("male_casualsuit04", "shoes02"),
        "short02", "eyebrow001", eyes="brownlight", retouched={"male_casualsuit04": SHIRT_LOGO},
    ),
    "woman": Outfit(
        "young_caucasian_female/textures/young_lightskinned_female_diffuse2.png", ("female_casualsuit01", "shoes06"),
        "ponytail01", "eyebrow006", "eyelashes02", "bluegreen",
        {"female_casualsuit01": WOMANS_LOGO | {"blues": (0.37, 0.85, 1.0)}, "shoes06": {"all_over": (0.0, 0.12, 1.5)}},
    ),
    "child": Outfit(
        "young_caucasian_male/textures/young_lightskinned_male_diffuse.png", ("male_casualsuit04", "shoes06"),
        "short03", "eyebrow009", eyes="blue",
        retouched={"male_casualsuit04": SHIRT_LOGO | {"blues": (-0.47, 1.0, 1.5)},
                   "short03": {"all_over": (0.03, 0.9, 1.6)}},
    ),
    "athlete": Outfit(
        "young_african_male/textures/young_darkskinned_male_diffuse.png", ("male_casualsuit04", "shoes06"),
        "short04", "eyebrow010",
        retouched={
            "male_casualsuit04": SHIRT_LOGO | {"blues": (0.44, 1.1, 1.45), "legs": (0.0, 0.35, 0.38)},
            "shoes06": {"all_over": (0.42, 0.9, 1.3)},
        },
    ),
    "heavy": Outfit(
        "middleage_caucasian_male/textures/middleage_lightskinned_male_diffuse.png", ("male_casualsuit05", "shoes04"),
        "short02", "eyebrow002", eyes="grey", retouched={"short02": {"all_over": (0.0, 0.6, 0.75)}},
    ),
    "senior": Outfit(
        "old_caucasian_female/textures/old_lightskinned_female_diffuse.png", ("female_casualsuit01", "shoes01"),
        "bob02", "eyebrow011", "eyelashes03", "lightblue",
        {"female_casualsuit01": WOMANS_LOGO | {"blues": (0.17, 0.45, 1.1), "legs": (0.0, 0.25, 0.8)},
         "bob02": {"all_over": (0.0, 0.35, 1.1)}},
    ),
    "runner": Outfit(
        "young_asian_female/textures/young_lightskinned_female_diffuse3.png", ("female_sportsuit01", "shoes06"),
        "ponytail01", "eyebrow004", "Eyelashes01",
        retouched={"female_sportsuit01": {"blues": (-0.12, 0.9, 1.3)}, "ponytail01": {"all_over": (0.0, 0.7, 0.3)},
                   "shoes06": {"all_over": (-0.12, 0.8, 1.2)}},
    ),
    "gentleman": Outfit(
        "middleage_african_male/textures/middleage_darkskinned_male_diffuse.png", ("male_elegantsuit01", "shoes03"),
        "afro01", "eyebrow007",
    ),
}  # fmt: skip
