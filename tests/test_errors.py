"""Who says what in the line of an input error: the field below, the config's key above."""

import pickle

import pytest

from hoi.errors import InputError, about, under


def test_a_line_or_a_field_with_its_value_and_rule() -> None:
    assert str(InputError("ball.ply: not a PLY file")) == "ball.ply: not a PLY file"
    assert str(InputError("seed", -1, "0 or more")) == "seed must be 0 or more, got -1"
    assert str(InputError("path", None, "given")) == "path must be given, got None"


def test_the_key_is_put_before_the_field() -> None:
    with pytest.raises(InputError, match=r"^stage\.refine\.checkpoint: no prior at x$"), under("stage.refine"):
        raise InputError("checkpoint: no prior at x")
    with pytest.raises(InputError, match=r"^stage\.motion\.fps must be 1 or more, got 0$"), under("stage"):
        with under("motion"):
            raise InputError("fps", 0, "1 or more")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("up: cannot tell; say up=y or z", "a.b.up: cannot tell; say a.b.up=y or z"),
        ("checkpoint: none; checkpoint=null takes ours", "a.b.checkpoint: none; a.b.checkpoint=null takes ours"),
        ("width 7: none; stage/refine=none", "a.b.width 7: none; stage/refine=none"),
        (
            "prior=x takes 3 GB; set offload=true or lower width",
            "a.b.prior=x takes 3 GB; set a.b.offload=true or lower width",
        ),
        ("path: no file runs/seed=0/x", "a.b.path: no file runs/seed=0/x"),
    ],
)
def test_so_it_is_before_what_a_line_proposes(line: str, expected: str) -> None:
    with pytest.raises(InputError) as caught, under("a"), under("b"):
        raise InputError(line)
    assert str(caught.value) == expected


def test_a_line_about_a_file_gets_no_key() -> None:
    with pytest.raises(InputError, match=r"^walk\.bvh: hips: no channels$") as caught, under("stage.motion"):
        with about("walk.bvh"), about("hips"):
            raise InputError("no channels")
    assert pickle.loads(pickle.dumps(caught.value)).has_subject  # another process may hand it on


def test_fields_tell_what_is_the_keys_own() -> None:
    for line, expected in (
        ("up: cannot tell", "stage.motion.up: cannot tell"),
        ("start_time must be 0", "stage.motion.start_time must be 0"),
        ("up/walk.npz: no such file", "up/walk.npz: no such file"),
        ("walk.npz lacks trans", "walk.npz lacks trans"),
        ("walk.npz: two; such as up=y", "walk.npz: two; such as stage.motion.up=y"),
    ):
        with pytest.raises(InputError) as caught, under("stage.motion", "up", "start_time"):
            raise InputError(line)
        assert str(caught.value) == expected


def test_other_errors_pass_through() -> None:
    for context in (under("stage"), about("file")):
        with pytest.raises(ValueError, match=r"^as it is$"), context:
            raise ValueError("as it is")
