"""The published motion prior from the files its users have, tiny and with random weights."""

import json
from pathlib import Path

import numpy as np
import torch

from hoi.body.people import load_person

LATENT, FF, LAYERS = 32, 64, 2


def published_layout() -> dict[str, tuple[int, ...]]:
    """Names and shapes of the checkpoint as its authors' code has them; the sizes are ours."""
    shapes: dict[str, tuple[int, ...]] = {"registers": (2, LATENT)}

    def linear(name: str, out: int, into: int) -> None:
        shapes.update({f"{name}.weight": (out, into), f"{name}.bias": (out,)})

    def norm(name: str) -> None:
        shapes.update({f"{name}.weight": (LATENT,), f"{name}.bias": (LATENT,)})

    linear("tx_embedding.0", 2 * LATENT, 512)
    linear("tx_embedding.2", LATENT, 2 * LATENT)
    norm("tx_embedding.3")
    linear("skel_embedding", LATENT, 205)
    linear("timestep_encoder.time_embed.0", LATENT, LATENT)
    linear("timestep_encoder.time_embed.2", LATENT, LATENT)
    for layer in range(LAYERS):
        name = f"seqTransEncoder.layers.{layer}"
        shapes.update({f"{name}.self_attn.in_proj_weight": (3 * LATENT, LATENT)})
        shapes.update({f"{name}.self_attn.in_proj_bias": (3 * LATENT,)})
        linear(f"{name}.self_attn.out_proj", LATENT, LATENT)
        linear(f"{name}.linear1", FF, LATENT)
        linear(f"{name}.linear2", LATENT, FF)
        norm(f"{name}.norm1")
        norm(f"{name}.norm2")
    linear("to_skel_layer", 205, LATENT)
    statistics = {"motion_normalizer": (205,), "text_normalizer": (512,)}
    return {f"denoiser.{name}": shape for name, shape in shapes.items()} | {
        f"{name}.{part}": shape for name, shape in statistics.items() for part in ("mean", "std")
    }


def write_stmc(folder: Path) -> dict[str, torch.Tensor]:
    """A run folder as the published archive unpacks, with CLIP's text tower and rest joints put into it.

    Returns:
        the checkpoint's tensors.
    """
    from transformers import CLIPTextConfig, CLIPTextModelWithProjection

    generator = torch.Generator().manual_seed(0)
    state = {name: 0.1 * torch.randn(shape, generator=generator) for name, shape in published_layout().items()}
    checkpoint = folder / "logs" / "checkpoints" / "last.ckpt"
    checkpoint.parent.mkdir(parents=True)
    for name in ("motion_normalizer", "text_normalizer"):
        state[f"{name}.std"] = state[f"{name}.std"].abs() + 0.1
        (folder / name.replace("_normalizer", "_stats")).mkdir()
        for part in ("mean", "std"):
            torch.save(state[f"{name}.{part}"].clone(), folder / name.replace("_normalizer", "_stats") / f"{part}.pt")
    lightning = {"epoch": 3, "global_step": 7, "pytorch-lightning_version": "2.0.9", "optimizer_states": [{}]}
    torch.save(lightning | {"state_dict": state, "hparams_name": "kwargs", "callbacks": {}}, checkpoint)
    denoiser = {"latent_dim": LATENT, "ff_size": FF, "num_layers": LAYERS, "num_heads": 4, "nb_registers": 2}
    config = {
        "diffusion": {"denoiser": denoiser, "timesteps": 12, "prediction": "x"},
        "data": {"motion_loader": {"fps": 20.0, "nfeats": 205}},
        "motion_features": "smplrifke",
    }
    (folder / "config.json").write_text(json.dumps(config))
    np.save(folder / "rest_joints.npy", load_person("man", 100).rest_joints)

    letters = "abcdefghijklmnopqrstuvwxyz"
    vocabulary = [*letters, *(letter + "</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    tower = CLIPTextConfig(
        vocab_size=len(vocabulary), hidden_size=16, intermediate_size=32, projection_dim=512, num_hidden_layers=2,
        num_attention_heads=2, bos_token_id=52, eos_token_id=53, pad_token_id=53,
    )  # fmt: skip
    torch.manual_seed(0)
    CLIPTextModelWithProjection(tower).save_pretrained(folder / "clip")
    (folder / "clip" / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(vocabulary)}))
    (folder / "clip" / "merges.txt").write_text("#version: 0.2\n")
    return state
