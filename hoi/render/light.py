"""Light on Gaussians that know the surface they lie on: a sky, the ground's bounce and a soft key light, frame by
frame.

    shown = sRGB(albedo (A E_sky(m) + S V(n, b) K(n)))

n: unit normal; b: mean direction of open sky, as long as its share a (`hoi.data.GaussianCloud`); m: half-way between
both, which is where the light that still arrives comes from. E_sky is the irradiance of a sky that brightens upwards
over a ground that sends some back, in closed form; A the ambient share, with what surfaces of the albedo's colour
throw back into their own creases (Jimenez et al. 2016); K the key light's cosine, softened by its size; V how much of
the key light the cone of open sky around b lets in (Oat and Sander 2007); S what others leave of it
(`hoi.render.shadows`), without a gradient. All else is differentiable in n, b and the albedo. Light adds up linearly;
sRGB as in IEC 61966-2-1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hoi.data import GaussianCloud
from hoi.gaussians import SH_C0
from hoi.render.splats import Splats, from_cloud

RGB = tuple[float, float, float]
_CONE = 0.7
"""How far across the rim of the cone of open sky the key light fades [-], as a cosine."""


@dataclass(frozen=True)
class Light:
    """Irradiances over pi: what a white surface sends on."""

    zenith: float = 0.80
    """Of the sky straight above."""
    horizon: float = 0.46
    ground: float = 0.30
    """What the ground sends back."""
    key: float = 0.95
    towards: RGB = (0.62, 0.36, 0.70)
    """The key light, seen from the scene; of any length."""
    softness: float = 0.22
    """How far beyond 90 degrees the key light reaches around a surface [-], as a cosine."""
    sky_tint: RGB = (0.96, 1.0, 1.06)
    ground_tint: RGB = (1.06, 1.0, 0.92)
    key_tint: RGB = (1.04, 1.0, 0.94)

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector towards the key light."""
        unit = np.array(self.towards) / np.linalg.norm(self.towards)
        return tuple(unit.tolist())


DAY = Light()


def sky(light: Light, normals: Tensor) -> Tensor:
    """E_sky: cosine-weighted mean radiance over the hemisphere about unit normals (..., 3), RGB (..., 3).

    Radiance is horizon + (zenith - horizon) d_z above, ground below. With the angle t from n to straight up, the
    constant's share is (1 + cos t) / 2, and that of d_z is 2 / (3 pi) (sin t + (pi - t) cos t).
    """
    cosine = normals[..., 2:].clamp(-1 + 1e-6, 1 - 1e-6)  # the slopes of sin t and of t would be endless beyond
    rise = 0.5 * (1 + cosine)
    slope = 2 / (3 * math.pi) * ((1 - cosine**2).sqrt() + (math.pi - cosine.acos()) * cosine)
    above = light.horizon * rise + (light.zenith - light.horizon) * slope
    return above * normals.new_tensor(light.sky_tint) + light.ground * (1 - rise) * normals.new_tensor(
        light.ground_tint
    )


def irradiance(light: Light, surface: Tensor, albedo: Tensor, shadow: Tensor | None = None) -> Tensor:
    """What arrives, over pi, RGB (N, 3).

    Args:
        surface: normals and openness, (N, 2, 3).
        albedo: linear RGB, (N, 3).
        shadow: S, (N,); None: nothing is in the way.
    """
    normal, openness = surface.unbind(-2)
    share = openness.norm(dim=-1, keepdim=True).clamp(1e-3, 1.0)
    bent = openness / share
    half = torch.nn.functional.normalize(normal + bent + 1e-6, dim=-1)
    a, b, c = 2.0404 * albedo - 0.3324, -4.7951 * albedo + 0.6417, 2.7552 * albedo + 0.6903
    ambient = torch.maximum(share, ((share * a + b) * share + c) * share)
    towards = normal.new_tensor(light.direction)
    facing = ((normal @ towards + light.softness) / (1 + light.softness)).clamp_min(0)
    # Of a cosine-weighted hemisphere the cone about b with half angle t holds sin^2 t.
    into = ((bent @ towards - (1 - share[:, 0]).clamp_min(1e-4).sqrt()) / _CONE + 0.5).clamp(0, 1)
    key = light.key * facing * into * into * (3 - 2 * into)
    key = key if shadow is None else key * shadow
    return sky(light, half) * ambient + key[:, None] * normal.new_tensor(light.key_tint)


def lit(splats: Splats, light: Light | None = DAY, shadow: Tensor | None = None) -> Splats:
    """Gaussians as they are seen in a light. Those without a surface are returned as they are, and without a light the
    albedo is what is seen."""
    if splats.surface is None:
        return splats
    if light is None:
        return replace(splats, surface=None)
    albedo = to_linear((0.5 + SH_C0 * splats.sh[:, 0]).clamp(0, 1))
    shown = to_shown(albedo * irradiance(light, splats.surface, albedo, shadow))
    return replace(splats, sh=((shown - 0.5) / SH_C0)[:, None], turns=None, surface=None)


def relit(splats: Splats, light: Light, normals: Tensor, shadow: Tensor | None = None) -> Splats:
    """Captured Gaussians, whose colours hold a light already, with this light as a gain that keeps their mean.

    Args:
        normals: unit, (N, 3).
    """
    grey = torch.full_like(normals, 0.5)
    gain = irradiance(light, torch.stack([normals, normals], -2), grey, shadow)
    gain = gain.sqrt()  # colours are as shown, roughly the root of what is linear
    gain = gain / gain.mean(0)
    first = (gain * (0.5 + SH_C0 * splats.sh[:, 0]) - 0.5) / SH_C0
    return replace(splats, sh=torch.cat([first[:, None], gain[:, None] * splats.sh[:, 1:]], 1))


def lit_cloud(cloud: GaussianCloud, light: Light | None = DAY) -> GaussianCloud:
    """A cloud as it is seen in a light, for files and programs that know none."""
    if cloud.surface is None:
        return cloud
    with torch.no_grad():
        return replace(cloud, sh=lit(from_cloud(cloud), light).sh.numpy(), surface=None)


def lit_parts(parts: Sequence[Splats], light: Light | None = DAY) -> list[Splats]:
    """Each part lit, without shadows."""
    return [lit(part, light) for part in parts]


def to_linear(shown: Tensor) -> Tensor:
    """sRGB as shown, in [0, 1], to linear."""
    return torch.where(shown <= 0.04045, shown / 12.92, ((shown.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def to_shown(linear: Tensor) -> Tensor:
    """The inverse of `to_linear`, also above 1."""
    return torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)
