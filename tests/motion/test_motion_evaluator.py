import pytest
import torch
from safetensors.torch import save_file

from hoi.errors import InputError
from hoi.motion.evaluator import load_evaluator, save_evaluator
from hoi.training.motion.dataset import TrainingSet
from hoi.training.motion.evaluator import contrast, train_evaluator


def two_kinds(seed: int = 0, windows: int = 60) -> TrainingSet:
    """Windows whose first features rise or fall."""
    generator = torch.Generator().manual_seed(seed)
    rising = torch.arange(windows) % 2
    ramp = torch.linspace(-1, 1, 40)[None, :, None] * (2 * rising - 1)[:, None, None]
    features = 0.3 * torch.randn(windows, 40, 205, generator=generator)
    features[..., :50] += ramp
    captions = ["", "a person punches with the left hand", "jabs with the left hand", "a person kicks a ball"]
    choices = [[3] if up else [1, 2] for up in rising.tolist()]
    kinds = ["kick" if up else "punch/left" for up in rising.tolist()]
    return TrainingSet(
        features, torch.full((windows,), 1 / windows), choices, captions, kinds, torch.zeros(24, 3), {"both": windows}
    )


def test_it_learns_which_sentence_describes_a_motion(tmp_path):
    data = two_kinds()
    evaluator = train_evaluator(data, steps=30, batch=32)
    unseen = two_kinds(seed=1)
    motions = evaluator.embed_motion(unseen.features)
    likeness = motions @ evaluator.embed_text(["someone kicks a ball", "a left punch"]).T
    assert torch.equal(likeness[:, 0] > likeness[:, 1], torch.arange(60) % 2 == 1)
    torch.testing.assert_close(motions.norm(dim=-1), torch.ones(60))

    path = tmp_path / "judge" / "evaluator.safetensors"
    save_evaluator(evaluator, path)
    again = load_evaluator(path)
    torch.testing.assert_close(again.embed_motion(unseen.features), motions)

    assert float(again.strangeness(data.features).max()) < 0.3
    noise = torch.randn(unseen.features.shape, generator=torch.Generator().manual_seed(2))
    assert float(again.strangeness(3 * noise).min()) > float(again.strangeness(unseen.features).max())


def test_sentences_that_fit_as_well_are_no_mistake():
    motion = torch.eye(4)
    fits = torch.eye(4, dtype=torch.bool)
    assert float(contrast(motion, motion, fits)) < 1e-3
    twins = torch.eye(4)
    twins[1] = twins[0]
    fits[0, 1] = fits[1, 0] = True
    shared = contrast(twins, twins, fits)
    assert float(shared) == pytest.approx(0.5 * float(torch.log(torch.tensor(2.0))), abs=1e-3)
    assert float(contrast(motion, motion.roll(1, 0), torch.eye(4, dtype=torch.bool))) > 5


def test_other_files_are_refused_in_one_line(tmp_path):
    path = tmp_path / "evaluator.safetensors"
    with pytest.raises(InputError, match="cannot be read"):
        load_evaluator(path)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read"):
        load_evaluator(path)
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(InputError, match="format is None"):
        load_evaluator(path)
    save_file({"a": torch.zeros(1)}, path, {"format": "hoi motion evaluator 1", "text_encoder": "0"})
    with pytest.raises(InputError, match="another text encoder"):
        load_evaluator(path)
