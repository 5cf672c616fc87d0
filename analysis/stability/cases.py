"""The grid of cases: full products of a few parameters at a time, around a body that is easy."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hoi.data import Array, Material, Plane


@dataclass(frozen=True)
class Case:
    """One run of the MPM: every parameter, and whether it must run or be refused.

    The body starts with its nearest particle `gap` cells from the planes, on their free side, and moves towards them.
    """

    id: str = ""
    family: str = ""
    must: Literal["run", "refuse"] = "run"

    model: str = "fixed_corotated"
    youngs_modulus: float = 1e5
    """E [Pa]."""
    poisson_ratio: float = 0.3
    density: float = 1000.0
    """[kg/m^3]"""
    yield_strain: float = np.inf
    """Yield stress over E [-]."""
    hardening: float = 0.0
    relaxation: float = 0.0
    """Viscosity over E [s]."""
    friction_angle: float = 0.0
    """[rad]"""
    critical_compression: float = 0.0
    critical_stretch: float = 0.0
    other_stiffness: float = 0.0
    """E of one half of the body over that of the other; 0: it is of one material [-]."""

    shape: str = "block"
    """See `trial.SHAPES`."""
    particles: int = 512
    """About this many."""
    size: float = 0.2
    """Largest extent [m]."""
    cells: float = 4.0
    """Cells of the grid across `size`."""

    gap: float = 0.0
    """Between body and planes at the start, negative inside [cells]."""
    speed: float = 5.0
    """[m/s]"""
    heading: Literal["into", "along", "slant", "out"] = "into"
    """Of the velocity, with respect to the planes; "slant" is 45 degrees between into and along."""
    spin: float = 0.0
    """About an axis oblique to all of the body's own [rad/s]."""
    gravity: float = 9.81
    """Downward [m/s^2]."""
    kick: float = 0.0
    """Speed of the limb in an impulse towards `heading` at half time, in wave speeds [-]."""
    kick_restitution: float = 0.0
    rebound: float = 1.0
    """What its own loss leaves it of its speed in a bounce [-]; 1: elastic."""

    planes: Literal["none", "plane", "wedge", "corner"] = "plane"
    tilt: float = 0.0
    """Of the plane, or of both sides of the wedge, from the horizontal [degree]."""
    contact: str = "coulomb"
    friction: float = 0.4
    collider: float = 0.0
    """Speed of a capsule driven into the body for half its width [m/s]; 0: there is none."""
    collider_side: Literal["side", "top"] = "side"

    spline: Literal["quadratic", "cubic"] = "quadratic"
    precision: Literal["float32", "float64"] = "float32"
    dt_share: float | None = None
    """Of the limit, for a fixed step [-]; None: chosen by the solver."""
    lasts: int = 500
    """In steps of the length that is chosen at the start."""
    duration: float | None = None
    """How long it lasts instead [s]."""
    frames: int = 20
    """How often the state is looked at."""

    @property
    def dx(self) -> float:
        """Cell size [m]."""
        return self.size / self.cells

    @property
    def material(self) -> Material:
        return Material(
            name=self.model,
            model=self.model,
            youngs_modulus=self.youngs_modulus,
            poisson_ratio=self.poisson_ratio,
            density=self.density,
            restitution=self.kick_restitution,
            ground_friction=self.friction,
            yield_stress=self.yield_strain * self.youngs_modulus,
            hardening=self.hardening,
            viscosity=self.relaxation * self.youngs_modulus,
            friction_angle=self.friction_angle,
            critical_compression=self.critical_compression,
            critical_stretch=self.critical_stretch,
        )

    @property
    def solid_planes(self) -> tuple[Plane, ...]:
        """Through the origin, all of them."""
        slope = np.radians(self.tilt)
        uphill = np.array([-np.sin(slope), 0, np.cos(slope)])
        normals: dict[str, list[Array]] = {
            "none": [],
            "plane": [uphill],
            "wedge": [uphill, uphill * [-1, 1, 1]],
            "corner": list(np.eye(3)),
        }
        return tuple(Plane(np.zeros(3), normal, self.contact, self.friction) for normal in normals[self.planes])

    @property
    def compile_key(self) -> tuple[str, str, str]:
        """Cases of one key run the same compiled kernels."""
        return self.precision, self.model + ("" if self.rebound == 1 else ", damped"), self.spline


SYMBOLS = {
    "youngs_modulus": "E", "poisson_ratio": "nu", "density": "rho", "particles": "P", "size": "L", "speed": "v",
    "spin": "w", "gravity": "g", "gap": "gap", "kick": "kick", "kick_restitution": "e", "rebound": "r",
    "tilt": "tilt", "collider": "u", "dt_share": "dt", "duration": "t", "frames": "n", "friction": "f",
    "yield_strain": "yield", "hardening": "hard", "relaxation": "relax", "friction_angle": "angle",
    "critical_compression": "crit", "other_stiffness": "ratio",
}  # fmt: skip

