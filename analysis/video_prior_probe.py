"""Does the embedded video prior pull a limb out of an object, and close a gap? On contacts that it has not seen.

    python -m analysis.video_prior_probe --prior OUT -o probe.png

The person is moved along the strike by d around t_c: in for d > 0, away for d < 0. For noise levels t, noises and
viewpoints, z_hat - z is projected on J = dz/dd: <z_hat - z, J> / <J, J> is the way [m] along the strike that the prior
asks for. The answer of a useful prior falls with d: out for d > 0, in for d < 0. It is linear in the guidance g,
negative + g (positive - negative), so that both parts are told apart.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.data import Array
from hoi.errors import InputError
from hoi.terminal.program import program

from . import command

if TYPE_CHECKING:
    import torch

    from hoi.training.video.contacts import Contact
    from hoi.video_prior.embedded import EmbeddedPrior

SEED = 99_991
"""No training has it."""
STEP = 0.005
"""Of the central difference that gives J [m]."""
WIDTH = 1.0
"""Standard deviation in time of the push [frame]: t_c and little more, as in the window."""
DISTANCES = (-0.08, -0.05, -0.03, -0.015, 0.0, 0.015, 0.03, 0.05, 0.08)
TIMES = (50, 150, 300, 500, 700)


def held_out_contacts(count: int) -> list[Contact]:
    """Clean contacts at the clip's middle frame."""
    from hoi.motion.prior import load_prior
    from hoi.training.video.contacts import sample_motions, stage_contact

    prior = load_prior()
    motions = sample_motions(prior, max(8, count // 2), SEED)
    found: list[Contact] = []
    for draw in range(100 * count):
        contact = stage_contact(motions, prior, np.random.default_rng([SEED, draw]))
        if contact is not None and np.abs(contact.times).min() < 1e-6:
            found.append(contact)
        if len(found) == count:
            return found
    raise RuntimeError(f"only {len(found)} contacts in {100 * count} draws")


def answers(prior: EmbeddedPrior, contact: Contact, views: int, noises: int, rng: np.random.Generator) -> Array:
    """The way [m] asked for under the negative prompt and under the prompt, (distances, times, 2)."""
    import torch

    from hoi.method.video_sds import predict_z
    from hoi.refine.views import Framing, viewpoint
    from hoi.training.video.captions import captions
    from hoi.training.video.clips import render
    from hoi.training.video.contacts import OBJECT_SHARES, PEOPLE
    from hoi.video_prior.embedded import CROP, SIZE

    key = contact.limb, list(OBJECT_SHARES).index(contact.shape), PEOPLE.index(contact.person)
    prior.prepare(captions(*key, "clean")[2], captions(*key, "flawed")[2])
    push = torch.from_numpy(np.exp(-(contact.times**2) / (2 * WIDTH**2))[:, None] * contact.strike).float()
    across = math.atan2(contact.strike[1], contact.strike[0]) + math.pi / 2
    found = np.zeros((len(DISTANCES), len(TIMES), 2))
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    for _ in range(views):
        azimuth = across + rng.choice([0, math.pi]) + rng.uniform(-1, 1) * math.radians(50)
        camera = viewpoint(Framing(contact.point, CROP), azimuth, width=SIZE, height=SIZE)

        def latents(d: float, camera=camera) -> torch.Tensor:
            return prior.encode(render(contact, d * push, camera).clamp(0, 1))

        for row, d in enumerate(DISTANCES):
            z = latents(d)
            slope = (latents(d + STEP) - latents(d - STEP)) / (2 * STEP)
            for column, t in enumerate(TIMES):
                alpha_bar = prior.alphas_cumprod[t].to(z)
                for _ in range(noises):
                    noise = torch.randn(z.shape, generator=generator)
                    z_t = alpha_bar.sqrt() * z + (1 - alpha_bar).sqrt() * noise
                    for branch, v in enumerate(prior.branches(z_t, t)):
                        asked = ((predict_z(z_t, v, alpha_bar) - z) * slope).sum() / slope.square().sum()
                        found[row, column, branch] += float(asked) / (views * noises)
    return found


def probe(prior: EmbeddedPrior, contacts: int, views: int, noises: int) -> dict[str, Array]:
    """Answers of the prompt alone and of the guidance (prompt minus negative), (contacts, distances, times) [m]."""
    import torch

    rng = np.random.default_rng(SEED)
    with torch.no_grad():
        each = np.stack([answers(prior, contact, views, noises, rng) for contact in held_out_contacts(contacts)])
    return {"prompt": each[..., 1], "guidance": each[..., 1] - each[..., 0]}


def told(name: str, values: Array) -> str:
    """A table: mean over contacts in millimetres, and how often the sign is right at each distance but 0."""
    lines = [f"{name}: way asked for along the strike [mm] (share of contacts with the right sign)"]
    lines.append("      d   " + "".join(f"t = {t:<11}" for t in TIMES))
    for row, d in enumerate(DISTANCES):
        right = (np.sign(values[:, row]) == -np.sign(d)).mean(axis=0)
        cells = [
            f"{1e3 * mean:8.3f} ({'----' if d == 0 else f'{share:4.0%}'})"
            for mean, share in zip(values[:, row].mean(axis=0), right, strict=True)
        ]
        lines.append(f"{100 * d:6.1f} cm " + "".join(cells))
    return "\n".join(lines)


def draw_probe(found: dict[str, Array], path: Path) -> None:
    """One panel a part: mean and standard error over contacts, a line a noise level."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (name, values) in zip(figure.subplots(1, len(found)), found.items(), strict=True):
        for column, t in enumerate(TIMES):
            error = values[:, :, column].std(axis=0) / math.sqrt(len(values))
            axes.errorbar(
                100 * np.array(DISTANCES), 1e3 * values[:, :, column].mean(axis=0), 1e3 * error, label=f"{t=}"
            )
        axes.axhline(0, color="grey", linewidth=0.6)
        axes.set(title=name, xlabel="limb pushed into the object [cm]", ylabel="way asked for along the strike [mm]")
        axes.grid(alpha=0.3)
    figure.axes[0].legend()
    figure.savefig(path, dpi=110)


def main() -> int:
    parser = command.parser(
        "analysis.video_prior_probe",
        "What the embedded video prior asks for, the limb being too deep in an object or short of it.",
        "-o probe.png",
    )
    parser.add_argument("--prior", help="a trained folder or file; default: the one in the package")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".png; the numbers go beside it as .json")
    parser.add_argument("--contacts", type=int, default=16)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--noises", type=int, default=2)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    import torch

    from hoi.video_prior.embedded import load_embedded

    torch.set_num_threads(options.threads)
    try:
        prior = load_embedded(options.prior)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    found = probe(prior, options.contacts, options.views, options.noises)
    for name, values in found.items():
        print(told(name, values))
    numbers = {"distances": DISTANCES, "times": TIMES, **{name: values.tolist() for name, values in found.items()}}
    options.out.with_suffix(".json").write_text(json.dumps(numbers) + "\n")
    draw_probe(found, options.out)
    return 0


if __name__ == "__main__":
    program(main)
