"""Leaves out the steps that an object's motion does not need: exact flight between contacts, and rest.

A trajectory is walked in phases:

| phase | when | how |
| --- | --- | --- |
| mpm | always, unless one of the others holds | every particle, every step |
| flight | no particle can touch a plane or the collider, and the body hardly vibrates | rigid, `hoi.mpm.rigid.Flight` |
| rolling | a ball on level ground that hardly vibrates and hardly hops | rigid, `hoi.mpm.rolling.Rolling` |
| rest | every particle has been slow for a while, by its speed of fall sqrt(g size) | held where it is |

A body without strain and spin flies at once, grains and fluids too: nothing in it acts. Else flight leaves out the
vibration about the rigid motion. With its energy E_vib and the body's lowest frequency omega, no smaller than
`lowest_frequency`, its amplitude is at most sqrt(2 E_vib / M) / omega. E_vib is taken as the largest kinetic energy
about the rigid motion within half a period, when all of it has once been kinetic: so the strain with which a spin or a
plastic flow holds the body in equilibrium counts for nothing. It stays frozen in the body.

Measured on a football kicked up at 4 m/s, against the MPM of every step: 0.6% of its size off after 1.4 s and a bounce,
8% after 2.6 s and three, with any tolerance from 0.0003 to 0.003. The MPM with steps 1% shorter is off by 0.2% and 5%:
what a bounce amplifies is not the vibration left out.

A ball hardly hops while its speed along the normal stays below v = sqrt(2 g h), h the `tolerance`; what does so for
longer than the 2 v / g in which a fall goes from v to -v is held up. Its hops are left out, and its sag, which is no
more than g / omega^2; a ball that may sag by more than the tolerance is simulated.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hoi.data import Array, Material, ObjectState, Plane, Push
from hoi.mpm import rigid
from hoi.mpm.boundary import PLANE_DEPTH
from hoi.mpm.collider import Collider, Partner, joined
from hoi.mpm.materials import lame_parameters
from hoi.mpm.rolling import Rolling, bears, is_ball
from hoi.mpm.solver import Simulation

PHASES = ("mpm", "flight", "rolling", "rest")
LOOKS_A_PERIOD = 8
"""Looks at the body in a period of its lowest frequency."""
STILL = 0.1
"""How long every particle must have been slow before the body is held [s]."""
RESOLUTION = 1e-5
"""A flight ends no sooner than this before the earliest possible contact [s]."""
ROUND_OFF = 1e-12
"""Of times [s]."""
UNSTRAINED = 1e-9
"""Strain [-], spin [rad/s] and share of the speed that count for none."""


@dataclass(frozen=True)
class Surroundings:
    """What the object could touch, and how far from it a particle still does."""

    planes: Sequence[Plane]
    reach: Sequence[float]
    """Of each plane: a particle farther from it touches no node that it holds [m]."""
    collider: Collider | Partner | None = None
    """Its times are those of the walk; a partner's begin with it."""
    collider_reach: float = 0.0
    """The same for the collider [m]."""

    def moving(self, time: float) -> Collider | None:
        """The collider at a time of the walk; of a partner, where it will be if nothing is given to it any more."""
        if self.collider is None or isinstance(self.collider, Collider):
            return self.collider
        seen = self.collider.foreseen()
        return replace(seen, times=time + seen.times)

    def touched(self, positions: Array) -> list[int]:
        """The planes that any of the particles (P, 3) is in reach of."""
        heights = [((positions - plane.point) @ plane.normal).min() for plane in self.planes]
        return [i for i, (height, reach) in enumerate(zip(heights, self.reach, strict=True)) if height <= reach]

    def without(self, index: int) -> "Surroundings":
        """All but that plane."""
        kept = [i for i in range(len(self.planes)) if i != index]
        return replace(self, planes=[self.planes[i] for i in kept], reach=[self.reach[i] for i in kept])


