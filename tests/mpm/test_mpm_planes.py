"""Bodies against the ground and walls at any tilt: sliding by Coulomb's law, lying still, bouncing."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, block

from hoi.data import Array, Plane
from hoi.mpm.solver import SimulationResult, simulate
from hoi.mpm.state import initial_state

G = 9.81
STIFF = replace(RUBBER, youngs_modulus=2e5)
POINT = np.array([0.013, 0.007, 0.3])
"""A point of the plane, not on the grid."""


def tilt(degrees: float) -> Array:
    """Axes of a slope as columns: down the slope, across, normal."""
    a = np.radians(degrees)
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


def on_slope(
    degrees: float, times: Array, contact: str = "coulomb", friction: float = 0.0,
    height: float = 0.0, velocity: float = 0.0, gravity: float = G,
) -> tuple[Array, Array, SimulationResult]:  # fmt: skip
    """Way and velocity of the centre of mass along the slope's axes, (K, 3) each, of a block on it."""
    axes = tilt(degrees)
    x, volumes = block((0.25, 0.25, 0.1), DX / 2, height)
    start = initial_state((x - [0.125, 0.125, 0]) @ axes.T + POINT, volumes * STIFF.density, velocity * axes[:, 2])
    plane = Plane(POINT, axes[:, 2], contact, friction)
    result = simulate(start, volumes, STIFF, dx=DX, times=times, planes=[plane], gravity=(0, 0, -gravity))
    return (result.com - result.com[0]) @ axes, result.com_velocity @ axes, result


@pytest.mark.parametrize(
    ("degrees", "contact", "friction"),
    [(15, "coulomb", 0.1), (25, "coulomb", 0.2), (40, "coulomb", 0.4), (40, "slip", 0.0)],
)
def test_a_block_slides_down_with_what_friction_leaves(degrees, contact, friction):
    times = np.linspace(0.2, 0.6, 9)
    _, velocity, _ = on_slope(degrees, times, contact, friction)
    a = np.radians(degrees)
    acceleration = np.polyfit(times, velocity[:, 0], 1)[0]
    assert acceleration == pytest.approx(G * (np.sin(a) - friction * np.cos(a)), rel=0.04)
    assert np.abs(velocity[:, 1]).max() < 1e-3


@pytest.mark.parametrize(("degrees", "contact", "friction"), [(20, "coulomb", 0.5), (20, "stick", 0.0)])
def test_a_block_that_friction_holds_stays(degrees, contact, friction):
    """tan 20 is 0.36: once the shock of being let go has died away, it does not creep, sink or tremble."""
    way, velocity, _ = on_slope(degrees, np.linspace(0, 2, 11), contact, friction)
    assert np.abs(way[-1]).max() < 0.4 * DX
    assert np.abs(way[5:] - way[-1]).max() < 0.02 * DX
    assert np.linalg.norm(velocity[8:], axis=1).max() < 1e-2


def test_a_body_on_level_ground_lies_still():
    way, velocity, result = on_slope(0, np.linspace(0, 2, 11), friction=0.5)
    assert np.abs(way[:, :2]).max() < 1e-3 * DX
    assert np.abs(way[5:, 2] - way[-1, 2]).max() < 1e-3 * DX
    assert np.linalg.norm(velocity[8:], axis=1).max() < 3e-4
    lowest = result.final.positions[:, 2].min() - POINT[2]
    assert lowest == pytest.approx(DX / 4, abs=0.2 * DX), "where the lowest layer of particles started"


@pytest.mark.parametrize("degrees", [0, 30, 90])
def test_a_wall_sends_an_elastic_block_back(degrees):
    """Without gravity: by its own elasticity, with no more energy than it had, and straight."""
    _, velocity, result = on_slope(degrees, np.array([0, 0.3]), height=0.06, velocity=-2.0, gravity=0.0)
    assert 0.5 * 2 < velocity[-1, 2] < 2
    assert np.abs(velocity[-1, :2]).max() < 0.1
    assert (result.energy[1].sum()) < result.energy[0].sum()


def test_nothing_passes_a_corner():
    """Thrown into the corner of the ground and two walls, no particle is beyond any of them by a cell."""
    walls = [Plane(np.array([0.4, 0, 0]), np.array([-1.0, 0, 0]), "slip"), Plane(np.array([0, 0.4, 0]), -tilt(0)[1])]
    ground = Plane(np.zeros(3), tilt(0)[2], "coulomb", 0.5)
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, 0.1)
    start = initial_state(x, volumes * STIFF.density, [3, 2, -1], [2, 0, 5])
    for state in simulate(
        start, volumes, STIFF, dx=DX, times=np.linspace(0.05, 0.5, 10), planes=[ground, *walls]
    ).states:
        for plane in (ground, *walls):
            assert ((state.positions - plane.point) @ plane.normal).min() > -DX


@pytest.mark.parametrize("friction", [0.2, 0.8])
def test_a_box_slides_down_a_slope_of_the_config(composed, friction):
    """From scene.planes to the object's trajectory: at 30 degrees 0.2 lets it slide and 0.8 does not."""
    from hoi.config.validate import to_config
    from hoi.method.object_motion import free_motion
    from hoi.reports import Stages
    from hoi.runner.scene import build_scene

    axes, point = tilt(30), np.array([0, 2.0, 1.0])
    position = point + 0.201 * axes[:, 2]
    config = to_config(
        composed(
            "object=cardboard_box",
            "stage/object=mpm_coarse",
            "object.max_gaussians=1500",
            "human.gaussians=1000",
            "scene.ground=false",
            "scene.frames=12",
            "scene.contact_frame=6",
            f"scene.placement.position={position.tolist()}",
            f"scene.placement.orientation=[{np.cos(np.pi / 12)},0,{np.sin(np.pi / 12)},0]",
            f"scene.planes=[{{point:{point.tolist()},normal:{axes[:, 2].tolist()},friction:{friction}}}]",
        )
    )
    scene = build_scene(config)
    with Stages().stage("free motion", scene.frames - 1) as stage:
        trajectory, _ = free_motion(scene, config.stage.object.mover(config.object.size, 1, "cpu"), stage)
    velocity = trajectory.com_velocity @ axes
    acceleration = np.polyfit(np.arange(5, 12) / scene.fps, velocity[5:, 0], 1)[0]
    expected = G * (np.sin(np.pi / 6) - friction * np.cos(np.pi / 6)) if friction < 0.5 else 0.0
    assert acceleration == pytest.approx(expected, abs=0.15)
    assert (velocity[-1, 0] > 1) == (friction < 0.5)
