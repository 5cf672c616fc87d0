"""Any sentence, path and order of words after `hoi run`."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from hoi.config.compose import config_of
from hoi.errors import InputError
from hoi.motion.familiarity import EMBEDDED, read_captions
from hoi.motion.sentence import limbs_in
from hoi.motion.text import minilm
from hoi.runner.arguments import SENTENCE, arguments
from hoi.terminal.overrides import as_override

SWEEPS = str(Path(__file__).parents[2] / "sweeps")
SENTENCES = [
    "a person kicks the ball", "a person's kick, hard", "kick: now!", "a = b", "kick & punch", "kick | punch; stop",
    "a (very) hard kick", "a [very] hard kick", "a {very} hard kick", 'a "hard" kick', "a 'hard' kick", "kick\\", "\\'",
    "100% effort", "$HOME kicks", "${nothing} kicks", "${scene kicks", "kick @ 5 m/s", "kick #1", "~ kicks", "+ kicks",
    "- kicks", "--kicks hard", "-5 degrees of kick", "kick *", "kick?", "¿kick?", "kick, kick, kick", "kick... kick",
    "a person kicks 🙂", "🙂⚽", "踢球", "ボールを蹴る", "공을 차다", "человек бьёт по мячу",
    "اركل الكرة",
    "un coup de pied, l'été",
    "ein Fußtritt gegen den Ball", "una patada fuerte, ¡ya!", "kick" * 300, "kick " * 400, "k", "null kick", "true",
    "null", "1e5", "3", "0x10", "[kick]", "{kick: hard}", "choice(a,b) kick", "range(1,3)", "kick\nhard", "kick\thard",
    "  kick  ", "a person kicks with the left foot and with the right foot, no, neither", "<b>kick</b>", "kick`s`",
    "kick ^ hard", "kick … hard — “now”", "kick/hard", "c:\\kick", "a,b", "kick: {a, b}", "!kick", "kick='hard'",
]  # fmt: skip


def sentence_of(words: list[str]) -> str:
    """What Hydra makes of the command line's sentence, as the config has it."""
    (read,) = [
        override for override in OverridesParser.create().parse_overrides(words) if override.key_or_group == SENTENCE
    ]
    assert not read.is_sweep_override()
    return str(read.value())


def test_there_are_enough():
    assert len(set(SENTENCES)) >= 60


@pytest.mark.parametrize("sentence", SENTENCES, ids=range(len(SENTENCES)))
def test_a_sentence_means_itself(sentence):
    """As the value of its key, and alone where it is no KEY=VALUE."""
    expected = " ".join(sentence.splitlines())
    both = [[f"{SENTENCE}={sentence}"]] + ([[sentence]] if "=" not in sentence else [])
    for typed in both:
        read = sentence_of(arguments([*typed, "seed=1"]))
        assert read.replace("\\${", "${").strip() == expected.strip()


def test_sentences_are_typed_in_a_shell(tmp_path):
    """Every ninth, as a shell hands it on; the plan says how far it is from what the prior knows."""
    typed = [" ".join(sentence.splitlines()) for sentence in SENTENCES[::9]]
    captions = read_captions(EMBEDDED)
    assert captions is not None
    cache = tmp_path / "cache" / "hoi" / "text"  # filled by one process: the encoder takes seconds to load
    minilm(cache).embed(list(dict.fromkeys(filter(None, [*typed, *map(captions.familiar_words, typed)]))))
    limbs = "scene.striking_limb=null scene.expected_limb=any plan_only=true"
    command = f"{shlex.quote(sys.executable)} -m hoi run"
    words = [f"{SENTENCE}={sentence}" if "=" in sentence else sentence for sentence in SENTENCES[::9]]
    script = "\n".join(f"{command} {shlex.quote(word)} {limbs} || echo FAILED $?" for word in words)
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    own = sum(each in captions.sentences for each in typed)
    assert done.stdout.count("variant full") == len(words) == done.stdout.count("CHECK  sentence") + own, done.stdout
    assert "FAILED" not in done.stdout and not done.stderr, done.stderr


@pytest.mark.parametrize("sentence", ["a person's kick, hard: ${x} = & 踢球 🙂", "\\' 100% [left] {right}", "null"])
def test_a_sentence_arrives(sentence):
    config = config_of(*arguments([f"{SENTENCE}={sentence}", "scene.striking_limb=null", "scene.expected_limb=any"]))
    assert config.scene.motion_prompt == sentence