@dataclass
class Tally:
    """What a walk did and what it left out."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PHASES, 0.0))
    """Time of the object in each phase [s]."""
    changes: int = 0
    """Of phase."""
    vibration: float = 0.0
    """Largest amplitude left out, relative to the object's size [-]."""
    energy: float = 0.0
    """Kinetic energy left out [J]."""
    drag_left_out: float = 0.0
    """Bound of the way that the air would have moved it by the end where it did not act: in the MPM, and in flights
    that it would have moved too little [m]."""
    steps: int = 0
    first_step: float = math.inf
    """The time step with which the walk begins, taken or not [s]."""
    cfl: float = 0.0
    dt_least: float = math.inf
    dt_most: float = 0.0
    compile_seconds: float = 0.0
    pushes: list[Push] = field(default_factory=list)
    """What the collider gave, at times of the walk."""

    def add(self, simulation: Simulation, began: float) -> None:
        """Counts a simulation that is over; `began` is the time of the walk at which it started [s]."""
        self.steps += simulation.steps
        self.cfl = max(self.cfl, simulation.cfl)
        self.dt_least = min(self.dt_least, simulation.dt_least)
        self.dt_most = max(self.dt_most, simulation.dt_most)
        self.compile_seconds += simulation.compile_seconds
        self.pushes = joined([*self.pushes, *joined(simulation.pushes, began)])

    @property
    def steps_left_out(self) -> float:
        """Time not simulated over the mean time step; where none was taken, over the one it began with."""
        left_out = sum(seconds for phase, seconds in self.seconds.items() if phase != "mpm")
        return left_out / (self.seconds["mpm"] / self.steps if self.steps else self.first_step)


def reach_of(plane: Plane, dx: float, width: int = 3, depth: float = PLANE_DEPTH) -> float:
    """How far from a plane a particle's stencil still meets a node that the plane holds [m].

    A stencil of `width` nodes reaches half as many cells along each axis. The nodes held lie deeper than `depth` cells,
    and in layers a whole cell apart where the plane is parallel to them.
    """
    normal, depth = plane.normal, depth * dx
    if np.abs(normal).max() > 1 - 1e-12:
        height = float(plane.point @ normal)
        depth = height - math.floor((height - depth) / dx + 1e-6) * dx
    return 0.5 * width * dx * float(np.abs(normal).sum()) - depth


def lowest_frequency(positions: Array, masses: Array, materials: Sequence[Material]) -> float:
    """A lower bound of the angular frequency of a body's vibrations [rad/s]: 4 c_s h / l^2.

    l and h are its largest and smallest extent along its principal axes, c_s the slowest shear wave. A free cube has
    4.05 c_s / l, a ball 5.0, a square bar 10 c_s h / l^2 in bending; bodies with thin necks may be slower than this.
    """
    arms = positions - masses @ positions / masses.sum()
    _, axes = np.linalg.eigh((masses[:, None] * arms).T @ arms)
    extents = np.ptp(arms @ axes, axis=0)
    slowest = min(math.sqrt(lame_parameters(material)[0] / material.density) for material in materials)
    return 4 * slowest * float(extents.min() / extents.max() ** 2)


