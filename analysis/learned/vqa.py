"""The VQA physics score: how sure Qwen-VL is to answer "Yes" (paper, Metrics, after Lin et al. 2024, VQAScore)."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from hoi.errors import InputError, RunError
from hoi.video_prior.files import in_hub_cache

from .files import check_memory, files_sha256
from .frames import Clip
from .qwen_video import Cells, Sampling, VideoPatches, cut

QUESTION = "Is the interaction physically plausible overall?"
"""The paper's."""
HUB_NAME = "Qwen/Qwen2.5-VL-7B-Instruct"
CLASSES = {"qwen2_vl": "Qwen2VLForConditionalGeneration", "qwen2_5_vl": "Qwen2_5_VLForConditionalGeneration"}
"""Of transformers, by model_type of config.json."""
NEEDED = ("config.json", "tokenizer_config.json")
VIDEO_TOKEN = 2
"""What mm_token_type_ids says of a video's tokens; text is 0."""


@dataclass(frozen=True)
class VqaFiles:
    """A model's folder, found but not loaded."""

    folder: Path
    config: dict[str, Any]
    name: str
    """As the user called it, without its path."""
    question: str = QUESTION
    sampling: Sampling = field(default_factory=Sampling)

    @property
    def shards(self) -> list[Path]:
        return sorted(self.folder.glob("*.safetensors"))

    @property
    def identity(self) -> str:
        """What the scores depend on."""
        others = [file for name in (*NEEDED, "tokenizer.json") if (file := self.folder / name).is_file()]
        seen = f"fps:{self.sampling.fps:g} pixels:{self.sampling.least_pixels}-{self.sampling.most_pixels}"
        return f"{self.name} sha256:{files_sha256([*self.shards, *others])} {seen} question:{self.question}"

    def load(self, device: torch.device) -> Callable[[Clip], dict[str, float]]:
        """What scores a clip. The weights keep the number format they are stored in.

        Raises:
            InputError: a file is missing or damaged, or the memory does not suffice.
        """
        import transformers
        from transformers.utils import logging

        check_memory("--vqa", sum(shard.stat().st_size for shard in self.shards), device)
        logging.disable_progress_bar()
        logging.set_verbosity_error()  # what it would warn of is refused below, in one line
        kind = getattr(transformers, CLASSES[self.config["model_type"]])
        try:
            tokenizer = transformers.AutoTokenizer.from_pretrained(self.folder, local_files_only=True)
            model, found = kind.from_pretrained(
                self.folder, dtype="auto", use_safetensors=True, local_files_only=True, output_loading_info=True
            )
        except Exception as error:  # whatever the loaders trip over is the folder's fault
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise InputError(f"--vqa: the model in {self.folder} cannot be loaded: {reason}") from error
        # transformers would go on with random numbers in their place.
        wrong = [*found["missing_keys"], *found["unexpected_keys"], *found["mismatched_keys"]]
        if wrong:
            raise InputError(f"--vqa: the weights in {self.folder} are not those of its config.json: {wrong[0]}")
        model = model.to(device).eval().requires_grad_(False)
        return VqaScorer(model, tokenizer, self.question, self.sampling, str(self.folder))


def find_vqa(given: str, question: str = QUESTION, sampling: Sampling | None = None) -> VqaFiles:
    """The model of `--vqa`: a folder, or a name whose download is in the Hugging Face cache. Nothing is downloaded.

    Raises:
        InputError: there is none; the line says where it is looked for and where it is to be had.
    """
    folder = Path(given).expanduser()
    if not folder.is_dir():
        cached = in_hub_cache(given)
        if cached is None:
            raise InputError(
                f"--vqa: no Qwen2-VL or Qwen2.5-VL at {given}: neither a folder here nor in the Hugging Face cache; "
                f"`hf download {HUB_NAME}` fetches 16.6 GB"
            )
        folder = cached
    missing = [name for name in NEEDED if not (folder / name).is_file()]
    missing += [] if any(folder.glob("*.safetensors")) else ["*.safetensors"]
    if missing:
        raise InputError(
            f"--vqa: the folder {folder} lacks {', '.join(missing)}; "
            f"`hf download {HUB_NAME}` fetches a whole one, 16.6 GB"
        )
    try:
        config = json.loads((folder / "config.json").read_text("utf-8"))
        kind = config.get("model_type")
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"--vqa: {folder / 'config.json'} cannot be read: {error}") from error
    if kind not in CLASSES:
        raise InputError(f"--vqa: {folder} holds a model of type {kind!r}, must be {' or '.join(CLASSES)}")
    return VqaFiles(folder, config, Path(given).name, question, sampling or Sampling())


