"""What a prior was trained on and what not, told from the sentence: held-out paraphrases against other acts."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from hoi.config.compose import config_of
from hoi.motion import text
from hoi.motion.familiarity import CAPTIONS_NAME, EMBEDDED, STRIKES, familiarity, read_captions, sentence_check
from hoi.motion.text import minilm
from hoi.plan import make_plan
from hoi.runner.arguments import arguments

PARAPHRASES = [
    "a woman kicks a pumpkin", "the player smashes the ball with his right boot", "a kid boots a can down the street",
    "somebody gives the crate a kick", "a person kicks a plush bear with the left leg", "the striker takes a free kick",
    "a fighter does a spinning back kick", "a person swings the leg and kicks a bucket", "an athlete kicks it far",
    "a person does a side kick to the barrel", "he kicks the door open", "a person kicks softly against a balloon",
    "a boxer throws a left hook at the bag", "a person punches the pillow", "a man throws a punch at the wall",
    "she jabs twice", "a person hits the dummy with a straight right", "a person punches the vase off the table",
    "a tired boxer punches slowly", "a strong man punches a block of ice", "a person strikes the melon with the fist",
    "a person pushes the fridge", "two hands push a heavy crate", "a person shoves the barrel over with both arms",
    "a worker pushes a cart forward", "a person gives the box a gentle push", "a person pushes away a chair",
    "a person knees the bag", "a fighter lands a knee strike", "a person hits the pad with the left knee",
    "a karate master strikes the board with his hand", "a person kicks and then punches", "the person kicks forward",
    "right leg kick", "left punch", "a goalkeeper kicks the ball away", "a ninja kicks high",
    "a person runs towards the ball and kicks it", "a person pushes a sofa across the room", "a person boxes",
    "a woman kicks a tin bucket", "a girl punches a piñata", "an old lady pushes a wheelbarrow",
    "the centre forward kicks the ball with the instep", "a person jabs a snowman with the left hand",
    "a person shoves the statue backwards", "a soldier kicks over a chair", "a person uppercuts the melon",
    "a fighter's right knee hits the dummy", "a person kicks the garden gnome",
    "a person punches through a cardboard wall", "a person pushes the piano", "a child kicks a pebble",
    "a person side-kicks the tyre", "a person kicks a cactus with the left foot, hard",
    "a teenager pushes a vending machine with both arms", "a person throws a straight punch at the coconut",
    "a person kicks the lamp off the table", "a man knees a watermelon", "a person pushes the trolley gently",
    "a boxer punches a speed bag", "a person kicks a snow globe", "an astronaut kicks a moon rock",
    "a person hits the gong with the right fist", "a player strikes the football with the left foot",
]  # fmt: skip
"""Of what the prior knows. FAR and MARGIN were chosen before any of these was written, the rule for strikes that are
named (NAMED) before the last 25."""
OTHER_ACTS = [
    "a person throws the watermelon", "a man hurls the chair through the window", "a woman picks up the cat",
    "a person catches a frisbee", "a person carries a baby", "a waiter carries a tray", "a person lifts a barbell",
    "a couple dances a waltz", "a person dances around the statue", "a man rolls a barrel", "a person drags a suitcase",
    "a person pulls a cart", "a person hugs a tree", "a person plays basketball", "a golfer hits the ball",
    "a man hammers a nail", "a person chops an onion", "a gardener waters the flowers", "a person swims in a pool",
    "a person paddles a canoe", "a child plays with a doll", "a person rides a skateboard", "a person plays the violin",
    "a conductor leads the orchestra", "a person climbs a tree", "a person irons a shirt", "a person washes the dishes",
    "a person milks a cow", "a person throws a dart", "a person shakes hands", "a person pets a dog",
    "a person scratches his back", "a cat sleeps on the sofa", "stock prices fell sharply", "blue green yellow",
    "qwertz",
    "一个人踢足球", "人がボールを蹴る", "사람이 공을 찬다", "человек пинает мяч", "eine Frau schlägt gegen den Sack",
    "un niño golpea la caja con el puño", "elle donne un coup de poing", "un uomo calcia il pallone",
    "ktoś kopie piłkę", "ihminen potkaisee palloa", "bir kişi topa vuruyor", "رجل يركل الكرة", "🥊🥊🥊", "!!!",
    "a person throws a punchbowl", "a person drinks punch", "a soldier does press-ups", "a person kneels and prays",
    "a person unwraps a present", "a person blows up a balloon", "a person inflates the beach ball",
    "a person waters the cactus", "a person bakes a cake", "a person lifts the watermelon",
    "a person carries the watermelon upstairs", "a person throws the jelly", "a person picks the vase up",
    "a person picks up a pumpkin", "a person catches the vase", "a person dances in the rain",
    "a person dances a tango with the cabinet", "a person vacuums the carpet", "a person slices the bread",
    "a person shovels snow", "a person polishes the ball", "a person sniffs the flower",
    "a person leans on the cabinet", "a person naps", "a person hurls the ball at the wall",
    "a person swings a baseball bat at the ball", "a person dunks the ball", "a person fetches water",
    "ein Boxer schlägt auf den Sandsack", "la persona lanza la pelota",
]  # fmt: skip
SENTENCES = PARAPHRASES + OTHER_ACTS


@pytest.fixture(scope="module")
def found():
    captions, encoder = read_captions(EMBEDDED), minilm()
    assert captions is not None
    asked = list(dict.fromkeys([*SENTENCES, *map(captions.familiar_words, SENTENCES)]))
    rows = dict(zip(asked, encoder.compute(asked), strict=True))
    encoder = replace(encoder, compute=lambda sentences: torch.stack([rows[each] for each in sentences]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text, "minilm", lambda cache=None: encoder)
        return {sentence: familiarity(sentence) for sentence in SENTENCES}


def test_paraphrases_pass_and_other_acts_are_said(found):
    """61 of 65 and 78 of 80 when this was written; uppercuts, which the prior has not seen, are among what is said."""
    passed = [s for s in PARAPHRASES if found[s].known and STRIKES.match(found[s].kind)]
    said = [s for s in OTHER_ACTS if not found[s].known or not STRIKES.match(found[s].kind)]
    assert len(passed) >= 0.92 * len(PARAPHRASES), sorted(set(PARAPHRASES) - set(passed))
    assert len(said) >= 0.96 * len(OTHER_ACTS), sorted(set(OTHER_ACTS) - set(said))
    captions = read_captions(EMBEDDED)
    assert captions is not None and not set(SENTENCES) & set(captions.sentences)


@pytest.mark.parametrize(
    ("sentence", "value", "said"),
    [
        ("a person kicks the melon", "0.", "from 'a person kicks' (kick_front, "),
        ("A person  dances.", "0.00", "(dance, 528 pieces of motion) in the prior's training, no strike"),
        ("a person picks up the box", "UNKNOWN", "was not trained on 'a person picks up a box', which is nearest"),
        ("a person throws the ball", "UNKNOWN", "(throw, 6 pieces of motion)"),
        ("踢球", "UNKNOWN", "trained on nothing like this (English alone); nearest is"),
    ],
)  # fmt: skip
def test_the_plan_says_how_near_and_to_what(sentence, value, said):
    plan = make_plan(config_of(*arguments([sentence]), "scene.striking_limb=null", "scene.expected_limb=any"))
    (check,) = [check for check in plan.checks if check.name == "sentence"]
    assert value in check.value and said in check.detail


def said(sentence: str, prior: Path) -> tuple[str, str]:
    line = sentence_check(sentence, str(prior))
    assert line is not None
    return line


def test_of_another_prior_only_what_is_there_is_said(tmp_path):
    """With its captions, as training writes them, or without."""
    assert said("a person kicks", tmp_path)[0] == "not measured"
    assert "knows English" in said("踢球", tmp_path / "last.ckpt")[1]
    sentences, windows = ["a person waves", "a person kicks"], {"wave": 3, "kick_front": 4}
    told = {"sentences": sentences, "kinds": list(windows), "windows": windows}
    rows = minilm().compute(sentences).numpy().astype(np.float16)
    save_file({"embeddings": rows}, tmp_path / CAPTIONS_NAME, {name: json.dumps(each) for name, each in told.items()})
    assert said("a person waves", tmp_path / "prior.safetensors")[1].startswith("from 'a person waves'")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / CAPTIONS_NAME).write_text("nothing")
    assert said("a person waves", tmp_path / "broken")[0] == "not measured"


def test_nothing_is_said_of_the_trainings_own_words_nor_where_the_prior_is_not_asked():
    for overrides in (
        [], ["scene.motion_prompt=a person kicks."],
        ["stage/motion=none", "stage.coordinate.lambda_hmsd=0", "scene.motion_prompt=a person dances"],
    ):  # fmt: skip
        limbs = ["scene.striking_limb=null", "scene.expected_limb=any"] if len(overrides) > 1 else []
        plan = make_plan(config_of(*overrides, *limbs))
        assert not [check for check in plan.checks if check.name == "sentence"]