class Walk:
    """A trajectory, walked from one time to the next.

    Args:
        state: where it starts, at time 0.
        masses: of the particles [kg], shape (P,).
        start: makes the MPM simulation that goes on from (state, time of the walk).
        end: when the walk ends [s].
        gravity: [m/s^2], shape (3,).
        surroundings: what the object could touch.
        size: of the object [m].
        moment: D, second moment of the spline's weights [m^2].
        frequency: lower bound of the body's own [rad/s]; None where, once touched, it never flies as one piece
            (grains, fluids).
        tolerance: amplitude of vibration, and way crept, that may be left out, relative to `size`; None leaves out
            nothing.
        drag: k of `hoi.mpm.rigid.Flight` [1/m]; left out of a flight that it would move by less than `tolerance`.
        held: it lies still at first, where nothing will push it, and stays so until `wake`.
    """

    def __init__(
        self, state: ObjectState, masses: Array, start: Callable[[ObjectState, float], Simulation], *, end: float,
        gravity: Array, surroundings: Surroundings, size: float, moment: float, frequency: float | None,
        tolerance: float | None, drag: float = 0.0, held: bool = False,
    ) -> None:  # fmt: skip
        self.time, self.phase, self.tally = 0.0, "mpm", Tally()
        self.here, self._masses, self._start, self._end = state, masses, start, end
        self.gravity, self._around = np.asarray(gravity, dtype=np.float64), surroundings
        self._size, self._moment, self._frequency = size, moment, frequency
        self._drag, self.simulated = drag, False
        self._tolerance, self.between_looks = 0.0, math.inf  # no looks
        if tolerance is not None:
            self._tolerance = tolerance
            self.between_looks = (2 * math.pi / frequency if frequency else STILL) / LOOKS_A_PERIOD
        self._ground = self._rolls_on()
        if (
            held
            and tolerance is not None
            and not will_be_pushed(state.positions, surroundings.moving(0.0), 0.0, surroundings.collider_reach)
        ):
            self.phase = "rest"
            return
        self._begin_mpm()
        self.tally.first_step = self.simulation.time_step()
        if tolerance is not None and unstrained(state) and not self._around.touched(state.positions):
            self._fly(rigid.fit(state, masses, moment))

    def advance(self, until: float) -> tuple[ObjectState, str]:
        """The state at time `until`, and the phase that led there."""
        moved_by = self.phase
        while self.time < until:
            moved_by = self.phase
            if self.phase == "mpm":
                self.simulate(until)
            elif self.phase == "rest":
                self._pass(until)
            else:
                self._follow(min(until, self.path_ends))
        return self.here, moved_by

    def finish(self) -> Tally:
        """The tally of the whole walk."""
        if self.phase == "mpm":
            self.tally.add(self.simulation, self.began)
        return self.tally

    def wake(self) -> None:
        """Simulates from now on what flies, rolls or rests."""
        if self.phase != "mpm":
            self.phase = "mpm"
            self.tally.changes += 1
            self._begin_mpm()

    def _begin_mpm(self) -> None:
        self.simulation, self.began, self.simulated = self._start(self.here, self.time), self.time, True
        self.forget()

    def forget(self) -> None:
        """What was seen of it so far says nothing of how it goes on."""
        self._vibration: list[float] = []  # energies about the rigid motion, since it has been free or rolled
        self._still_since = self._held_since = math.inf
        self._last_look = self.time

    def simulate(self, until: float) -> None:
        # No step is cut short for a look at the body: what it does depends on the length of the steps.
        self.simulation.step_towards(until - self.began, self.between_looks)
        self.count_steps(until)
        self._look(until)

    def count_steps(self, until: float) -> None:
        """Takes note of steps of the simulation, whoever took them, on the way to `until` [s]."""
        now = self.began + self.simulation.time
        _, fastest = self.simulation.bounds()
        self.tally.drag_left_out += self._drag * fastest**2 * (now - self.time) * (self._end - self.time)
        self._pass(until if until - now < ROUND_OFF else now)

    def _look(self, until: float) -> None:
        looks = self.time - self._last_look > 0.99 * self.between_looks
        if looks:
            self._last_look = self.time
            box, _ = self.simulation.bounds()
            rests = self.rests()
            if not rests and (self._frequency is None or self._around.touched(box) not in ([], [self._ground])):
                self._vibration.clear()
                self._held_since = math.inf
                looks = False  # nothing to decide: the particles stay on the device
        if looks or self.time == until:
            self.take_state()
        if looks and rests:
            self.hold()
        elif looks and self._frequency is not None:
            self._consider_going_rigid(self._frequency)

    def take_state(self) -> None:
        """Has the state of the simulation as its own."""
        self.here = self.simulation.state()

    def _follow(self, until: float) -> None:
        self.here = rigid.carry(self.path, self.departed, until - self.departure)
        self._pass(until)
        if until >= self.path_ends:
            self.wake()

    def _pass(self, until: float) -> None:
        self.tally.seconds[self.phase] += until - self.time
        partner = self._around.collider
        if self.phase != "mpm" and partner is not None and not isinstance(partner, Collider):
            partner.advance(until - self.time)
        self.time = until

    def _leave_mpm(self, phase: str, energy: float) -> None:
        self.phase = phase
        self.tally.changes += 1
        self.tally.energy += energy
        self.tally.add(self.simulation, self.began)

    def rests(self) -> bool:
        """Whether, for a while, no particle has been faster than `tolerance` times sqrt(g size), its speed in a fall,
        and no limb will come.

        That the speed stays low for `STILL` bounds the acceleration too: what is not supported falls out of it.
        """
        if math.isinf(self.between_looks):
            return False
        box, speed = self.simulation.bounds()
        slow = speed <= self._tolerance * math.sqrt(float(np.linalg.norm(self.gravity)) * self._size)
        if not slow or will_be_pushed(box, self._around.moving(self.time), self.time, self._around.collider_reach):
            self._still_since = math.inf
        else:
            self._still_since = min(self._still_since, self.time)
        return self.time - self._still_since >= STILL

    def hold(self) -> None:
        state = self.here
        self._leave_mpm("rest", 0.5 * float(self._masses @ (state.velocities**2).sum(axis=1)))
        self.here = replace(state, velocities=0 * state.velocities, affine=0 * state.affine)

    def _rolls_on(self) -> int | None:
        """The plane that a ball may roll on."""
        sag = float(np.linalg.norm(self.gravity)) / (self._frequency or math.inf) ** 2
        if not 0 < sag <= self._tolerance * self._size or not is_ball(self.here.positions, self._masses):
            return None
        level = (i for i, plane in enumerate(self._around.planes) if bears(plane, self.gravity))
        return next(level, None)

    def _consider_going_rigid(self, frequency: float) -> None:
        state, half_period = self.here, LOOKS_A_PERIOD // 2
        motion = rigid.fit(state, self._masses, self._moment)
        rolls = bool(self._around.touched(state.positions))
        gravity = float(np.linalg.norm(self.gravity))
        hops = math.sqrt(2 * gravity * self._tolerance * self._size)
        along_normal = abs(float(motion.velocity @ self.gravity)) / gravity if rolls else 0.0
        if rolls != math.isfinite(self._held_since) or along_normal > hops:
            self._vibration.clear()
            self._held_since = self.time if rolls and along_normal <= hops else math.inf
        if along_normal > hops:
            return
        self._vibration.append(rigid.vibration_energy(state, self._masses, self._moment, motion))
        largest = max(self._vibration[-half_period - 1 :])
        amplitude = math.sqrt(2 * largest / motion.mass) / frequency / self._size
        if len(self._vibration) <= half_period or amplitude > self._tolerance:
            return
        if rolls and self.time - self._held_since <= 2 * hops / gravity:
            return
        went = self._roll if rolls else self._fly
        if went(motion, self._vibration[-1]):
            self.tally.vibration = max(self.tally.vibration, amplitude)

    def _roll(self, motion: rigid.RigidMotion, energy: float) -> bool:
        assert self._ground is not None
        rolling = Rolling(motion, self._around.planes[self._ground], self.gravity, self._drag, self._moment)
        hopping = float(np.linalg.norm(motion.velocity - rolling.velocity(0.0)))
        energy += 0.5 * motion.mass * hopping**2
        return self._go("rolling", rolling, self._around.without(self._ground), energy)

    def _fly(self, motion: rigid.RigidMotion, energy: float = 0.0) -> bool:
        longest = self._end - self.time
        fastest = float(np.linalg.norm(motion.velocity)) + float(np.linalg.norm(self.gravity)) * longest
        moved = 0.5 * self._drag * fastest**2 * longest**2
        drag = self._drag if moved > self._tolerance * self._size else 0.0
        if not self._go("flight", rigid.Flight(motion, self.gravity, drag), self._around, energy):
            return False
        if not drag:
            self.tally.drag_left_out += moved
        return True

    def _go(self, phase: str, path: rigid.Path, around: Surroundings, energy: float) -> bool:
        """Follows a path where it is long enough to be worth it; `energy` is what it leaves out [J]."""
        longest = self._end - self.time
        hull = rigid.hull(self.here.positions - path.motion.com)
        alone = first_contact(path, hull, around, self.time, longest)
        ends = self.time + alone if alone < longest else math.inf
        if ends <= self.time + self.between_looks:
            return False
        self.path, self.departed, self.departure, self.path_ends = path, self.here, self.time, ends
        self._leave_mpm(phase, energy)
        return True


