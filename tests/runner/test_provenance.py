"""What a record says of the files that a run was given."""

import hashlib

from hoi.runner.provenance import digest, provenance


def test_files_and_folders_have_digests(tmp_path) -> None:
    """A folder's is that of what sha256sum prints of its files, by name."""
    (tmp_path / "unet").mkdir()
    (tmp_path / "unet" / "weights.safetensors").write_bytes(b"weights")
    (tmp_path / "config.json").write_bytes(b"{}")
    one, two = hashlib.sha256(b"{}").hexdigest(), hashlib.sha256(b"weights").hexdigest()
    assert digest(tmp_path / "config.json") == one
    listing = f"{one}  config.json\n{two}  unet/weights.safetensors\n"
    assert digest(tmp_path) == hashlib.sha256(listing.encode()).hexdigest()
    (tmp_path / "config.json").write_bytes(b"{ }")
    assert digest(tmp_path) != hashlib.sha256(listing.encode()).hexdigest()


def test_every_checkpoint_of_a_run_is_recorded(composed, tmp_path) -> None:
    prior, video = tmp_path / "motion.safetensors", tmp_path / "video"
    prior.write_bytes(b"motion")
    video.mkdir()
    (video / "video_prior.safetensors").write_bytes(b"video")
    overrides = [f"stage.motion.checkpoint={prior}", f"stage.refine.checkpoint={video}"]
    made = composed(*overrides)
    facts = provenance(made, overrides)
    assert facts["sha256.stage.motion.checkpoint"] == hashlib.sha256(b"motion").hexdigest()
    assert facts["sha256.stage.refine.checkpoint"] == digest(video)
    assert not any(name.startswith("sha256.") for name in provenance(composed(), []))
