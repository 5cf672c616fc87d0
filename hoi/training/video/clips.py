"""Clips of contacts as the prior is to see them: drawn from around, clean and flawed side by side.

A scene is seen from a few directions. Each view holds the same contact with each flaw, the limb inside the object and
a gap, and beside each the clean one through the very same camera: the two differ by what a good prior should mend, and
by nothing else. Clips are of silhouettes, as stage 3 shows them to the prior.
"""

import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.motion.prior import MotionPrior, load_prior
from hoi.refine.clip import chosen
from hoi.refine.silhouettes import silhouettes
from hoi.refine.views import Framing, viewpoint
from hoi.render.cameras import CIRCLE_ELEVATION, Camera
from hoi.training.video.contacts import FLAWS, OBJECT_SHARES, PEOPLE, Contact, sample_motions, spoil, stage_contact
from hoi.video_prior.embedded import CLIP_FRAMES, CROP, SIZE

VIEWS = 2
"""Directions from which each contact is seen."""
SIDEWAYS = math.radians(50)
"""How far from that a view may be."""
FROM_THE_SIDE = 0.8
"""Share of the views that look across the strike, where a contact is best seen, as in stage 3."""
ELEVATION_SPREAD = math.radians(12)
CENTRE_NOISE = 0.03
"""Standard deviation of the framing's centre about the point of contact, along each axis [m]."""
MOTIONS_PER_SCENE = 0.2
"""How many motions are drawn from the motion prior for each scene."""
SHARD = 256
"""Views in a file."""
SHARD_SEEDS = 10_000
"""More than any training has files."""


@dataclass(frozen=True)
class Clips:
    """V views of contacts, each with the K flaws of `FLAWS`."""

    video: NDArray[np.uint8]
    """(V, K, 2, F, height, width, 3): the clean clip, then the flawed one."""
    amount: NDArray[np.float32]
    """Depth of the deepest skin in the flawed clip, or minus the gap at the contact [m], (V, K)."""
    limb: NDArray[np.int16]
    """In `LIMBS`, (V,)."""
    shape: NDArray[np.int16]
    """In `OBJECT_SHARES`, (V,)."""
    person: NDArray[np.int16]
    """In `PEOPLE`, (V,)."""

    def __len__(self) -> int:
        return len(self.video)


@torch.no_grad()
def draw(contact: Contact, shifts: list[np.ndarray], rng: np.random.Generator) -> NDArray[np.uint8]:
    """One view of a contact, clean and with the person moved by each of the shifts (F, 3) [m].

    Returns:
        (K, 2, F, height, width, 3).
    """
    across = math.atan2(contact.strike[1], contact.strike[0]) + rng.choice([-1, 1]) * np.pi / 2
    azimuth = across + rng.uniform(-1, 1) * (SIDEWAYS if rng.uniform() < FROM_THE_SIDE else np.pi)
    elevation = CIRCLE_ELEVATION + rng.uniform(-1, 1) * ELEVATION_SPREAD
    near = int(np.abs(contact.times).argmin())
    around = contact.point + rng.normal(0, CENTRE_NOISE, 3)
    pairs = []
    for shift in shifts:
        # Where in the picture limb and object are must not give the flaw away.
        centre = around + rng.uniform(0, 1) * shift[near]
        camera = viewpoint(Framing(centre, CROP), azimuth, elevation, width=SIZE, height=SIZE)
        moves = (torch.from_numpy(move).float() for move in (np.zeros_like(shift), shift))
        pairs.append(torch.stack([render(contact, move, camera) for move in moves]))
    return (torch.stack(pairs).clamp(0, 1) * 255).round().byte().movedim(-3, -1).numpy()


def render(contact: Contact, shift: Tensor, camera: Camera) -> Tensor:
    """Silhouettes (F, 3, height, width) of a contact with the person moved by `shift` (F, 3) [m]; differentiable."""
    limb, frames = torch.from_numpy(contact.chain), []
    for person, place, at in zip(contact.body, shift, contact.centres, strict=True):
        moved = replace(person, means=person.means + place)
        thing = replace(contact.thing, means=contact.thing.means + torch.from_numpy(at).float())
        frames.append(silhouettes(chosen(moved, limb), chosen(moved, ~limb), thing, camera))
    return torch.stack(frames)


def make_clips(views: int, seed: int, prior: MotionPrior, done: Callable[[], object] = lambda: None) -> Clips:
    """Draw contacts until there are so many views, and call `done` after each. The same seed gives the same clips."""
    motions = sample_motions(prior, max(4, math.ceil(views / VIEWS * MOTIONS_PER_SCENE)), seed)
    video, amounts, numbers = [], [], []
    draws = 0
    while len(video) < views:
        rng = np.random.default_rng([seed, draws])
        draws += 1
        contact = stage_contact(motions, prior, rng)
        if contact is None:
            continue
        found = [flaw for flaw in (spoil(contact, name, rng) for name in FLAWS) if flaw is not None]
        if len(found) < len(FLAWS):
            continue
        for _ in range(min(VIEWS, views - len(video))):
            video.append(draw(contact, [shift for shift, _ in found], rng))
            amounts.append([amount for _, amount in found])
            numbers.append((contact.limb, list(OBJECT_SHARES).index(contact.shape), PEOPLE.index(contact.person)))
            done()
    limb, shape, person = np.array(numbers, np.int16).T
    return Clips(np.stack(video), np.array(amounts, np.float32), limb, shape, person)


def shards(folder: Path, views: int, seed: int) -> list[Path]:
    """The files that `views` views are kept in, `SHARD` in each."""
    return [folder / f"clips_{seed}_{index:03d}.npz" for index in range(math.ceil(views / SHARD))]


def provide_clips(folder: Path, views: int, seed: int) -> Clips:
    """The training clips: those that are in the folder already, and the others made now.

    Raises:
        InputError: a file there is damaged or holds clips of another size.
    """
    files = shards(folder, views, seed)
    missing = [(index, file) for index, file in enumerate(files) if not file.is_file()]
    if missing:
        prior = load_prior()
        with tqdm(total=SHARD * len(missing), desc="clips", unit="view") as bar:
            for index, file in missing:
                save_clips(make_clips(SHARD, SHARD_SEEDS * seed + index, prior, bar.update), file)
    parts = [load_clips(file) for file in files]
    return Clips(*(np.concatenate([getattr(part, f.name) for part in parts])[:views] for f in fields(Clips)))


def save_clips(clips: Clips, path: Path) -> None:
    """As .npz, replaced in one piece."""
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, **vars(clips))


def load_clips(path: Path) -> Clips:
    """What `save_clips` has written.

    Raises:
        InputError: the file is missing, damaged or of clips of another size.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            clips = Clips(*(file[field.name] for field in fields(Clips)))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: clips cannot be read from it ({error}); delete it to have them made anew") from None
    wanted = (len(FLAWS), 2, CLIP_FRAMES, SIZE, SIZE, 3)
    if clips.video.shape[1:] != wanted:
        raise InputError(
            f"{path}: clips of shape {clips.video.shape[1:]}, must be {wanted}; delete it to have new ones"
        )
    return clips