def unstrained(state: ObjectState) -> bool:
    """Whether no particle is strained and all have one velocity, to round-off: nothing in the body acts, or will."""
    return bool(
        (abs(state.deformation_gradient - np.eye(3)) < UNSTRAINED).all()
        and (state.elastic is None or (abs(state.elastic - np.eye(3)) < UNSTRAINED).all())
        and (np.ptp(state.velocities, axis=0) <= UNSTRAINED * (1 + abs(state.velocities).max())).all()
        and (abs(state.affine) < UNSTRAINED).all()
    )


def first_contact(path: rigid.Path, hull: Array, around: Surroundings, start: float, longest: float) -> float:
    """How long from its start a body can go on with no particle in reach of a plane or the collider [s].

    Conservative advancement: from each instant on it flies for as long as the gap is sure to last, that of its convex
    hull with every vertex at the greatest possible speed, or that of the ball around it, which does not turn.

    Args:
        path: rigid motion.
        hull: vertices of the body about its centre of mass at the start [m], shape (V, 3).
        around: what it could touch.
        start: the time of the walk at which the path starts [s].
        longest: the answer is no longer than this [s].
    """
    radius = float(np.linalg.norm(hull, axis=1).max())
    time, moving = 0.0, around.moving(start)
    while time < longest:
        com, velocity = path.com(time), path.velocity(time)
        unsteady = path.unsteadiness(time)
        vertices = hull @ path.rotation(time).T
        sure = math.inf
        for plane, reach in zip(around.planes, around.reach, strict=True):
            height = float((com - plane.point) @ plane.normal) - reach
            rate, acceleration = float(velocity @ plane.normal), float(path.gravity @ plane.normal) - unsteady
            ball = time_to_close(height - radius, rate, acceleration)
            turning = rate - path.fastest * radius
            sure = min(sure, max(ball, time_to_close(height + (vertices @ plane.normal).min(), turning, acceleration)))
        if moving is not None and start + time < moving.times[-1]:
            gap, speed = _gap_to_collider(moving, com, start + time)
            rate = -float(np.linalg.norm(velocity)) - speed
            gap -= radius + around.collider_reach
            sure = min(sure, time_to_close(gap, rate, -float(np.linalg.norm(path.gravity)) - unsteady))
        if sure < RESOLUTION:
            return time
        time += sure
    return longest


