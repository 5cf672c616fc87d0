"""How a person goes on with a motion when it is pushed: what muscles and the ground can do, and no more.

The motion that was made is followed by computed torque: forces that would keep it exactly, and beside them springs and
dampers in every joint and, through the feet, against the ground, which bring the person back to it. Those are bounded,
those in the joints by what people's muscles give, those at the feet by Coulomb's law and by the length of the stance.
Without a push nothing of this acts, and the person moves as it was told to.
"""

# MuJoCo brings no types.
# pyright: reportAttributeAccessIssue=false

import copy
import math
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hoi.body.articulated import ROOT, Articulated
from hoi.body.interpolate import interpolate_motion
from hoi.body.skinning import joint_paths, stand_motion
from hoi.body.strength import FEET, LOW, SOLE_FRICTION, torque_limits
from hoi.data import Array, Body, Motion
from hoi.errors import RunError

STEP = 0.4
"""How far from its stance a person puts a foot to keep its balance: there the ground can push up too [m]."""
LONGEST_STEP = 0.001
"""Of the person [s]."""
SOFTEST = 0.2
"""The least share of its pull that is left to a spring whose muscles are at their limit [-]."""
WHIPPED = 50.0
"""A joint that turns faster than told by this is beyond what it was made for [rad/s]: the fastest that people turn one
in sports (the elbow of a pitcher: 40; knees and hips in kicks: 30) ..."""
TISSUE = 0.02
"""... and its ligaments brake it within this time [s]."""
TURN_A_STEP = 0.05
"""The furthest that anything turns in a step [rad]."""
FASTEST = 1000.0
"""... and how fast [rad/s]."""
RECOVERED = 4.744
"""omega t at which a critically damped deviation has fallen to 5%: (1 + x) exp(-x)."""
SETTLED = 1e-4
"""A person is back on its motion when no coordinate is further from it than this [m, rad], and no rate further from its
own than this times omega."""


@dataclass(frozen=True)
class Ground:
    """What carries a person at an instant."""

    centre: Array
    """Between the feet that stand [m], (3,)."""
    reach: float
    """How far from it the ground can push up [m]."""


