"""Viscoplasticity: clay and plastic foam, von Mises with flow that takes its time.

As `hoi.mpm.laws.von_mises`, but the stress above the bound takes its time, which `viscosity` sets: sheared at the rate
s, the material bears yield_stress / sqrt(3) + viscosity s once it flows (Bingham).
"""

from dataclasses import replace

from hoi.mpm.laws import von_mises

LAW = replace(von_mises.LAW, uses=von_mises.LAW.uses | {"viscosity"}, springs=False, order=4)
