"""What a field of the configuration can choose from, by the names that the command line takes."""

from enum import StrEnum


class Device(StrEnum):
    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


class Ablation(StrEnum):
    full = "full"
    no_attraction = "no_attraction"
    no_contact = "no_contact"
    no_mdm = "no_mdm"
    no_mpm = "no_mpm"
    no_video_sds = "no_video_sds"


class HumanKind(StrEnum):
    builtin = "builtin"
    avatar = "avatar"
    smpl = "smpl"


class ObjectKind(StrEnum):
    builtin = "builtin"
    file = "file"


class MaterialModel(StrEnum):
    fixed_corotated = "fixed_corotated"
    neo_hookean = "neo_hookean"
    von_mises = "von_mises"
    viscoplastic = "viscoplastic"
    drucker_prager = "drucker_prager"
    snow = "snow"
    fluid = "fluid"


class PlaneContact(StrEnum):
    coulomb = "coulomb"
    slip = "slip"
    stick = "stick"


class Approach(StrEnum):
    step = "step"
    stand = "stand"
    none = "none"
