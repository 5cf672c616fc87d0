"""A person as linked rigid parts: MuJoCo's model of one, and poses and their change as MuJoCo knows them.

MuJoCo's coordinates q are the place of the pelvis [m], its turn, and each joint's turn against its parent (wxyz); their
rates are the pelvis' velocity in the world [m/s], then turns about each part's own axes [rad/s].
"""

# MuJoCo brings no types.
# pyright: reportAttributeAccessIssue=false

import functools
from typing import Any

import mujoco
import numpy as np
import roma
import torch

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import local_rotations, rotation_to_6d
from hoi.body.mass import masses_of
from hoi.body.skeleton import CHAINS, JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Array, Body, Motion
from hoi.errors import RunError

ROOT = 6
"""Rates of the pelvis."""
FIRST_OF_LIMBS = tuple(CHAINS[limb][0] for limb in ("left leg", "right leg", "left arm", "right arm", "head"))
"""The joints that still turn where each limb is in one piece."""


class Articulated:
    """The model of one person, without its weight, and MuJoCo's workspace for it.

    Raises:
        RunError: the person, or its pelvis, has no volume, see `hoi.body.mass.masses_of`.
    """

    def __init__(self, body: Body) -> None:
        masses, rest = masses_of(body), np.asarray(body.rest_joints, dtype=np.float64)
        if masses.mass[0] <= 0:
            raise RunError(
                f"the person {body.name!r} has no volume at the pelvis, which all else hangs on; "
                "use stage.contact.limb=infinite, which needs none"
            )
        self.masses = masses.mass
        self.links = [joint for joint in range(JOINT_COUNT) if joint == 0 or masses.mass[joint] > 0]
        """The joints with a part of their own; the others go with their parents."""
        holder = {0: 0}
        for joint in range(1, JOINT_COUNT):
            holder[joint] = joint if joint in self.links else holder[PARENTS[joint]]

        def part(joint: int) -> str:
            above = holder[PARENTS[joint]] if joint else 0
            offset = rest[joint] - rest[above] if joint else np.zeros(3)
            inertia = masses.inertia[joint][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            parts = [p for p in self.links[1:] if p != joint and holder[PARENTS[p]] == joint]
            return (
                f'<body name="{JOINT_NAMES[joint]}" pos="{_text(offset)}">'
                + (f'<joint name="{JOINT_NAMES[joint]}" type="ball"/>' if joint else "<freejoint/>")
                + f'<inertial pos="{_text(masses.centre[joint] - rest[joint])}" mass="{float(masses.mass[joint])!r}" '
                + f'fullinertia="{_text(inertia)}"/>{"".join(map(part, parts))}</body>'
            )

        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option gravity="0 0 0"/><worldbody>{part(0)}</worldbody></mujoco>'
        )
        self.data = mujoco.MjData(self.model)
        ids = [self.model.body(JOINT_NAMES[joint]).id for joint in self.links]
        self.part = {joint: ids[self.links.index(holder[joint])] for joint in range(JOINT_COUNT)}
        """MuJoCo's body of the part that each joint moves."""
        turning = [self.model.body_jntadr[i] for i in ids]
        self.quaternion = [int(self.model.jnt_qposadr[j]) + (3 if n == 0 else 0) for n, j in enumerate(turning)]
        """Where in q the turn of each link begins."""
        self.rate = {joint: int(self.model.jnt_dofadr[j]) for joint, j in zip(self.links, turning, strict=True)}
        """Where in the rates those of each link begin."""

    @property
    def mass(self) -> float:
        """[kg]"""
        return float(self.masses.sum())

    @functools.cached_property
    def in_pieces(self) -> Array:
        """S (nv, k): the rates that are left where every limb, and the trunk, is in one piece."""
        kept = [*range(ROOT), *(self.rate[j] + axis for j in FIRST_OF_LIMBS if j in self.rate for axis in range(3))]
        return np.eye(self.model.nv)[:, kept]

    def coordinates(self, motion: Motion, frames: Array) -> Array:
        """q (F, nq) of a motion at fractional frames (F,), from its first frame to its last."""
        at = interpolate_motion(_double(motion), frames)
        turns = roma.rotmat_to_unitquat(
            local_rotations(torch.from_numpy(at.orientation), torch.from_numpy(at.body_pose))
        )
        q = np.empty((len(at), self.model.nq))
        q[:, :3] = at.translation
        for joint, place in zip(self.links, self.quaternion, strict=True):
            q[:, place : place + 4] = turns[:, joint, [3, 0, 1, 2]].numpy()
        return q

    def motion(self, coordinates: Array, like: Motion) -> Motion:
        """The motion of q (F, nq); the joints that move no part are those of `like`, of F frames too."""
        turns = roma.rotvec_to_unitquat(torch.as_tensor(like.body_pose, dtype=torch.float64)).clone()
        quaternions = {
            joint: torch.from_numpy(coordinates[:, place : place + 4][:, [1, 2, 3, 0]])
            for joint, place in zip(self.links, self.quaternion, strict=True)
        }
        for joint in self.links[1:]:
            turns[:, joint - 1] = quaternions[joint]
        dtype = np.asarray(like.translation).dtype
        return Motion(
            translation=coordinates[:, :3].astype(dtype),
            orientation=rotation_to_6d(roma.unitquat_to_rotmat(quaternions[0])).numpy().astype(dtype),
            body_pose=roma.unitquat_to_rotvec(turns).numpy().astype(dtype),
            fps=like.fps,
        )

    def place(self, q: Array, rates: Array, data: Any = None) -> None:
        """Makes a workspace, by default its own, that of a pose (nq,) and its rates (nv,)."""
        data = data or self.data
        data.qpos[:], data.qvel[:] = q, rates
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)

    def inertia(self) -> Array:
        """M (nv, nv) at the present pose."""
        matrix = np.empty((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, matrix)
        return matrix

    def jacobian(self, joint: int, point: Array) -> Array:
        """J (6, nv): velocity [m/s] and turning [rad/s] in the world of the part that `joint` moves, at `point` [m]."""
        jacobian = np.zeros((6, self.model.nv))
        mujoco.mj_jac(self.model, self.data, jacobian[:3], jacobian[3:], point, self.part[joint])
        return jacobian

    def impulse(self, change: Array, seconds: float, data: Any = None) -> Array:
        """Inverse dynamics: the generalised impulse M dq' + h C, (nv,), that changes the rates by dq' in a time h.

        Args:
            change: dq' (nv,). seconds: h [s]. data: a workspace with the pose, by default its own.
        """
        data, impulse = data or self.data, np.empty(self.model.nv)
        mujoco.mj_mulM(self.model, data, impulse, change)
        return impulse + seconds * data.qfrc_bias

    def rise(self) -> Array:
        """How fast the centre of mass rises with each rate [m/s], (nv,)."""
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSubtreeCom(self.model, self.data, jacobian, 1)
        return jacobian[2]

    def mobility(self, one_piece: float) -> Array:
        """B (nv, nv): a generalised impulse p changes the rates by B p.

        B = (1 - s) M^-1 + s S (S^T M S)^-1 S^T: the share s answers in one piece a limb, the rest with all joints free.
        Both leave the pelvis free, so that what the person takes up is what it is given, whatever s is; and as
        B M B <= B, no blow with restitution up to 1 adds energy.
        """
        inertia, kept = self.inertia(), self.in_pieces
        free = np.linalg.inv(inertia)
        if one_piece == 0:
            return free
        locked = kept @ np.linalg.solve(kept.T @ inertia @ kept, kept.T)
        return (1 - one_piece) * free + one_piece * locked

    def momentum(self) -> tuple[Array, Array]:
        """Linear [N s] and, about the world's origin, angular momentum [N m s], (3,) each."""
        mujoco.mj_subtreeVel(self.model, self.data)
        linear = self.mass * self.data.subtree_linvel[1]
        return linear, self.data.subtree_angmom[1] + np.cross(self.data.subtree_com[1], linear)

    def difference(self, q: Array, to: Array) -> Array:
        """What rates lead from pose `q` to pose `to` in a second, (nv,)."""
        rates = np.empty(self.model.nv)
        mujoco.mj_differentiatePos(self.model, rates, 1.0, q, to)
        return rates

    def moved(self, q: Array, rates: Array, seconds: float) -> Array:
        """The pose after some time at these rates, (nq,)."""
        after = q.copy()
        mujoco.mj_integratePos(self.model, after, rates, seconds)
        return after


def _double(motion: Motion) -> Motion:
    parts = (motion.translation, motion.orientation, motion.body_pose)
    return Motion(*(np.asarray(part, dtype=np.float64) for part in parts), fps=motion.fps)


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