def will_be_pushed(box: Array, collider: Collider | None, time: float, reach: float) -> bool:
    """Whether a capsule comes within `reach` [m] of what lies still in a box, its corners (8, 3), from `time` on."""
    if collider is None or time >= collider.times[-1]:
        return False
    first = max(int(np.searchsorted(collider.times, time, side="right")) - 1, 0)
    ends = np.stack([collider.starts[first:], collider.ends[first:]])
    swept = np.concatenate([ends[:, :-1], ends[:, 1:]])  # each capsule from one time to the next
    low, high = swept.min(axis=0) - collider.radii[:, None], swept.max(axis=0) + collider.radii[:, None]
    apart = np.maximum(low - box.max(axis=0), box.min(axis=0) - high).max(axis=-1)
    return bool((apart < reach).any())


def time_to_close(gap: float, rate: float, acceleration: float) -> float:
    """The first t >= 0 with gap + rate t + acceleration t^2/2 <= 0; infinite when there is none [s]."""
    if gap <= 0:
        return 0.0
    under = rate**2 - 2 * acceleration * gap
    if under < 0 or (rate >= 0 and acceleration >= 0):
        return math.inf
    # the stable form of the smaller positive root
    ahead = -rate + math.sqrt(under)
    return 2 * gap / ahead if ahead > 0 else math.inf


def _gap_to_collider(collider: Collider, point: Array, time: float) -> tuple[float, float]:
    """Distance of `point` to the nearest capsule [m], and the greatest speed of any capsule at any time [m/s].

    Before their first time the capsules count as already there.
    """
    after = int(np.clip(np.searchsorted(collider.times, time), 1, len(collider.times) - 1))
    span = np.diff(collider.times)
    share = np.clip((time - collider.times[after - 1]) / span[after - 1], 0, 1)
    starts, ends = (a[after - 1] + share * (a[after] - a[after - 1]) for a in (collider.starts, collider.ends))
    axes = ends - starts
    along = ((point - starts) * axes).sum(-1) / np.maximum((axes**2).sum(-1), np.finfo(float).tiny)
    nearest = starts + np.clip(along, 0, 1)[:, None] * axes
    gap = float((np.linalg.norm(point - nearest, axis=-1) - collider.radii).min())
    moved = np.linalg.norm(np.diff([collider.starts, collider.ends], axis=1), axis=-1)
    return gap, float((moved / span[:, None]).max())
