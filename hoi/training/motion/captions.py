"""Write down what a motion prior was trained on, in words: captions.safetensors beside the prior.

    python -m hoi.training.motion.captions --data DIR --out PRIOR

A training writes it with the prior; this does for one that is there already. `hoi.motion.familiarity` reads it.
"""

import argparse
import json
from pathlib import Path

from safetensors.torch import save

from hoi.files import whole_file
from hoi.motion.familiarity import CAPTIONS_NAME
from hoi.motion.text import TextEncoder, minilm
from hoi.terminal.arguments import Parser, refusing
from hoi.terminal.program import program
from hoi.training.motion.acts import UNTRAINED
from hoi.training.motion.dataset import TrainingSet


def write_captions(folder: Path, data: TrainingSet, encoder: TextEncoder) -> None:
    """Each caption with the kind of motion that most of its windows show, and acts that were not trained; embedded."""
    counts: dict[str, dict[str, int]] = {}
    for kind, rows in zip(data.kinds, data.caption_choices, strict=True):
        for row in set(rows):
            of = counts.setdefault(data.captions[row], {})
            label = kind.partition("/")[0]
            of[label] = of.get(label, 0) + 1
    kinds = {caption: max(sorted(of), key=of.__getitem__) for caption, of in sorted(counts.items())}
    kinds |= {act: "" for act in UNTRAINED if act not in kinds}
    embeddings = encoder.compute(list(kinds)).half()
    told = {"sentences": list(kinds), "kinds": list(kinds.values()), "windows": data.summary}
    with whole_file(folder / CAPTIONS_NAME) as part:
        part.write_bytes(save({"embeddings": embeddings}, {name: json.dumps(each) for name, each in told.items()}))


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = Parser(
        prog="python -m hoi.training.motion.captions",
        description="Write down what a motion prior was trained on, in words, beside the prior.",
        epilog="example: python -m hoi.training.motion.captions --data clips --out runs/prior",
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of .npz clip files and captions.json")
    parser.add_argument("--out", type=Path, required=True, help="folder of the prior")
    return parser


def main() -> int:
    from hoi.training.motion.training import read_split

    options = parser().parse_args()
    return refusing(lambda: write_captions(options.out, read_split(options.data)[0], minilm()))


if __name__ == "__main__":
    program(main)
