"""What a field of the configuration can choose from, by the names that the command line takes."""

from enum import StrEnum

from hoi.mpm.laws import LAWS


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
    """The laws in `hoi.mpm.laws`."""

    vars().update({name: name for name in LAWS})


class PlaneContact(StrEnum):
    coulomb = "coulomb"
    slip = "slip"
    stick = "stick"


class Approach(StrEnum):
    step = "step"
    stand = "stand"
    none = "none"