PLASTIC: dict[str, dict[str, Any]] = {
    "von_mises": {"yield_strain": 0.01, "hardening": 0.1},
    "drucker_prager": {"friction_angle": 0.6},
    "snow": {"critical_compression": 0.025, "critical_stretch": 0.0075, "hardening": 10.0},
    "viscoplastic": {"yield_strain": 0.01, "relaxation": 0.01},
    "fluid": {"relaxation": 1e-5},
}
"""Middling parameters of the models that flow."""
ELASTIC = ("fixed_corotated", "neo_hookean")
MODELS = (*ELASTIC, *PLASTIC)


def grid(family: str, base: Case, **axes: Sequence[Any]) -> list[Case]:
    """The full product of `axes`, each a field of Case with its values; an id is family/value/value/..."""
    cases = []
    for values in itertools.product(*axes.values()):
        named = dict(zip(axes, values, strict=True))
        label = "/".join([family, *(_label(name, value) for name, value in named.items())])
        flow = PLASTIC.get(named.get("model", ""), {})
        cases.append(replace(base, **(flow | named | {"id": label, "family": family})))
    return cases


def _label(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    number = "free" if value is None else f"{value:.4g}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    return f"{SYMBOLS[name]}{number}"


def _families() -> list[Case]:
    base, still, free = Case(), Case(speed=0.0), Case(planes="none", gravity=0.0)
    flight = replace(free, spin=20.0, gravity=9.81)
    few = (MODELS[0], "drucker_prager")  # in cubic float64, which takes longest to compile
    stiff = replace(base, youngs_modulus=1e7)
    counts = (1, 2, 10, 100, 1000, 10_000, 100_000)
    grain = [
        replace(base, particles=count, cells=max((count / 8) ** (1 / 3), 0.5), lasts=500 if count < 3000 else 60)
        for count in counts
    ]
    splines, precisions = ["quadratic", "cubic"], ["float32", "float64"]
    refused = replace(base, must="refuse")
    return [
        *grid("elasticity", base, model=ELASTIC, youngs_modulus=[1e2, 1e4, 1e6, 1e8, 1e10],
              poisson_ratio=[0.0, 0.3, 0.45, 0.499]),
        *grid("density", base, model=ELASTIC, youngs_modulus=[1e2, 1e6, 1e10], density=[1.0, 30.0, 2e4]),
        *grid("speed", base, model=ELASTIC, youngs_modulus=[1e2, 1e4, 1e6, 1e9], speed=[0.1, 10.0, 44.0, 100.0]),
        *grid("free_spin", free, precision=precisions, youngs_modulus=[1e3, 1e5, 1e7, 1e10], spin=[10.0, 50.0, 200.0]),
        *grid("spinning_top", replace(base, speed=2.0), youngs_modulus=[1e4, 1e7], spin=[50.0, 200.0]),
        *grid("bounce", base, contact=["coulomb"], friction=[0.0, 0.4, 10.0], tilt=[0.0, 30.0, 60.0]),
        *grid("bounce", base, contact=["slip", "stick"], friction=[0.0], tilt=[0.0, 30.0, 60.0]),
        *grid("rest", still, model=ELASTIC, youngs_modulus=[1e3, 1e4, 1e6, 1e8, 1e10]),
        *grid("kick", still, heading=["slant", "out"], youngs_modulus=[1e4, 1e8], kick=[0.1, 1.0],
              kick_restitution=[0.0, 1.0]),
        *grid("shape", replace(base, spin=20.0), model=ELASTIC, heading=["into", "along"],
              shape=["ball", "plate", "needle", "cloud", "coincident", "point"]),
        *(case for one in grain for case in grid("particles", one, particles=[one.particles])),
        *grid("inside", still, planes=["plane", "corner"], youngs_modulus=[1e4, 1e7], gap=[-0.5, -2.0, -6.0]),
        *grid("inside_tilted", replace(still, gap=-2.0), planes=["plane", "wedge"], tilt=[15.0, 45.0]),
        *grid("size", base, precision=precisions, youngs_modulus=[1e3, 1e6, 1e9], size=[0.01, 0.1, 1.0, 10.0]),
        *grid("step", replace(base, speed=0.5, lasts=300), model=MODELS, spline=splines, dt_share=[0.5, 0.9]),
        *grid("step", refused, model=MODELS, spline=splines, dt_share=[1.1, 10.0]),
        *grid("landing", replace(base, lasts=300), precision=["float32"], spline=splines, model=MODELS),
        *grid("landing", replace(base, lasts=300), precision=["float64"], spline=splines[:1], model=MODELS),
        *grid("landing", replace(base, lasts=300), precision=["float64"], spline=splines[1:], model=few),
        *grid("flight", flight, precision=["float32"], spline=splines, model=MODELS),
        *grid("flight", flight, precision=["float64"], spline=splines[:1], model=MODELS),
        *grid("flight", flight, precision=["float64"], spline=splines[1:], model=few),
        *grid("step_in_a_crash", replace(base, lasts=300), model=MODELS, dt_share=[0.5, 0.9]),
        *grid("crash", replace(base, lasts=300), model=tuple(PLASTIC), youngs_modulus=[1e4, 1e7],
              speed=[10.0, 44.0, 100.0]),
        *grid("damping", base, rebound=[0.2, 0.5, 0.8, 1.0], youngs_modulus=[1e3, 1e5, 1e7, 1e9], size=[0.02, 2.0]),
        *grid("damping_by_model", base, model=(*ELASTIC, "von_mises"), rebound=[0.2, 0.6], speed=[1.0, 10.0]),
        *_plastic(base),
        *grid("two_materials", replace(base, speed=1.0), model=MODELS[:5], other_stiffness=[0.1, 10.0, 1e4]),
        *grid("gravity", still, model=ELASTIC, youngs_modulus=[1e3, 1e6], gravity=[0.0, 1.62, 1e3, 1e5]),
        *grid("short_frames", replace(base, frames=200), spline=splines, duration=[1e-4, 0.02]),
        *grid("long_frames", replace(base, frames=1), spline=splines, duration=[0.1, 1.0]),
        *grid("wall", stiff, heading=["into", "slant"], speed=[5.0, 44.0], tilt=[15.0, 45.0, 75.0, 90.0]),
        *grid("wedge", replace(stiff, planes="wedge"), contact=["coulomb", "stick"], speed=[5.0, 44.0],
              tilt=[15.0, 45.0, 75.0]),
        *grid("corner", replace(stiff, planes="corner"), contact=["coulomb", "stick"], speed=[5.0, 44.0]),
        *grid("collider", still, collider_side=["side", "top"], youngs_modulus=[1e4, 1e7], collider=[1.0, 10.0, 50.0]),
        *grid("collider_by_model", replace(still, collider=5.0), spline=splines, model=MODELS),
        *grid("drop_of_100m", replace(stiff, size=0.5, speed=0.0, gap=800.0, duration=4.7), model=ELASTIC),
        *grid("impossible", refused, youngs_modulus=[0.0, -1.0, np.inf, np.nan]),
        *grid("impossible", refused, poisson_ratio=[-1.0, 0.5, 0.6]),
        *grid("impossible", refused, density=[0.0, np.nan]),
        *grid("impossible", refused, dt_share=[0.0, -1.0, np.nan]),
        *grid("impossible", refused, speed=[np.inf]),
        *grid("impossible", refused, gravity=[np.nan]),
        *grid("impossible", refused, contact=["glue"]),
        *grid("impossible", refused, friction=[-0.1, np.nan]),
    ]  # fmt: skip


def _plastic(base: Case) -> list[Case]:
    """Each model that flows at the ends of what its own parameters may be."""
    of = {model: replace(base, model=model, **values) for model, values in PLASTIC.items()}
    return [
        *grid("von_mises", of["von_mises"], yield_strain=[1e-6, 1.0], hardening=[0.0, 10.0]),
        *grid("drucker_prager", of["drucker_prager"], youngs_modulus=[1e4, 1e7], friction_angle=[0.01, 0.5, 1.5]),
        *grid("snow", of["snow"], critical_compression=[1e-3, 0.3], hardening=[0.0, 20.0]),
        *grid("viscoplastic", of["viscoplastic"], yield_strain=[1e-6, 1.0], relaxation=[0.0, 1e-6, 1.0]),
        *grid("fluid", of["fluid"], poisson_ratio=[0.3, 0.499], relaxation=[0.0, 1e-6, 1e-4]),
    ]


CASES: dict[str, Case] = {case.id: case for case in _families()}
"""All cases by id."""


def quick() -> list[Case]:
    """A few dozen of them for every change: some of each family, of those that share the commonest kernels."""
    common = [
        case
        for case in CASES.values()
        if case.compile_key[::2] == ("float32", "quadratic")
        and case.model in (MODELS[0], "drucker_prager")
        and case.particles <= 1000
        and case.duration is None
    ]
    return common[::5]
