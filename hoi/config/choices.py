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


class MotionKind(StrEnum):
    hmsd = "hmsd"
    none = "none"


class MotionInit(StrEnum):
    sample = "sample"
    stand = "stand"
    file = "file"


class Sampler(StrEnum):
    ancestral = "ancestral"
    ddim = "ddim"


class UpAxis(StrEnum):
    auto = "auto"
    y = "y"
    z = "z"


class Approach(StrEnum):
    step = "step"
    stand = "stand"
    none = "none"


class AttractionKind(StrEnum):
    windowed = "windowed"
    none = "none"


class AttractionTarget(StrEnum):
    surface = "surface"
    com = "com"


class ContactKind(StrEnum):
    impulse = "impulse"
    none = "none"


class ContactModel(StrEnum):
    impulse = "impulse"
    collider = "collider"


class MoverKind(StrEnum):
    mpm = "mpm"
    constant_velocity = "constant_velocity"


class Precision(StrEnum):
    float32 = "float32"
    float64 = "float64"


class Spline(StrEnum):
    quadratic = "quadratic"
    cubic = "cubic"


class RefineKind(StrEnum):
    video_sds = "video_sds"
    geometric = "geometric"
    none = "none"


class RefineWhen(StrEnum):
    needed = "needed"
    always = "always"


class VideoPriorKind(StrEnum):
    embedded = "embedded"
    cogvideox = "cogvideox"


class RenderKind(StrEnum):
    video = "video"
    none = "none"


class View(StrEnum):
    """The names in `hoi.render.cameras.VIEWS`."""

    front = "front"
    side = "side"
    three_quarter = "three_quarter"
    back = "back"
    top = "top"
    follow = "follow"


class RenderBackend(StrEnum):
    taichi = "taichi"
    gsplat = "gsplat"
    reference = "reference"