@pytest.mark.parametrize(
    "value", ["a (b).ply", "ä ö.ply", "a,b.ply", "a'b.ply", "a=b", "{x}", "null", "a b", "x.ply", "~/x"]
)
def test_a_path_means_itself(value):
    for typed in (f"object.path={value}", as_override("object.path", value)):
        (word,) = arguments([typed])
        if value == "null" and typed == "object.path=null":
            continue
        assert OverridesParser.create().parse_override(word).value() == value


def test_flags_stand_anywhere_and_sweeps_stay_sweeps():
    made = arguments(["experiment=smoke", "-m", "seed=0,1", "--config-dir", "sweeps", "object.path=a,b"])
    assert made == ["-m", "--config-dir", "sweeps", "experiment=smoke", "seed=0,1", "object.path=a,b"]


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["--foo"], "no option --foo"), (["--resolve"], "--resolve goes with"), (["-m", "--cfg", "job"], "do not go"),
        ([""], "is empty"), (["a b", "c d"], "two sentences"), (["a \udcff b"], "no text in UTF-8"),
        (["scene=null"], "scene must be one of"), (["a b", f"{SENTENCE}=c"], "two sentences"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_one_line(typed, message):
    with pytest.raises(InputError, match=message) as caught:
        arguments(typed)
    assert "\n" not in str(caught.value)


def test_bytes_of_utf_8_are_text_in_any_locale():
    typed = "踢球".encode().decode("ascii", "surrogateescape")
    if sys.getfilesystemencoding() == "utf-8":
        assert sentence_of(arguments([typed])) == "踢球"


@pytest.mark.parametrize(
    ("sentence", "limbs"),
    [
        ("a person kicks with the left foot", ["left_foot"]), ("a person throws a left jab", ["left_hand"]),
        ("a person turns left and kicks with his right foot", ["right_foot"]), ("a person kicks", ["feet"]),
        ("a person pushes with both hands", ["hands"]), ("a person kicks the ball to the left", ["feet"]),
        ("a knee strike with the right knee", ["right_knee"]), ("a person dances", []),
        ("punches with the left hand and kicks with the right foot", ["left_hand", "right_foot"]),
    ],
)  # fmt: skip
def test_the_limb_in_a_sentence(sentence, limbs):
    assert limbs_in(sentence) == limbs


def test_the_sentence_names_the_limb_of_the_scene():
    left = config_of(f"{SENTENCE}=a person kicks with the left foot").scene
    assert (left.striking_limb, left.expected_limb, left.contact_joint) == ("left_foot",) * 3
    for overrides in (["scene.striking_limb=right_foot"], ["scene=push_box"]):
        with pytest.raises(InputError, match=r"scene\.striking_\w+ must be left_foot, which"):
            config_of(*overrides, f"{SENTENCE}=a person kicks with the left foot")
    with pytest.raises(InputError, match="names left_hand and right_foot: say which"):
        config_of(f"{SENTENCE}=punches with the left hand and kicks with the right foot")


# --- consoles ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        "-m hoi",
        "-m hoi run --help",
        "-m hoi run plan_only=true",
        "-m hoi run -m seed=0,1 plan_only=true",
        "-m analysis.metrics",
    ],
)
def test_a_console_that_goes_away_is_no_error(command, tmp_path):
    """As `| head` leaves it: nobody reads what is written."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as console:
        done = subprocess.run([sys.executable, *command.split()], cwd=tmp_path, stdout=console, stderr=subprocess.PIPE)
    assert done.returncode == 0 and b"Traceback" not in done.stderr and b"BrokenPipe" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["~seed"], 2, "seed: no value given"), (["+scene.striking_lmib=a"], 2, "scene.striking_limb"),
        (["scene=kick_socer_ball"], 2, "the nearest is scene=kick_soccer_ball"),
        (["seed=99999999999999999999"], 2, "seed must be at most"), (["scene.fsp=3"], 2, "the nearest is scene.fps"),
        (["--config-dir", SWEEPS, "--config-name", "ablations", "hydra.launcher.foo=1"], 2, "hydra.launcher.foo: Key"),
        (["--config-dir", SWEEPS, "--config-name", "ablations", "scene.fsp=0,1"], 2, "the nearest is scene.fps"),
        (["-m", "seed=-1", "hydra/sweeper=basic", "out=here"], 3, "seed must be 0 or more"),
        (["-m", "seed=-1", "out=${now:%Y}/${seed}"], 3, "1 of 1 runs failed"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_a_line(arguments, code, said, tmp_path):
    done = subprocess.run([sys.executable, "-m", "hoi.run", *arguments], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == code and said in done.stderr and "Traceback" not in done.stderr, done.stderr
