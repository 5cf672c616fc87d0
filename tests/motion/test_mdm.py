import math

import torch
import torch.nn.functional as F

from hoi.motion.mdm import Architecture, MotionDenoiser, sinusoids

TINY = Architecture(features=9, text_dim=7, latent_dim=16, ff_size=24, layers=2, heads=4, registers=2)


def tiny(seed: int = 0) -> MotionDenoiser:
    torch.manual_seed(seed)
    return MotionDenoiser(TINY).eval()


def inputs(batch: int = 2, frames: int = 6) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(batch, frames, TINY.features, generator=generator)
    return x, torch.tensor([3, 70])[:batch], torch.randn(batch, TINY.text_dim, generator=generator)


def test_names_and_shapes_are_the_published_ones():
    with torch.device("meta"):
        shapes = {name: tuple(value.shape) for name, value in MotionDenoiser(Architecture()).state_dict().items()}
    layer = {
        "self_attn.in_proj_weight": (1536, 512), "self_attn.in_proj_bias": (1536,),
        "self_attn.out_proj.weight": (512, 512), "self_attn.out_proj.bias": (512,),
        "linear1.weight": (2048, 512), "linear1.bias": (2048,), "linear2.weight": (512, 2048), "linear2.bias": (512,),
        "norm1.weight": (512,), "norm1.bias": (512,), "norm2.weight": (512,), "norm2.bias": (512,),
    }  # fmt: skip
    expected = {f"seqTransEncoder.layers.{i}.{name}": shape for i in range(8) for name, shape in layer.items()} | {
        "registers": (2, 512), "skel_embedding.weight": (512, 205), "skel_embedding.bias": (512,),
        "tx_embedding.0.weight": (1024, 512), "tx_embedding.0.bias": (1024,),
        "tx_embedding.2.weight": (512, 1024), "tx_embedding.2.bias": (512,),
        "tx_embedding.3.weight": (512,), "tx_embedding.3.bias": (512,),
        "timestep_encoder.time_embed.0.weight": (512, 512), "timestep_encoder.time_embed.0.bias": (512,),
        "timestep_encoder.time_embed.2.weight": (512, 512), "timestep_encoder.time_embed.2.bias": (512,),
        "to_skel_layer.weight": (205, 512), "to_skel_layer.bias": (205,),
    }  # fmt: skip
    assert shapes == expected
    assert len(shapes) == 111 and sum(math.prod(shape) for shape in shapes.values()) == 27_007_181


def reference_forward(w: dict[str, torch.Tensor], x, t, text):
    """The published forward pass, written out: pre-norm, positions on all tokens, no norm at the end."""

    def linear(name, value):
        return F.linear(value, w[f"{name}.weight"], w[f"{name}.bias"])

    def norm(name, value):
        return F.layer_norm(value, value.shape[-1:], w[f"{name}.weight"], w[f"{name}.bias"])

    batch, dim = len(x), TINY.latent_dim
    table = torch.tensor(
        [[(math.sin, math.cos)[i % 2](p / 10000 ** ((i - i % 2) / dim)) for i in range(dim)] for p in range(100)]
    )
    time = linear("timestep_encoder.time_embed.2", F.silu(linear("timestep_encoder.time_embed.0", table[t])))
    sentence = linear("tx_embedding.2", F.gelu(linear("tx_embedding.0", text)))
    sentence = norm("tx_embedding.3", sentence)
    h = torch.cat(
        [time[:, None], sentence[:, None], w["registers"].repeat(batch, 1, 1), linear("skel_embedding", x)], dim=1
    )
    h = h + table[: h.shape[1]]
    for i in range(TINY.layers):
        name = f"seqTransEncoder.layers.{i}"
        qkv = F.linear(
            norm(f"{name}.norm1", h), w[f"{name}.self_attn.in_proj_weight"], w[f"{name}.self_attn.in_proj_bias"]
        )
        q, k, v = (part.unflatten(-1, (TINY.heads, -1)).transpose(1, 2) for part in qkv.chunk(3, dim=-1))
        attention = (q @ k.transpose(-1, -2) / math.sqrt(dim / TINY.heads)).softmax(-1) @ v
        h = h + linear(f"{name}.self_attn.out_proj", attention.transpose(1, 2).flatten(-2))
        h = h + linear(f"{name}.linear2", F.gelu(linear(f"{name}.linear1", norm(f"{name}.norm2", h))))
    return linear("to_skel_layer", h[:, -x.shape[1] :])


def test_forward_is_the_published_one():
    denoiser = tiny()
    for grad in (False, True):  # torch takes another path through the encoder without gradients
        with torch.set_grad_enabled(grad):
            got = denoiser(*inputs())
        torch.testing.assert_close(got, reference_forward(denoiser.state_dict(), *inputs()), atol=1e-5, rtol=1e-4)


def test_padded_frames_change_nothing():
    denoiser = tiny()
    x, t, text = inputs()
    padded = torch.cat([x, torch.full((2, 3, TINY.features), 50.0)], dim=1)
    mask = torch.arange(9).expand(2, 9) < 6
    with torch.no_grad():
        torch.testing.assert_close(denoiser(padded, t, text, mask)[:, :6], denoiser(x, t, text), atol=1e-5, rtol=1e-4)


def test_sinusoids_are_as_long_and_wide_as_asked():
    table = sinusoids(5, 8)
    assert table.shape == (5, 8) and table[0].tolist() == [0, 1] * 4
    assert float(table[3, 0]) == float(torch.tensor(3.0).sin())
