"""CLIP's byte-pair tokens from local files: nothing is downloaded, and no vocabulary is in this package."""

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tokenizers.pre_tokenizers import ByteLevel
from torch import Tensor

from hoi.errors import InputError

BPE_FILE = "bpe_simple_vocab_16e6.txt.gz"
BPE_LIMIT = 32_000_000
"""Bytes read of an unpacked BPE file; the published one has 3.2 million characters."""
FOLDER_FILES = ("tokenizer.json", "vocab.json")
"""Either makes a folder a tokenizer's."""
TOKEN_FILES = (*FOLDER_FILES, "merges.txt")
START, END = "<|startoftext|>", "<|endoftext|>"
FIXED = 2 * 256 + 2
"""Tokens that are no merge: each byte within and at the end of a word, start and end."""


@dataclass(frozen=True)
class ClipTokens:
    """CLIP's tokenizer, cut to the text tower's context."""

    tokenizer: Any
    """A `transformers.CLIPTokenizer`."""
    context: int

    def __call__(self, text: str) -> Tensor:
        """Token ids (context,): start, text, end, zeros. What is too long is cut, its last id the end."""
        ids = self.tokenizer(text).input_ids
        if len(ids) > self.context:
            ids = [*ids[: self.context - 1], self.tokenizer.eos_token_id]
        return torch.tensor(ids + [0] * (self.context - len(ids)))

    def cut(self, text: str) -> str | None:
        """What the model does not read of a text; None when it reads it all."""
        ids = self.tokenizer(text).input_ids
        return self.tokenizer.decode(ids[self.context - 1 : -1]) if len(ids) > self.context else None


def find_vocabulary(given: Path | None, beside: Path) -> Path:
    """The BPE file or tokenizer folder: the one given, or else the one beside the checkpoint.

    Raises:
        InputError: there is none.
    """
    if given is not None:
        if given.is_file() or any((given / name).is_file() for name in FOLDER_FILES):
            return given
        raise InputError(f"--clip-vocab: {given} is neither {BPE_FILE} nor a folder with {' or '.join(FOLDER_FILES)}")
    if (beside.parent / BPE_FILE).is_file():
        return beside.parent / BPE_FILE
    if any((beside.parent / name).is_file() for name in FOLDER_FILES):
        return beside.parent
    raise InputError(
        f"--clip-vocab: ViCLIP needs CLIP's vocabulary: put {BPE_FILE} (1.4 MB, Hugging Face OpenGVLab/ViCLIP) beside "
        f"{beside}, or give it or a CLIP tokenizer folder (openai/clip-vit-large-patch14) with --clip-vocab"
    )


def load_tokens(path: Path, context: int, vocabulary: int) -> ClipTokens:
    """The tokenizer of a model that reads `context` tokens out of `vocabulary`.

    Raises:
        InputError: the file is damaged, or another model's.
    """
    from transformers import CLIPTokenizer

    try:
        if path.is_dir():
            tokenizer = CLIPTokenizer.from_pretrained(path, local_files_only=True)
        else:
            tokens, merges = read_bpe(path, vocabulary)
            tokenizer = CLIPTokenizer(vocab=tokens, merges=merges)  # pyright: ignore[reportArgumentType]
    except InputError:
        raise
    except Exception as error:  # the tokenizers library raises bare Exception
        raise InputError(f"--clip-vocab: {path} is no CLIP tokenizer: {' '.join(str(error).split())}") from error
    # The end must have the largest id: the model finds it by that.
    if len(tokenizer) != vocabulary or tokenizer.eos_token_id != vocabulary - 1:
        raise InputError(f"--clip-vocab: {path} has {len(tokenizer)} tokens, the model was trained with {vocabulary}")
    return ClipTokens(tokenizer, context)


def read_bpe(path: Path, vocabulary: int) -> tuple[dict[str, int], list[tuple[str, str]]]:
    """Ids by token and merges, of a file in the layout of CLIP's: a headline, then a merge a line, the best first.

    Raises:
        InputError: the file is damaged or too short.
    """
    try:
        with gzip.open(path) as file:
            lines = file.read(BPE_LIMIT).decode("utf-8").split("\n")
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise InputError(f"--clip-vocab: {path} is no {BPE_FILE}: {error}") from error
    merges = [tuple(line.split()) for line in lines[1 : 1 + vocabulary - FIXED]]
    if len(merges) != vocabulary - FIXED or any(len(merge) != 2 for merge in merges):
        raise InputError(f"--clip-vocab: {path} has no {vocabulary - FIXED} merges of two, which the model needs")
    letters = sorted(ByteLevel.alphabet())
    tokens = [*letters, *(letter + "</w>" for letter in letters), *("".join(merge) for merge in merges), START, END]
    return {token: index for index, token in enumerate(tokens)}, [(first, second) for first, second in merges]
