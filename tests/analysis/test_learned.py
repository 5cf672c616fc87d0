"""The learned scores, with tiny random models of the published classes: only what is random about them is made up."""

import gzip
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from demo_run import make_run
from safetensors.torch import load_file, save_file
from tokenizers.pre_tokenizers import ByteLevel

from analysis.learned import __main__ as cli
from analysis.learned import sidecar
from analysis.learned.clip_text import find_vocabulary, load_tokens
from analysis.learned.frames import Clip, load
from analysis.learned.qwen_video import CLIP_MEAN, Cells, Sampling, cut, fitted, sampled
from analysis.learned.score import score
from analysis.learned.viclip import IMAGENET_MEAN, IMAGENET_STD, find_viclip, load_viclip, prepare
from analysis.learned.viclip_model import Sizes, ViCLIP
from analysis.learned.vqa import QUESTION, find_vqa
from hoi import record
from hoi.errors import InputError, RunError
from hoi.render.cameras import look_at
from hoi.render.encode import encode, write_mp4

CPU = torch.device("cpu")
TINY = Sizes(128, 2, 8, 4, 8, 64, 2, 8, 514 + 8, 32)
"""Two heads, 32 pixels, a context of 8."""
SMALL = Sampling(8.0, 28 * 28, 28 * 28 * 6)
VIDEO, YES, NO = "<|video_pad|>", "Yes", "No"
TEMPLATE = (
    "{% for message in messages %}<|im_start|>{{ message['role'] }}\n{% for part in message['content'] %}"
    "{% if part['type'] == 'video' %}<|vision_start|><|video_pad|><|vision_end|>{% else %}{{ part['text'] }}{% endif %}"
    "{% endfor %}<|im_end|>\n{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)


def write_bpe(folder: Path) -> Path:
    """The three words, and a line too many, as in the published file."""
    merges = ["k i", "c k</w>", "ki ck</w>", "b a", "l l</w>", "ba ll</w>", "m a", "ma n</w>", "u n</w>"]
    path = folder / "bpe_simple_vocab_16e6.txt.gz"
    path.write_bytes(gzip.compress("\n".join(['"version: 0.2', *merges, ""]).encode()))
    return path


@pytest.fixture(scope="module")
def viclip(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viclip")
    torch.manual_seed(0)
    state = ViCLIP(TINY).state_dict()
    state["vision_encoder.temporal_positional_embedding"].normal_()
    torch.save({"model": state}, folder / "tiny.pth")
    write_bpe(folder)
    return folder / "tiny.pth"


def make_qwen(folder: Path, kind: str) -> Path:
    import transformers

    letters = sorted(ByteLevel.alphabet())
    marks = ["<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|vision_end|>", VIDEO, "<|image_pad|>"]
    merges = [("Y", "e"), ("Ye", "s"), ("N", "o")]
    tokens = [*letters, *("".join(pair) for pair in merges), "<|endoftext|>", *marks]
    ids = {token: index for index, token in enumerate(tokens)}
    tokenizer = transformers.Qwen2Tokenizer(vocab=ids, merges=merges, additional_special_tokens=marks)
    tokenizer.chat_template = TEMPLATE
    tokenizer.save_pretrained(folder)
    text = {
        "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2,
        "num_key_value_heads": 1, "vocab_size": len(tokens) + 2, "eos_token_id": ids["<|im_end|>"],
        "rope_parameters": {"rope_type": "default", "mrope_section": [2, 3, 3], "rope_theta": 100.0},
    }  # fmt: skip
    vision = {"depth": 2, "num_heads": 2, "patch_size": 14, "spatial_merge_size": 2, "temporal_patch_size": 2}
    if kind == "Qwen2_5_VL":
        vision |= {"hidden_size": 32, "intermediate_size": 32, "out_hidden_size": 32, "fullatt_block_indexes": [1]}
    else:
        vision |= {"embed_dim": 32, "hidden_size": 32, "mlp_ratio": 1}
    config = getattr(transformers, f"{kind}Config")(
        text_config=text, vision_config=vision, image_token_id=ids["<|image_pad|>"], video_token_id=ids[VIDEO],
        vision_start_token_id=ids["<|vision_start|>"], vision_end_token_id=ids["<|vision_end|>"],
    )  # fmt: skip
    torch.manual_seed(0)
    model = getattr(transformers, f"{kind}ForConditionalGeneration")(config)
    for parameter in model.parameters():  # far from the tiny start of training, so that everything counts
        torch.nn.init.normal_(parameter, std=0.3)
    model.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def qwen(tmp_path_factory) -> Path:
    return make_qwen(tmp_path_factory.mktemp("qwen") / "tiny-qwen", "Qwen2_5_VL")


@pytest.fixture(scope="module")
def clip() -> Clip:
    pictures = np.random.default_rng(0).integers(0, 256, (20, 60, 80, 3), dtype=np.uint8)
    return Clip(pictures, 20.0, {"scene_prompt": "man kick ball " * 3, "motion_prompt": "Man  kick"})


CONFIG = "scene:\n  name: kick\n  scene_prompt: man kick ball\n  motion_prompt: man\n  fps: 20.0\n"
SHADES = np.linspace(0, 250, 10).astype(np.uint8)


def write_run(folder: Path, config: str = CONFIG, video: bool = True, seed: int = 0) -> Path:
    """A record of ten grey pictures, each lighter than the one before."""
    folder.mkdir(parents=True, exist_ok=True)
    run, points, colours = make_run(frames=10, points=20, gaussians=10, particles=20, seed=seed)
    film = encode([np.full((32, 48, 3), shade, np.uint8) for shade in SHADES], 20)
    camera = look_at((5.0, -3.0, 2.0), (0.0, 1.0, 0.8), width=48, height=32)
    path = folder / "run.mcap"
    options = {"footage": record.Footage(film.units, (camera,) * 10)} if video else {}
    record.write(replace(run, config_yaml=config), path, points, colours, plan_text="full\n", **options)
    return path


# ViCLIP


@pytest.mark.parametrize(
    ("sizes", "tensors", "millions"),
    [
        (Sizes(1024, 24, 14, 16, 8, 768, 12, 32, 49408, 768), 447, 427.6),
        (Sizes(768, 12, 16, 14, 8, 512, 12, 32, 49408, 512), 303, 149.6),
    ],
    ids=["L/14", "B/16"],
)
def test_the_published_sizes(sizes, tensors, millions):
    with torch.device("meta"):
        model = ViCLIP(sizes)
    state = model.state_dict()
    assert len(state) == tensors and sizes.resolution == 224
    assert sum(value.numel() for value in state.values()) / 1e6 == pytest.approx(millions, abs=0.06)
    assert Sizes.of(state) == sizes
    assert state["vision_encoder.transformer.resblocks.3.mlp.c_fc.weight"].shape == (4 * sizes.width, sizes.width)


def test_towers_are_clips_for_one_frame():
    """With one frame and no temporal embedding ViCLIP is CLIP: the same numbers from the model of transformers."""
    from transformers import CLIPConfig, CLIPModel

    torch.manual_seed(1)
    ours = ViCLIP(replace(TINY, frames=1)).eval()
    for parameter in ours.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    torch.nn.init.zeros_(ours.vision_encoder.temporal_positional_embedding)
    common = {"num_hidden_layers": 2, "hidden_act": "quick_gelu"}
    text = {"hidden_size": 64, "intermediate_size": 256, "num_attention_heads": 1, "vocab_size": TINY.vocabulary}
    text |= {"max_position_embeddings": TINY.context, "eos_token_id": TINY.vocabulary - 1, "bos_token_id": 0}
    vision = {"hidden_size": 128, "intermediate_size": 512, "num_attention_heads": 2, "image_size": 32, "patch_size": 8}
    theirs = CLIPModel(
        CLIPConfig(text_config=text | common, vision_config=vision | common, projection_dim=TINY.embed)
    ).eval()
    theirs.load_state_dict(as_clip(ours.state_dict()) | {"logit_scale": torch.tensor(0.0)}, strict=False)
    ids = torch.randint(1, TINY.vocabulary - 1, (3, TINY.context))
    ids[0, 7] = ids[1, 4] = ids[2, 1] = TINY.vocabulary - 1
    pictures = torch.randn(2, 3, 32, 32)
    with torch.no_grad():
        expected = theirs(input_ids=ids, pixel_values=pictures).logits_per_image
        torch.testing.assert_close(ours.similarity(pictures[:, None], ids), expected, atol=1e-5, rtol=1e-4)


def as_clip(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The same weights under the names of transformers' CLIP."""
    found = {
        "visual_projection.weight": state["vision_encoder.proj"].T,
        "text_projection.weight": state["text_encoder.text_projection"].T,
        "vision_model.embeddings.class_embedding": state["vision_encoder.class_embedding"],
        "vision_model.embeddings.patch_embedding.weight": state["vision_encoder.conv1.weight"][:, :, 0],
        "vision_model.embeddings.position_embedding.weight": state["vision_encoder.positional_embedding"],
        "text_model.embeddings.token_embedding.weight": state["text_encoder.token_embedding.weight"],
        "text_model.embeddings.position_embedding.weight": state["text_encoder.positional_embedding"],
    }
    norms = {
        "vision_encoder.ln_pre": "vision_model.pre_layrnorm",
        "vision_encoder.ln_post": "vision_model.post_layernorm",
    }
    norms |= {"text_encoder.ln_final": "text_model.final_layer_norm"}
    parts = {"ln_1": "layer_norm1", "ln_2": "layer_norm2", "mlp.c_fc": "mlp.fc1", "mlp.c_proj": "mlp.fc2"}
    parts |= {"attn.out_proj": "self_attn.out_proj"}
    for tower, theirs in (("vision_encoder", "vision_model"), ("text_encoder", "text_model")):
        for layer in range(2):
            ours, other = f"{tower}.transformer.resblocks.{layer}.", f"{theirs}.encoder.layers.{layer}."
            norms |= {ours + part: other + name for part, name in parts.items()}
            for kind in ("weight", "bias"):
                pieces = state[f"{ours}attn.in_proj_{kind}"].chunk(3)
                found |= {f"{other}self_attn.{n}_proj.{kind}": p for n, p in zip("qkv", pieces, strict=True)}
    return found | {f"{b}.{kind}": state[f"{a}.{kind}"] for a, b in norms.items() for kind in ("weight", "bias")}


def test_frames_are_told_apart_by_the_temporal_embedding_alone(viclip):
    model = load_viclip(viclip)
    video = torch.randn(1, 8, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    there, back = model.vision_encoder(video), model.vision_encoder(video.flip(1))
    assert (there - back).abs().max() > 1e-2
    model.vision_encoder.temporal_positional_embedding.zero_()
    there, back = model.vision_encoder(video), model.vision_encoder(video.flip(1))
    torch.testing.assert_close(there, back, atol=1e-4, rtol=1e-4)


def test_every_layout_of_a_checkpoint_is_the_same_model(viclip, tmp_path):
    state = torch.load(viclip, weights_only=True)["model"]
    torch.save({f"module.{key}": value for key, value in state.items()}, tmp_path / "bare.pth")
    save_file({key: value.contiguous() for key, value in state.items()}, tmp_path / "a.safetensors")
    for path in (viclip, tmp_path / "bare.pth", tmp_path / "a.safetensors"):
        loaded = load_viclip(path)
        assert loaded.sizes == TINY and not loaded.training
        assert all(torch.equal(value, state[key]) for key, value in loaded.state_dict().items())


def test_pickled_code_and_other_models_are_refused(viclip, tmp_path):
    class Hostile:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    torch.save({"model": Hostile()}, tmp_path / "hostile.pth")
    state = torch.load(viclip, weights_only=True)["model"]
    torch.save({"model": {k: v for k, v in state.items() if "ln_post.bias" not in k}}, tmp_path / "short.pth")
    torch.save({"model": {"a": torch.zeros(1)}}, tmp_path / "other.pth")
    (tmp_path / "text.pth").write_text("not a checkpoint")
    (tmp_path / "text.safetensors").write_text("not a checkpoint")
    names = {"hostile.pth": "cannot be read", "short.pth": "ln_post.bias", "other.pth": "is no ViCLIP"}
    for name, reason in (names | {"text.pth": "cannot be read", "text.safetensors": "cannot be read"}).items():
        with pytest.raises(InputError, match=f"{name}.*{reason}") as refusal:
            load_viclip(tmp_path / name)
        assert "\n" not in str(refusal.value)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(("total", "step"), [(8, 1), (15, 1), (40, 5), (47, 5)])
def test_viclip_sees_every_nth_picture_of_imagenets_mean(total, step):
    pictures = np.broadcast_to(np.arange(total, dtype=np.uint8)[:, None, None, None], (total, 6, 9, 3))
    seen = prepare(pictures, 8, 4)
    grey = torch.arange(8)[:, None] * step / 255
    expected = (grey - torch.tensor(IMAGENET_MEAN)) / torch.tensor(IMAGENET_STD)
    assert seen.shape == (8, 3, 4, 4)
    torch.testing.assert_close(seen, expected[:, :, None, None].expand(8, 3, 4, 4))


def test_pictures_are_squeezed_without_smoothing():
    """Four to one: pixel i of the result lies between 4i + 1 and 4i + 2, and takes the mean of these two alone."""
    pictures = np.random.default_rng(0).integers(0, 256, (8, 16, 8, 3), dtype=np.uint8)
    rows = pictures.astype(float).reshape(8, 4, 4, 8, 3)[:, :, 1:3].mean(2)
    both = rows.reshape(8, 4, 4, 2, 3).mean(3) / 255
    expected = (both - IMAGENET_MEAN) / IMAGENET_STD
    np.testing.assert_allclose(prepare(pictures, 8, 4), expected.transpose(0, 3, 1, 2), atol=1e-5)


def test_clip_tokens_of_a_bpe_file(viclip):
    tokens = load_tokens(find_vocabulary(None, viclip), context=8, vocabulary=TINY.vocabulary)
    start, end = 520, 521
    merged = {"kick": 512 + 2, "ball": 512 + 5, "man": 512 + 7}
    assert tokens("Man kick  BALL").tolist() == [start, merged["man"], merged["kick"], merged["ball"], end, 0, 0, 0]
    letters = sorted(ByteLevel.alphabet())
    assert tokens("ax").tolist()[1:3] == [letters.index("a"), 256 + letters.index("x")]
    assert tokens.cut("man kick") is None
    long = "man kick ball kick ball kick ball man"
    assert tokens(long).tolist() == [start, *(merged[word] for word in long.split()[:6]), end]
    assert tokens.cut(long) == "ball man"


def test_a_tokenizer_folder_does_as_well(viclip, tmp_path):
    tokens = load_tokens(find_vocabulary(None, viclip), 8, TINY.vocabulary)
    tokens.tokenizer.save_pretrained(tmp_path / "clip")
    again = load_tokens(find_vocabulary(tmp_path / "clip", viclip), 8, TINY.vocabulary)
    assert torch.equal(again("man kick axe"), tokens("man kick axe"))
    assert find_viclip(viclip, tmp_path / "clip").identity != find_viclip(viclip).identity


def test_wrong_vocabularies_are_refused(viclip, tmp_path):
    with pytest.raises(InputError, match="no 9999 merges of two"):
        load_tokens(find_vocabulary(None, viclip), 8, 514 + 9999)
    broken = tmp_path / "bpe_simple_vocab_16e6.txt.gz"
    broken.write_bytes(b"not gzip")
    with pytest.raises(InputError, match=r"is no bpe_simple_vocab_16e6.txt.gz"):
        load_tokens(broken, 8, TINY.vocabulary)


def test_viclip_scores_are_cosines_and_what_is_cut_is_told_once(viclip, clip, capsys):
    scorer = find_viclip(viclip).load(CPU)
    scores = scorer(clip)
    model = load_viclip(viclip)
    tokens = load_tokens(find_vocabulary(None, viclip), 8, TINY.vocabulary)
    video = model.vision_encoder(prepare(clip.pictures, 8, 32)[None])[0].double()
    for key, prompt in {"viclip": "scene_prompt", "viclip_motion": "motion_prompt"}.items():
        text = model.text_encoder(tokens(clip.prompts[prompt])[None])[0].double()
        assert scores[key] == pytest.approx(float(video @ text / (video.norm() * text.norm())), abs=1e-5)
    assert scorer(clip) == scores
    said = capsys.readouterr().err
    assert said.count("warning: ViCLIP reads 8 tokens") == 1 and "'man kick ball'" in said
    with pytest.raises(InputError, match="has 7 pictures, ViCLIP looks at 8"):
        scorer(replace(clip, pictures=clip.pictures[:7]))


# Qwen-VL


def test_patches_are_those_of_transformers():
    """A still of two frames is what the image processor makes of the picture; it needs no torchvision."""
    from transformers import Qwen2VLImageProcessorPil

    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (6, 9, 3), dtype=np.uint8)
    for shape, tolerance in (((56, 84, 3), 1e-5), ((70, 100, 3), 2 / 255 / 0.26)):
        picture = np.kron(coarse, np.ones((12, 12, 1), np.uint8))[: shape[0], : shape[1]]
        size = {"shortest_edge": SMALL.least_pixels, "longest_edge": SMALL.most_pixels}
        wanted = Qwen2VLImageProcessorPil(size=size)(picture, return_tensors="pt")
        ours = cut(np.stack([picture] * 2), 8.0, Cells(14, 2, 2), SMALL)
        assert ours.grid == tuple(wanted["image_grid_thw"][0].tolist())
        torch.testing.assert_close(ours.values, wanted["pixel_values"], atol=tolerance, rtol=0)


def test_patches_keep_time_and_place():
    video = np.random.default_rng(0).integers(0, 256, (6, 28, 56, 3), dtype=np.uint8)
    patches = cut(video, 8.0, Cells(14, 2, 2), SMALL)
    assert patches.grid == (3, 2, 4) and patches.seconds == pytest.approx(2 / 8)
    # The patch at time 2, row 1, column 2: within its time the second token of four patches, third of them.
    patch = patches.values[2 * 8 + 1 * 4 + 2].reshape(3, 2, 14, 14)
    pixel = (video[4 + 1, 14 + 5, 28 + 3, 2] / 255 - CLIP_MEAN[2]) / 0.27577711
    assert float(patch[2, 1, 5, 3]) == pytest.approx(pixel, abs=1e-5)


def test_sampling_keeps_to_the_rate_and_to_even_numbers():
    assert sampled(40, 20, 2, 8).tolist() == [0, 3, 5, 8, 10, 13, 16, 18, 21, 23, 26, 29, 31, 34, 36, 39]
    assert len(sampled(16, 20, 2, 8)) == 6 and len(sampled(16, 10, 2, 8)) == 12
    assert sampled(3, 100, 2, 8).tolist() == [0, 2] and len(sampled(100, 100, 2, 1)) == 4
    with pytest.raises(InputError, match="1 pictures"):
        sampled(1, 20, 2, 8)


@pytest.mark.parametrize(
    ("size", "expected"), [((480, 720), (308, 476)), ((240, 360), (280, 392)), ((364, 392), (364, 392))]
)
def test_sizes_are_fitted(size, expected):
    rows, columns = fitted(*size, 28, Sampling())
    assert (rows, columns) == expected
    assert Sampling().least_pixels <= rows * columns <= Sampling().most_pixels
    with pytest.raises(InputError, match="1:200"):
        fitted(1, 201, 28, Sampling())


def test_vqa_is_the_probability_of_the_first_token(qwen, clip):
    """The raw logits of the model's own generate(), with the repetition penalty that would bend its scores."""
    scorer = find_vqa(str(qwen), sampling=SMALL).load(CPU)
    scores = scorer(clip)
    patches = cut(clip.pictures, clip.fps, Cells(14, 2, 2), SMALL)
    tokens = patches.values.shape[0] // 4
    assert scorer.tokenizer.decode(scorer.prompt) == (
        f"<|im_start|>user\n<|vision_start|>{VIDEO}<|vision_end|>{QUESTION}<|im_end|>\n<|im_start|>assistant\n"
    )
    text = scorer.tokenizer.decode(scorer.prompt).replace(VIDEO, VIDEO * tokens)
    ids = scorer.tokenizer(text, return_tensors="pt").input_ids
    out = scorer.model.generate(
        input_ids=ids, attention_mask=torch.ones_like(ids), pixel_values_videos=patches.values,
        mm_token_type_ids=2 * (ids == scorer.tokenizer.convert_tokens_to_ids(VIDEO)).int(),
        video_grid_thw=torch.tensor([patches.grid]), second_per_grid_ts=torch.tensor([patches.seconds]),
        max_new_tokens=1, do_sample=False, repetition_penalty=1.05, output_logits=True, return_dict_in_generate=True,
    )  # fmt: skip
    probabilities = out.logits[0][0].double().softmax(-1)
    yes, no = (float(probabilities[scorer.tokenizer.convert_tokens_to_ids(word)]) for word in (YES, NO))
    assert scores == {"vqa_yes": pytest.approx(yes, rel=1e-4), "vqa_yes_no": pytest.approx(yes / (yes + no), rel=1e-4)}
    assert scores["vqa_yes"] != pytest.approx(1 / len(probabilities), rel=0.05)


def test_a_model_that_knows_nothing_is_even(qwen, clip):
    scorer = find_vqa(str(qwen), sampling=SMALL).load(CPU)
    scorer.model.lm_head.weight.zero_()
    assert scorer(clip) == {
        "vqa_yes": pytest.approx(1 / scorer.model.config.text_config.vocab_size), "vqa_yes_no": pytest.approx(0.5)
    }  # fmt: skip
    scorer.model.lm_head.weight.fill_(float("nan"))
    with pytest.raises(RunError, match="not finite"):
        scorer(clip)


def test_qwen_sees_pictures_their_order_and_their_rate(qwen, clip):
    scorer = find_vqa(str(qwen), sampling=SMALL).load(CPU)
    patches = cut(clip.pictures, clip.fps, Cells(14, 2, 2), SMALL)
    plain = scorer.answer(patches)
    changed = [
        scorer.answer(cut(clip.pictures[::-1], clip.fps, Cells(14, 2, 2), SMALL)),
        scorer.answer(replace(patches, seconds=4 * patches.seconds)),
        scorer.answer(replace(patches, values=patches.values.flip(-1))),
    ]
    assert all((other - plain).abs().max() > 1e-3 for other in changed)
    assert torch.equal(scorer.answer(patches), plain)


def test_qwen2_vl_is_read_too(tmp_path, clip):
    folder = make_qwen(tmp_path / "older", "Qwen2VL")
    scores = find_vqa(str(folder), sampling=SMALL).load(CPU)(clip)
    assert 0 < scores["vqa_yes"] < scores["vqa_yes_no"] < 1


def copy_of(folder: Path, to: Path) -> Path:
    to.mkdir()
    for file in folder.iterdir():
        (to / file.name).write_bytes(file.read_bytes())
    return to


def test_weights_are_never_made_up(qwen, tmp_path):
    """transformers fills what a file lacks with random numbers, and says so only in a warning."""
    folder = copy_of(qwen, tmp_path / "short")
    tensors = load_file(folder / "model.safetensors")
    name = next(key for key in tensors if "mlp.down_proj" in key)
    save_file(
        {key: value for key, value in tensors.items() if key != name}, folder / "model.safetensors", {"format": "pt"}
    )
    with pytest.raises(InputError, match=r"are not those of its config.json") as refusal:
        find_vqa(str(folder)).load(CPU)
    assert "down_proj" in str(refusal.value) and "\n" not in str(refusal.value)
    (folder / "model.safetensors").write_bytes(b"damaged")
    with pytest.raises(InputError, match="cannot be loaded"):
        find_vqa(str(folder)).load(CPU)


def test_foreign_and_incomplete_folders_are_refused(qwen, tmp_path):
    folder = copy_of(qwen, tmp_path / "foreign")
    (folder / "model.safetensors").unlink()
    with pytest.raises(InputError, match=r"lacks \*.safetensors; .*Qwen/Qwen2.5-VL-7B-Instruct.*16.6 GB"):
        find_vqa(str(folder))
    (folder / "model.safetensors").write_bytes(b"")
    (folder / "config.json").write_text('{"model_type": "llama"}')
    with pytest.raises(InputError, match="a model of type 'llama', must be qwen2_vl or qwen2_5_vl"):
        find_vqa(str(folder))


def test_too_large_a_model_is_refused_before_it_is_loaded(tmp_path):
    for name, text in {"config.json": '{"model_type": "qwen2_5_vl"}', "tokenizer_config.json": "{}"}.items():
        (tmp_path / name).write_text(text)
    with open(tmp_path / "model.safetensors", "wb") as file:
        file.truncate(2**43)  # no block of it is written
    with pytest.raises(InputError, match=r"--vqa: the weights take 8796.1 GB, this machine has"):
        find_vqa(str(tmp_path)).load(CPU)
    (tmp_path / "model.safetensors").unlink()


# Records


def test_the_video_of_a_record(tmp_path):
    clip = load(write_run(tmp_path))
    assert clip.pictures.shape == (10, 32, 48, 3) and clip.fps == 20
    np.testing.assert_allclose(clip.pictures.mean((1, 2, 3)), SHADES, atol=3)
    assert clip.prompts == {"scene_prompt": "man kick ball", "motion_prompt": "man"}


def test_the_video_beside_a_record(tmp_path):
    path = write_run(tmp_path, video=False)
    with pytest.raises(InputError, match=r"has no video.*no run.mp4 beside it"):
        load(path)
    write_mp4(encode([np.full((32, 48, 3), shade, np.uint8) for shade in SHADES], 12), tmp_path / "run.mp4")
    clip = load(path)
    assert clip.fps == pytest.approx(12)
    np.testing.assert_allclose(clip.pictures.mean((1, 2, 3)), SHADES, atol=3)
    (tmp_path / "run.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match=r"run.mp4 cannot be decoded"):
        load(path)


@pytest.mark.parametrize("field", ["scene_prompt", "fps"])
def test_a_record_without_a_prompt_or_rate_is_refused(tmp_path, field):
    config = "\n".join(line for line in CONFIG.splitlines() if field not in line)
    with pytest.raises(InputError, match=f"run.mcap: scene.{field} of its config is None"):
        load(write_run(tmp_path, config))


def test_scores_stand_beside_the_record(tmp_path):
    path = write_run(tmp_path / "a")
    assert sidecar.read_scores(path) == {}
    kept = sidecar.Sidecar(record.message_digest(path), {"viclip": 0.25}, {"viclip": "tiny"})
    sidecar.write(sidecar.sidecar_path(path), kept)
    first = sidecar.sidecar_path(path).read_bytes()
    assert sidecar.sidecar_path(path).name == "run.learned.json"
    assert sidecar.read_scores(path) == {"viclip": 0.25} and sidecar.read(sidecar.sidecar_path(path)) == kept
    sidecar.write(sidecar.sidecar_path(path), kept)
    assert sidecar.sidecar_path(path).read_bytes() == first
    assert sorted(file.name for file in path.parent.iterdir()) == ["run.learned.json", "run.mcap"]
    other = write_run(tmp_path / "b", seed=1)
    sidecar.sidecar_path(other).write_bytes(first)
    with pytest.raises(InputError, match="scores of another record"):
        sidecar.read_scores(other)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scores": {"viclip": float("nan")}}, "must be a number from -1 to 1"),
        ({"scores": {"viclip": True}}, "must be a number from -1 to 1"),
        ({"scores": {"viclip": "0.3"}}, "must be a number from -1 to 1"),
        ({"scores": {"viclip": 10**400}}, "from -1 to 1|cannot be read"),
        ({"scores": {"viclip": 1.5}}, "is 1.5, must be a number from -1 to 1"),
        ({"scores": {"vqa_yes": 0.5}}, "not models.vqa"),
        ({"scores": {"beauty": 0.5}}, "scores.beauty is none of viclip"),
        ({"scores": [1]}, "scores and models objects"),
        ({"models": {"viclip": 3}}, "models.viclip must be a text"),
        ({"record": None}, "record must be a text"),
        ({"more": 1}, "an object of record, scores and models"),
    ],
)
def test_malformed_scores_are_refused_by_name(tmp_path, change, reason):
    path = tmp_path / "run.learned.json"
    path.write_text(json.dumps({"record": "", "scores": {}, "models": {"viclip": "tiny"}} | change))
    with pytest.raises(InputError, match=reason) as refusal:
        sidecar.read(path)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def test_reading_scores_needs_no_model():
    code = (
        "import sys, analysis.learned.sidecar; print([m for m in ('torch', 'transformers', 'av') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# The command


def test_one_model_after_the_other_over_a_folder(viclip, qwen, tmp_path, capsys):
    first, second = write_run(tmp_path / "a"), write_run(tmp_path / "b", seed=1)
    blind = write_run(tmp_path / "c", video=False, seed=2)
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "run.mcap").write_bytes(b"foreign")
    cli.main([str(tmp_path), "--viclip", str(viclip), "--device", "cpu"])
    said = capsys.readouterr()
    assert "viclip: 2 scored, 0 had their scores, 2 skipped" in said.out
    assert f"skipped: {blind} has no video" in said.err and "d/run.mcap is not an MCAP file" in said.err
    assert not sidecar.sidecar_path(blind).exists()
    scores = sidecar.read_scores(first)
    assert set(scores) == {"viclip", "viclip_motion"}
    scorer = find_viclip(viclip).load(CPU)
    assert scores == scorer(load(first))

    assert score([first, second], "vqa", find_vqa(str(qwen), sampling=SMALL), CPU).scored == 2
    both = sidecar.read_scores(first)
    assert set(both) == set(sidecar.SCORES) and {key: both[key] for key in scores} == scores
    before = sidecar.sidecar_path(first).read_bytes()
    cli.main([str(tmp_path), "--viclip", str(viclip)])
    assert "viclip: 0 scored, 2 had their scores, 2 skipped" in capsys.readouterr().out
    sidecar.sidecar_path(first).write_text("{")
    cli.main([str(tmp_path), "--viclip", str(viclip)])
    assert score([first], "vqa", find_vqa(str(qwen), sampling=SMALL), CPU).scored == 1
    assert sidecar.sidecar_path(first).read_bytes() == before


def test_another_question_is_another_score(qwen, tmp_path):
    path = write_run(tmp_path)
    assert score([path], "vqa", find_vqa(str(qwen), sampling=SMALL), CPU).scored == 1
    plain = sidecar.read_scores(path)
    other = find_vqa(str(qwen), QUESTION + " Please answer Yes or No.", SMALL)
    assert score([path], "vqa", other, CPU).scored == 1
    assert sidecar.read_scores(path)["vqa_yes"] != plain["vqa_yes"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "give --viclip FILE, --vqa FOLDER or both"),
        (["--viclip", "no.pth"], "no ViCLIP checkpoint at no.pth; expected ViCLIP-L_.*OpenGVLab/ViCLIP, 1.7 GB"),
        (["--vqa", "no-folder"], "no Qwen2-VL or Qwen2.5-VL at no-folder: .*Qwen/Qwen2.5-VL-7B-Instruct.*16.6 GB"),
        (["--viclip", "{bare}"], "needs CLIP's vocabulary: put bpe_simple_vocab_16e6.txt.gz .1.4 MB.* beside"),
        (["--viclip", "{viclip}", "--clip-vocab", "no.gz"], "no.gz is neither bpe_simple_vocab_16e6.txt.gz nor"),
        (["--viclip", "{viclip}"], "no run.mcap below it"),
    ],
)
def test_what_is_missing_is_said_in_one_line(options, said, viclip, tmp_path, capsys):
    bare = tmp_path / "elsewhere" / "a.pth"
    bare.parent.mkdir()
    bare.write_bytes(viclip.read_bytes())
    with pytest.raises(SystemExit) as stop:
        cli.main([str(tmp_path), *(option.format(viclip=viclip, bare=bare) for option in options)])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("analysis.learned: ") and re.search(said, lines[0])


def test_nothing_scored_is_no_success(viclip, tmp_path, capsys):
    write_run(tmp_path, video=False)
    with pytest.raises(SystemExit) as stop:
        cli.main([str(tmp_path), "--viclip", str(viclip)])
    assert stop.value.code == 2 and "no record could be scored" in capsys.readouterr().err
