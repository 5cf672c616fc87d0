"""Score the videos of a folder of runs with models whose weights are at hand.

    python -m analysis.learned runs --viclip ViCLIP-L_InternVid-FLT-10M.pth --vqa Qwen2.5-VL-7B-Instruct

Nothing is downloaded, and no score is made up: without weights there is no score.
"""

import argparse
import sys
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.program import program


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}",
        description="Learned scores of the videos of a folder of runs.",
        epilog="example: %(prog)s runs",
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="DIR", help="holds run.mcap files, at any depth")
    add("--viclip", type=Path, metavar="FILE", help="a ViCLIP checkpoint, .pth or .safetensors")
    add("--clip-vocab", type=Path, metavar="PATH", help="CLIP's BPE file or tokenizer folder, if not beside FILE")
    add("--vqa", metavar="FOLDER", help="a Qwen2-VL or Qwen2.5-VL: its folder, or its name in the Hugging Face cache")
    add("--question", help="asked instead of the paper's")
    add("--device", choices=["auto", "cpu", "cuda"], default="auto")
    add("--again", action="store_true", help="also score what these models have scored")
    options = parser.parse_args(arguments)
    try:
        scored = _run(options)
    except (InputError, RunError) as error:
        print(f"analysis.learned: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 3)
    if not scored:
        print("analysis.learned: no record could be scored", file=sys.stderr)
        sys.exit(2)


def _run(options: argparse.Namespace) -> bool:
    """Whether any record has scores now. All files are looked for before the first model is loaded."""
    if options.viclip is None and options.vqa is None:
        raise InputError("give --viclip FILE, --vqa FOLDER or both: there are no scores without weights")
    import torch

    from .score import ModelFiles, find_records, score
    from .viclip import find_viclip
    from .vqa import QUESTION, find_vqa

    models: dict[str, ModelFiles] = {}
    if options.viclip is not None:
        models["viclip"] = find_viclip(options.viclip, options.clip_vocab)
    if options.vqa is not None:
        models["vqa"] = find_vqa(options.vqa, options.question or QUESTION)
    records = find_records(options.folder)
    cuda = torch.cuda.is_available()
    if options.device == "cuda" and not cuda:
        raise InputError("--device is cuda, but torch finds no CUDA device; use cpu")
    device = torch.device("cpu" if options.device == "cpu" or not cuda else "cuda")
    some = False
    for name, files in models.items():
        tally = score(records, name, files, device, options.again)
        print(f"{name}: {tally.scored} scored, {tally.kept} had their scores, {tally.skipped} skipped")
        some |= tally.scored + tally.kept > 0
    return some


if __name__ == "__main__":
    program(main)
