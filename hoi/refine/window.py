"""Which frames and joints stage 3 may move, and how (paper, Temporal Masking)."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hoi.body.skeleton import CHAINS, JOINT_COUNT, PARENTS
from hoi.data import Array, Contact, Motion

REACH = 1.0
"""How far beyond the half width the taper falls to zero [frames]: where the frame stays what it is."""


@dataclass(frozen=True)
class Window:
    """[t_c - Delta t, t_c + Delta t] and the limb that strikes in it."""

    t_c: float
    """Frame of the contact, fractional."""
    frames: tuple[int, ...]
    """The whole frames whose theta may change, in order and without gaps."""
    half_width: float
    """Delta t [frames]."""
    joint: int
    """j_c, the joint that strikes."""
    limb: tuple[int, ...]
    """The joints that strike together, from the body outwards (`hoi.body.skeleton.CHAINS`), `joint` among them."""
    push: Contact | None = None
    """The contact that gave the object its new velocity at t_c; None where none was looked for."""
    whole_body: bool = False
    """Whether theta of every joint may change, as in the paper, or of those that strike together alone."""
    tapered: bool = True
    """Whether frames farther from t_c follow less; the paper's do not."""

    @property
    def moving(self) -> tuple[int, ...]:
        """The joints whose theta may change, none of them the pelvis, whose turn is omega."""
        return tuple(joint for joint in (range(JOINT_COUNT) if self.whole_body else self.limb) if joint > 0)


def window_around(
    t_c: float,
    joint: int,
    half_width: float,
    frames: int,
    push: Contact | None = None,
    *,
    whole_body: bool = False,
    tapered: bool = True,
) -> Window:
    """The window of a contact of `joint` at `t_c` in a scene of `frames` frames; see `Window`.

    Frames no farther than `half_width` from the whole frame nearest to t_c, and always the two around it.
    """
    within = {frame for frame in range(frames) if abs(frame - math.floor(t_c + 0.5)) <= half_width}
    around = {math.floor(t_c), min(math.ceil(t_c), frames - 1)}
    limb = next(chain for chain in CHAINS.values() if joint in chain)
    return Window(t_c, tuple(sorted(within | around)), half_width, joint, limb, push, whole_body, tapered)


def taper(window: Window) -> Array:
    """How far each frame of the window may follow: 1 at t_c, falling smoothly to 0 past the window's edges, (F,).

    1 throughout where the window is not tapered.
    """
    if not window.tapered:
        return np.ones(len(window.frames))
    width = max(window.half_width, 1.0) + REACH
    apart = np.abs(np.array(window.frames) - window.t_c)
    return np.cos(np.pi / 2 * np.minimum(apart / width, 1.0)) ** 2


class WindowedPose:
    """The motion with theta free in the window alone: theta = theta_0 + taper * offset.

    r, omega, all other frames and all other joints are bit for bit those of the motion from before.
    """

    def __init__(
        self, motion: Motion, window: Window, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
    ) -> None:
        def tensor(values: object) -> Tensor:
            return torch.tensor(np.asarray(values), dtype=dtype, device=device)

        self.window, self.before = window, motion
        self.translation, self.orientation = tensor(motion.translation), tensor(motion.orientation)
        """r (T, 3) [m] and omega (T, 6), fixed."""
        self.start = tensor(motion.body_pose)
        """theta_0 (T, 23, 3) [rad]."""
        self.taper = tensor(taper(window))
        self._frames = torch.tensor(window.frames, device=device)
        self._joints = torch.tensor(self.window.moving, device=device) - 1
        self.offset = torch.zeros(
            (len(window.frames), len(window.moving), 3), dtype=dtype, device=device, requires_grad=True
        )
        """What is optimised [rad], (F, J, 3): the only leaf."""

    @property
    def change(self) -> Tensor:
        """theta - theta_0 in the window, of the joints that move [rad], (F, J, 3)."""
        return self.taper[:, None, None] * self.offset

    @property
    def body_pose(self) -> Tensor:
        """theta (T, 23, 3) [rad], differentiable in `offset`."""
        rows, columns = self._frames[:, None], self._joints[None, :]
        return self.start.index_put((rows, columns), self.start[rows, columns] + self.change)

    def motion(self) -> Motion:
        """The motion as it is now."""
        body_pose = self.before.body_pose.copy()
        rows, columns = np.array(self.window.frames)[:, None], np.array(self.window.moving)[None, :] - 1
        body_pose[rows, columns] += self.change.detach().cpu().numpy().astype(body_pose.dtype)
        return Motion(self.before.translation, self.before.orientation, body_pose, self.before.fps)

    def roughness(self) -> Tensor:
        """What the change of theta adds to accelerations, squared: mean over frames, edges included [rad^2/frame^4].

        The change is 0 outside the window, and stays so: the second differences run over its edges.
        """
        padded = torch.nn.functional.pad(self.change, (0, 0, 0, 0, 2, 2))
        return (padded[2:] - 2 * padded[1:-1] + padded[:-2]).square().sum(dim=(1, 2)).mean()


def bones_apart(joint: int) -> NDArray[np.int_]:
    """Bones on the way from `joint` to each of the 24 joints, (24,)."""
    apart = np.full(JOINT_COUNT, JOINT_COUNT)
    apart[joint] = 0
    for _ in range(JOINT_COUNT):
        for child, parent in enumerate(PARENTS[1:], start=1):
            apart[child], apart[parent] = min(apart[child], apart[parent] + 1), min(apart[parent], apart[child] + 1)
    return apart