class Person:
    """A person on its way along a motion.

    Args:
        start: where on the motion it begins [s].
        gravity: [m/s^2], positive downwards.
        recovery: how long it takes to make good 95% of a small push [s].
        one_piece: s, see `hoi.body.articulated.Articulated.mobility`.

    `time` is where it is [s]; `q` and `rates` are its pose and their change as in `hoi.body.articulated`.

    Raises:
        RunError: the person has no volume.
    """

    def __init__(
        self, body: Body, motion: Motion, *, start: float, gravity: float, recovery: float, one_piece: float
    ) -> None:
        self.body, self.parts = body, Articulated(body)
        self.motion, self.gravity, self.one_piece = motion, gravity, one_piece
        self.frequency = RECOVERED / recovery
        self.time = self._start = start
        duration = (len(motion) - 1) / motion.fps - start
        count = max(math.ceil(duration / LONGEST_STEP - 1e-9), 1)
        self._tick = max(duration, LONGEST_STEP) / count
        frames = np.clip((start + self._tick * np.arange(count + 1)) * motion.fps, 0, len(motion) - 1)
        self._path = self.parts.coordinates(motion, frames)
        self._speeds = [self.parts.difference(a, b) / self._tick for a, b in pairwise(self._path)]
        self._limits = self.parts.mass * torque_limits(self.parts.links[1:])
        joints = joint_paths(body, motion)
        standing = joint_paths(body, stand_motion(body, 1, motion.fps))[0, :, 2]
        self._ground = _grounds(joints, standing)
        self.q, self.rates, self._told = self._path[0].copy(), self._speeds[0].copy(), self._speeds[0].copy()
        self._now, self._ghost = self._path[0], mujoco.MjData(self.parts.model)
        self.kept = [(self.time, self.q.copy())]
        """(time, pose) after each `advance`."""
        self.ground_impulse = np.zeros(3)
        """Of the ground so far, and of whatever else a motion needs that no ground gives [N s], (3,)."""
        self.work = 0.0
        """Of the muscles so far, and of what else the motion needs [J]."""
        self._settle_workspace()
        self._heft = self.parts.inertia().diagonal().copy()
        """Of what hangs on each joint, about it, at the start [kg m^2], (nv,)."""

    def _settle_workspace(self) -> None:
        self.parts.place(self.q, self.rates)
        self._mobility: Array | None = None

    @property
    def mobility(self) -> Array:
        """B at the present pose, (nv, nv)."""
        if self._mobility is None:
            self._mobility = self.parts.mobility(self.one_piece)
        return self._mobility

    def velocity(self, joint: int, point: Array) -> Array:
        """J q' [m/s], (3,), of a point [m] of the part that `joint` moves."""
        return self.parts.jacobian(joint, point)[:3] @ self.rates

    def inverse_mass(self, joint: int, point: Array, normal: Array) -> float:
        """1 / m_eff = n J B J^T n [1/kg] of a point of the part that `joint` moves, struck along `normal`."""
        row = normal @ self.parts.jacobian(joint, point)[:3]
        return float(row @ self.mobility @ row)

    def push(self, joint: int, point: Array, impulse: Array) -> None:
        """Gives a point [m] of the part that `joint` moves an impulse [N s], (3,)."""
        self.give(impulse @ self.parts.jacobian(joint, point)[:3])

    def give(self, impulse: Array) -> None:
        """Gives a generalised impulse (nv,), J^T p."""
        self.turn_to(self.rates + self.mobility @ impulse)

    def turn_to(self, rates: Array) -> None:
        """Gives it these rates (nv,)."""
        if (rates != self.rates).any():
            self.rates = rates
            self._settle_workspace()

    def twin(self) -> "Person":
        """Another at the same place, which goes on by itself."""
        other = copy.copy(self)
        other.parts = copy.copy(self.parts)
        other.parts.data, other._ghost = mujoco.MjData(self.parts.model), mujoco.MjData(self.parts.model)
        other.kept, other.ground_impulse = [], self.ground_impulse.copy()
        other._settle_workspace()
        return other

    @property
    def end(self) -> float:
        """The time of the motion's last frame [s]."""
        return (len(self.motion) - 1) / self.motion.fps

    def kinetic_energy(self) -> float:
        """[J]"""
        return float(0.5 * self.rates @ self.parts.inertia() @ self.rates)

    def told(self, time: float) -> Array:
        """The pose that the motion has at a time [s], (nq,)."""
        ticks = (time - self._start) / self._tick
        tick = int(np.clip(ticks, 0, len(self._speeds) - 1))
        ahead = min(ticks - tick, 1.0) * self._tick
        return self._path[tick] if ahead < 1e-12 else self.parts.moved(self._path[tick], self._speeds[tick], ahead)

    @property
    def settled(self) -> bool:
        """Whether it is back on its motion."""
        apart = abs(self.parts.difference(self.q, self.told(self.time))).max()
        return bool(apart < SETTLED and abs(self.rates - self._told).max() < SETTLED * self.frequency)

    def advance(self, seconds: float) -> None:
        """Moves the person on, in steps no longer than LONGEST_STEP, shorter where it is thrown about.

        Raises:
            RunError: it is thrown about faster than can be followed.
        """
        until = self.time + seconds
        while self.time < until:
            fastest = float(abs(self.rates[3:]).max())
            if not fastest <= FASTEST:
                raise RunError(
                    f"the person is thrown about at {fastest:.3g} rad/s, {self.time:.3f} s into the motion, where "
                    f"{FASTEST:g} can be followed; use a slower strike, or stage.contact.limb=infinite"
                )
            left = until - self.time
            steps = math.ceil(left / min(LONGEST_STEP, TURN_A_STEP / max(fastest, 1e-9)) - 1e-9)
            self._step(left / steps)
            if steps == 1:
                self.time = until
        self.kept.append((self.time, self.q.copy()))

    def _step(self, h: float) -> None:
        """One step: M (q'_1 - q'_0) = h (f + tau - C), q <- q + h q'_1.

        f is what the motion takes where it should be. tau is what it takes besides to go on with it from where the body
        is, and to bring every deviation back as a critically damped spring would after the step, which is stable
        however stiff that is; as far as muscles and the ground give it. The weight is left out of both: it is carried
        in every pose as it was in the motion's.
        """
        parts = self.parts
        now, self._now = self._now, self.told(self.time + h)
        told = parts.difference(now, self._now) / h
        apart, rate = parts.difference(self.q, now), self._told - self.rates
        stiff = (h * self.frequency) ** 2
        back = rate - (rate - h * self.frequency**2 * apart) / (1 + 2 * h * self.frequency + stiff)
        change = told - self._told
        parts.place(now, self._told, self._ghost)
        taken = parts.impulse(change, h, self._ghost)
        taken[3:ROOT] = self._turn.T @ self._ghost.xmat[1].reshape(3, 3) @ taken[3:ROOT]
        inertia = parts.inertia()
        change += self._given((parts.impulse(change, h) - taken) / h, back, inertia, h)
        rates = self.rates + change
        whipped = abs(self.rates - told)[ROOT:] > WHIPPED
        if whipped.any():
            system = inertia.copy()
            system[np.diag_indices_from(system)] += h / TISSUE * self._heft * np.concatenate([np.zeros(ROOT), whipped])
            rates = told + cho_solve(cho_factor(system), inertia @ (rates - told))
            change = rates - self.rates
        acted, lifted = parts.impulse(change, h), parts.mass * self.gravity * h
        middle = 0.5 * (rates + self.rates)
        self.ground_impulse += acted[:3]
        self.ground_impulse[2] += lifted
        self.work += float(acted @ middle) + lifted * float(parts.rise() @ middle)
        self.q, self.rates, self._told = parts.moved(self.q, rates, h), rates, told
        self.time += h
        self._settle_workspace()

    @property
    def _turn(self) -> Array:
        """Of the pelvis, from its own axes to the world's, (3, 3)."""
        return self.parts.data.xmat[1].reshape(3, 3)

    def _given(self, on: Array, back: Array, inertia: Array, h: float) -> Array:
        """What the rates change by, (nv,), besides as told, where muscles and the ground give no more than they can.

        Where a joint would have to give more than its muscles, the pull is softer in all joints: so it stays that of a
        spring towards the motion. Cut down joint by joint it would not, and could drive the body instead. Where the
        ground gives less, the joints bend as they would, and the pelvis goes where that takes it.

        Args:
            on: what it takes to go on from here, (nv,) [N, N m]. back: what the rates are to change by, (nv,), in the
            time h, to come back. inertia: M.
        """
        pull = inertia @ back / h
        needs, pulls = (np.sqrt((part[ROOT:].reshape(-1, 3) ** 2).sum(axis=1)) for part in (on, pull))
        softer = float(np.clip((self._limits - needs) / np.maximum(pulls, 1e-12), SOFTEST, 1.0).min())
        wrench = (on + softer * pull)[:ROOT]
        change = softer * back
        less = self._from_ground(wrench) - wrench
        if less.any():
            change[:ROOT] += h * np.linalg.solve(inertia[:ROOT, :ROOT], less)
        return change

    def _from_ground(self, wrench: Array) -> Array:
        """A force [N] in the world and a torque [N m] in the pelvis' axes, (6,), as far as the feet can give them.

        Coulomb's law bounds what goes along the ground, the weight what presses on it, and weight times the length of
        the stance what turns.
        """
        ground = self._ground[round(min(self.time * self.motion.fps, len(self._ground) - 1))]
        if ground is None:
            return np.zeros(ROOT)
        weight, turn = self.parts.mass * self.gravity, self._turn
        arm, force = self.q[:3] - ground.centre, wrench[:3].copy()
        torque = turn @ wrench[3:] + _cross(arm, force)  # about where the feet stand
        force[:2] *= _share(SOLE_FRICTION * weight, force[:2])
        force[2:] *= _share(weight, force[2:])
        torque[:2] *= _share(weight * ground.reach, torque[:2])
        torque[2:] *= _share(SOLE_FRICTION * weight * ground.reach, torque[2:])
        return np.concatenate([force, turn.T @ (torque - _cross(arm, force))])

    def motion_made(self) -> Motion:
        """The motion with what became of it: at every frame from the start on, the pose that the person had then.

        Frames that were not reached by `advance` keep the motion's pose.
        """
        fps = self.motion.fps
        times = np.array([time for time, _ in self.kept])
        frames = [f for f in range(len(self.motion)) if f / fps > self._start + 1e-9 and f / fps <= self.time + 1e-9]
        if not frames:
            return self.motion
        poses = np.stack([self.kept[int(abs(times - f / fps).argmin())][1] for f in frames])
        like = interpolate_motion(self.motion, frames)
        made = self.parts.motion(poses, like)
        parts = [np.array(part) for part in (self.motion.translation, self.motion.orientation, self.motion.body_pose)]
        for part, new in zip(parts, (made.translation, made.orientation, made.body_pose), strict=True):
            part[frames] = new
        return Motion(*parts, fps=fps)


def _share(most: float, vector: Array) -> float:
    return min(1.0, most / max(math.hypot(*vector), 1e-12))


def _cross(a: Array, b: Array) -> Array:
    """`numpy.cross` of two vectors, without its overhead."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _grounds(joints: Array, standing: Array) -> list[Ground | None]:
    """What carries the person at each frame: the feet that are low, stepping or not; None where none is.

    Args:
        joints: of the motion [m], (T, 24, 3). standing: their heights in a stand [m], (24,).
    """
    feet = list(FEET)
    grounds: list[Ground | None] = []
    for now in joints[:, feet]:
        down = now[now[:, 2] < standing[feet] + LOW]
        if not len(down):
            grounds.append(None)
            continue
        centre = 0.5 * (down.min(axis=0) + down.max(axis=0)) * [1, 1, 0]
        reach = np.linalg.norm((down - centre)[:, :2], axis=1).max()
        grounds.append(Ground(centre, STEP + float(reach)))
    return grounds
