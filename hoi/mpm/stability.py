"""The time step that explicit MLS-MPM allows: plain arithmetic, so that a plan can check a run before it starts.

Measured with this solver (1500 to 6000 steps, a free ball 4 to 5 cells across, 1 to 27 particles a cell, regular and
random): the CFL number (c + |v|) dt / dx, with the P-wave speed c at rest, above which a small perturbation grows is

| nu | -0.5 | 0 | 0.3 | 0.45 | 0.49 |
| --- | --- | --- | --- | --- | --- |
| 8 to 27 particles a cell | 1.10 | 1.14 | 1.05 | 0.92 | 0.87 |
| 1 to 2 particles a cell | 0.96 | 1.01 | 0.92 | 0.78 | 0.73 |

It does not depend on E, rho or the speed of the whole body. Impact on the ground at 0.2 c lowers it nowhere.

A strained body is to be stepped by the c of its present state, sqrt(M / rho) with `hoi.mpm.kernels.stiffness` M.
With that c, of blocks held under uniform stretches of 0.7, 0.8, 1.2 and 1.35 and in one direction of 0.6 and 1.5, with
nu of 0.3 and 0.45, neo_hookean, fixed_corotated and those in Hencky strain are all stable up to the limit below, but
fixed_corotated pressed to a third of its volume with nu 0.45: up to 0.6.

The viscosity of a fluid, which acts explicitly, adds its own limit: viscosity dt / (rho dx^2) <= 0.40 without pressure.
For symplectic Euler a wave and a diffusion are stable together while (dt / dt_wave)^2 + dt / dt_diffusion <= 1, which
holds here with a margin of 1.2 to 2.2. What flows plastically has no such limit: its return map is implicit in time.
"""

import math
from collections.abc import Sequence

from hoi.data import Material
from hoi.errors import InputError
from hoi.mpm.laws import LAWS
from hoi.mpm.materials import p_wave_speed

STABLE_CFL = 0.7
"""The limit of the CFL number: just below the least of the table above [-]."""
STABLE_DIFFUSION = 0.35
"""The limit of viscosity dt / (rho dx^2) of a fluid without pressure, just below the measured one [-]."""
DEFAULT_FRACTION = 0.9
"""Share of the limit taken when no time step is given: leaves room for what happens between two looks at the state. It
pays to be near 1: what APIC damps, it damps a step."""


def stable_step(dx: float, signal_speed: float, diffusivity: float = 0.0) -> float:
    """The largest stable dt [s]: (dt signal_speed / (STABLE_CFL dx))^2 + dt diffusivity / (STABLE_DIFFUSION dx^2) = 1.

    Args:
        dx: cell size [m].
        signal_speed: c + |v|, of the deformed material if it is known [m/s].
        diffusivity: viscosity / density of a fluid [m^2/s].
    """
    by_waves = STABLE_CFL * dx / signal_speed
    by_viscosity = 0.5 * by_waves * diffusivity / (STABLE_DIFFUSION * dx**2)
    return by_waves / (math.sqrt(1 + by_viscosity**2) + by_viscosity)


def diffusivity(material: Material) -> float:
    """viscosity / density of a fluid [m^2/s]; 0 for what flows plastically, whose return map is implicit in time."""
    return material.viscosity / material.density if LAWS[material.model].viscous else 0.0


def cfl_number(material: Material | Sequence[Material], dx: float, dt: float, speed: float = 0.0) -> float:
    """(c + |v|) dt / dx: the cells that the fastest signal crosses in a step [-]."""
    return (max(p_wave_speed(m) for m in _materials(material)) + speed) * dt / dx


def time_step_limit(
    material: Material | Sequence[Material], dx: float, speed: float = 0.0, stiffening: Sequence[float] | None = None
) -> float:
    """The largest dt [s] that is stable for cells of size `dx` [m] and particles no faster than `speed` [m/s].

    Of several materials the one with the smallest step counts.

    Raises:
        InputError: a material, dx or speed that makes no sense.
    """
    return _tightest(material, dx, speed, stiffening)[0]


def choose_time_step(
    material: Material | Sequence[Material],
    dx: float,
    speed: float,
    dt: float | None = None,
    fraction: float = DEFAULT_FRACTION,
    stiffening: Sequence[float] | None = None,
) -> float:
    """The time step [s] to simulate with: `dt` if that is given and stable, else `fraction` of the limit.

    Args:
        material: what the object is made of, or what its regions are made of.
        dx: cell size [m].
        speed: of the fastest particle expected [m/s].
        dt: a fixed time step [s], or None.
        fraction: share of the limit to take when dt is None, in (0, 1].
        stiffening: of each material, the tangent over the elastic one where it loses energy (`hoi.mpm.damping`) [-].

    Raises:
        InputError: dt is above the limit, or a value makes no sense.
    """
    limit, tightest = _tightest(material, dx, speed, stiffening)
    if not 0 < fraction <= 1:
        raise InputError(f"mpm fraction of the time step limit must lie in (0, 1], got {fraction:g}")
    if dt is None:
        return fraction * limit
    if not (math.isfinite(dt) and dt > 0):
        raise InputError(f"dt must be positive and finite [s], got {dt:g}")
    if dt > limit:
        viscous = f", viscosity {tightest.viscosity:g} Pa s" if diffusivity(tightest) else ""
        raise InputError(
            f"dt must be at most {limit:.3g} s for {tightest.name} "
            f"(wave speed {p_wave_speed(tightest):.0f} m/s{viscous}) on cells of {dx:.3g} m, got {dt:g}; "
            "leave it out to have it chosen, or use larger cells"
        )
    return dt


def _materials(material: Material | Sequence[Material]) -> Sequence[Material]:
    return (material,) if isinstance(material, Material) else material


def _tightest(
    material: Material | Sequence[Material], dx: float, speed: float, stiffening: Sequence[float] | None
) -> tuple[float, Material]:
    """The limit [s] and the material that sets it."""
    if not (math.isfinite(dx) and dx > 0):
        raise InputError(f"mpm dx must be positive and finite [m], got {dx:g}")
    if not (math.isfinite(speed) and speed >= 0):
        raise InputError(f"mpm speed must be 0 or more and finite [m/s], got {speed:g}")
    stiffening = [1.0] * len(_materials(material)) if stiffening is None else stiffening
    limits = [
        (stable_step(dx, p_wave_speed(m) * math.sqrt(factor) + speed, diffusivity(m)), m)
        for m, factor in zip(_materials(material), stiffening, strict=True)
    ]
    return min(limits, key=lambda limit: limit[0])
