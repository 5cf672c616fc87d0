"""What a film looks like: light, shadows, edges, ground. All of it by config, and none of it in what a run computes."""

from dataclasses import dataclass

from hoi.render import Ground
from hoi.render.light import DAY, Light
from hoi.render.rasterise import Settings


@dataclass(frozen=True)
class Look:
    """How the Gaussians of a run are shown."""

    light: Light | None = DAY
    """None: albedo as it is, and the sky's shadows alone."""
    shadows: bool = True
    """Whether person and object keep the key light from each other and from the floor."""
    antialiased: bool = True
    """See `hoi.render.rasterise.Settings`."""
    ground: Ground | None = None
    """None: the scene's own."""

    @property
    def settings(self) -> Settings:
        return Settings(antialiased=self.antialiased)


USUAL = Look()
BARE = Look(light=None, antialiased=False, ground=Ground.plain)
"""Albedo on a plain floor, by 3DGS's own conventions."""
