"""A CogVideoX of a few thousand random weights in the layout of the real one: the same classes, files and loading."""

import json
from pathlib import Path

import sentencepiece
import torch
from diffusers import AutoencoderKLCogVideoX, CogVideoXDDIMScheduler, CogVideoXTransformer3DModel
from transformers import T5Config, T5EncoderModel

SCHEDULER_5B = {
    "num_train_timesteps": 1000, "beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear",
    "clip_sample": False, "prediction_type": "v_prediction", "rescale_betas_zero_snr": True,
    "set_alpha_to_one": True, "timestep_spacing": "trailing", "snr_shift_scale": 1.0,
}  # fmt: skip
TRANSFORMER = {
    "num_attention_heads": 4, "attention_head_dim": 16, "in_channels": 4, "out_channels": 4, "time_embed_dim": 8,
    "text_embed_dim": 32, "num_layers": 2, "sample_width": 6, "sample_height": 4, "sample_frames": 49,
    "patch_size": 2, "temporal_compression_ratio": 4, "max_text_seq_length": 16,
    "use_rotary_positional_embeddings": True,
}  # fmt: skip
VAE = {
    "down_block_types": ("CogVideoXDownBlock3D",) * 4, "up_block_types": ("CogVideoXUpBlock3D",) * 4,
    "block_out_channels": (8, 8, 8, 8), "latent_channels": 4, "layers_per_block": 1, "norm_num_groups": 2,
    "scaling_factor": 0.7, "sample_height": 32, "sample_width": 48,
}  # fmt: skip
SENTENCES = (
    "a man kicks a soccer ball hard with his right foot",
    "blurry distorted body with extra limbs, penetration of the foot, floating",
    "the ball deforms slightly and flies away in the direction of the kick",
)


def build(folder: Path, transformer: dict | None = None, scheduler: dict | None = None) -> Path:
    """Random weights from one seed, float32."""
    torch.manual_seed(0)
    denoiser = CogVideoXTransformer3DModel(**{**TRANSFORMER, **(transformer or {})})
    for parameter in denoiser.parameters():  # freshly made, the last layers are close to nothing
        torch.nn.init.normal_(parameter, std=0.2)
    denoiser.save_pretrained(folder / "transformer")
    AutoencoderKLCogVideoX(**VAE).save_pretrained(folder / "vae")
    CogVideoXDDIMScheduler(**{**SCHEDULER_5B, **(scheduler or {})}).save_pretrained(folder / "scheduler")
    text = T5Config(vocab_size=64, d_model=32, d_kv=8, d_ff=37, num_layers=2, num_heads=4)
    T5EncoderModel(text).save_pretrained(folder / "text_encoder")
    tokenizer = folder / "tokenizer"
    tokenizer.mkdir()
    (folder / "sentences.txt").write_text("\n".join(SENTENCES * 20))
    sentencepiece.SentencePieceTrainer.train(
        input=str(folder / "sentences.txt"), model_prefix=str(tokenizer / "spiece"), vocab_size=44,
        pad_id=0, eos_id=1, unk_id=2, bos_id=-1, minloglevel=2,
    )  # fmt: skip
    settings = {"tokenizer_class": "T5Tokenizer", "extra_ids": 0, "model_max_length": 226}
    (tokenizer / "tokenizer_config.json").write_text(json.dumps(settings))
    names = {"_class_name": "CogVideoXPipeline", "transformer": ["diffusers", "CogVideoXTransformer3DModel"]}
    (folder / "model_index.json").write_text(json.dumps(names))
    return folder