class VqaScorer:
    """A model that is asked one question about each clip."""

    def __init__(self, model: Any, tokenizer: Any, question: str, sampling: Sampling, where: str) -> None:
        """
        Raises:
            InputError: the tokenizer (in the folder `where`) has no chat template, or none for a video.
        """
        self.model, self.tokenizer, self.sampling = model, tokenizer, sampling
        vision = model.config.vision_config
        self.cells = Cells(vision.patch_size, vision.spatial_merge_size, vision.temporal_patch_size)
        self.video_id = int(model.config.video_token_id)
        content = [{"type": "video"}, {"type": "text", "text": question}]
        if not tokenizer.chat_template:
            raise InputError(f"--vqa: the tokenizer in {where} has no chat template (tokenizer_config.json)")
        prompt = tokenizer.apply_chat_template(
            [{"role": "user", "content": content}], tokenize=False, add_generation_prompt=True
        )
        self.prompt: list[int] = tokenizer(prompt, add_special_tokens=False).input_ids
        if self.prompt.count(self.video_id) != 1:
            raise InputError(f"--vqa: the chat template in {where} must give a video one place, not {prompt!r}")
        self.yes, self.no = (tokenizer(word, add_special_tokens=False).input_ids[0] for word in ("Yes", "No"))
        if self.yes == self.no:
            raise InputError(f"--vqa: the tokenizer in {where} cannot tell Yes from No")

    def __call__(self, clip: Clip) -> dict[str, float]:
        """P(Yes) over the whole vocabulary, as VQAScore has it, and P(Yes) / (P(Yes) + P(No)).

        Raises:
            InputError: the video cannot be sampled.
            RunError: the model's answer is not finite.
        """
        patches = cut(clip.pictures, clip.fps, self.cells, self.sampling)
        logits = self.answer(patches)
        if not bool(logits.isfinite().all()):
            raise RunError("the answer of the model is not finite; take weights of another number format")
        either = torch.sigmoid(logits[self.yes] - logits[self.no])
        return {"vqa_yes": logits.softmax(-1)[self.yes].item(), "vqa_yes_no": either.item()}

    @torch.inference_mode()
    def answer(self, patches: VideoPatches) -> torch.Tensor:
        """Logits (vocabulary,) of the answer's first token, float32: raw, with no repetition penalty or temperature."""
        device = self.model.device
        t, height, width = patches.grid
        place = self.prompt.index(self.video_id)
        count = t * height * width // self.cells.merge**2
        ids = torch.tensor([self.prompt[:place] + [self.video_id] * count + self.prompt[place + 1 :]], device=device)
        inputs: dict[str, Any] = {
            "input_ids": ids,
            "attention_mask": torch.ones_like(ids),
            "mm_token_type_ids": (ids == self.video_id).int() * VIDEO_TOKEN,
            "pixel_values_videos": patches.values.to(device),
            "video_grid_thw": torch.tensor([patches.grid], device=device),
        }
        if self.model.config.model_type == "qwen2_5_vl":  # the older one does not know the time
            inputs["second_per_grid_ts"] = torch.tensor([patches.seconds], device=device)
        return self.model(**inputs, use_cache=False, logits_to_keep=1).logits[0, -1].float()
