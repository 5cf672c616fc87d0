"""Timelines: what composes, and one line for each thing that cannot be."""

import subprocess
import sys

import pytest

from hoi.config.acts import PARTS
from hoi.config.compose import config_of
from hoi.errors import InputError
from hoi.motion import features
from hoi.plan import format_plan, make_plan

RUN = '{prompt:"a person runs forward",start:0,end:2}'
KICK = '{prompt:"a person kicks with the right foot",start:2,end:4,strikes:auto}'
FINE = ("scene.frames=120", f"scene.acts=[{RUN},{KICK}]")


def act(prompt: str = "a person walks", start: object = 0, end: object = 2, **more: object) -> str:
    said = ",".join(f"{key}:{value}" for key, value in more.items())
    return f'{{prompt:"{prompt}",start:{start},end:{end}{"," if said else ""}{said}}}'


def acts(*each: str) -> tuple[str, ...]:
    return "scene.frames=120", f"scene.acts=[{','.join(each)}]"


BAD = {
    "no sentence": (acts(act("")), "acts.0.prompt"),
    "a blank sentence": (acts(act("  ")), "acts.0.prompt"),
    "no prompt given": (acts("{start:0,end:2}"), "acts.0.prompt"),
    "no start given": (acts('{prompt:"a person walks",end:2}'), "acts.0.start"),
    "no end given": (acts('{prompt:"a person walks",start:0}'), "acts.0.end"),
    "before the scene": (acts(act(start=-1)), "acts.0.start"),
    "after T": (acts(act(start=6, end=8)), "acts.0.start"),
    "long after T": (acts(RUN, act(start=60, end=62)), "acts.1.start"),
    "ends after T": (acts(act(start=4, end=6.5)), "acts.0.end"),
    "ends before it starts": (acts(act(start=4, end=2)), "acts.0.end"),
    "takes no time": (acts(act(start=2, end=2)), "acts.0.end"),
    "too short": (acts(act(start=2, end=2.2)), "acts.0.end"),
    "a start that is no number": (acts(act(start="soon")), "acts.0.start"),
    "an end that is no number": (acts(act(end="never")), "acts.0.end"),
    "a start that is not finite": (acts(act(start="nan")), "acts.0.start"),
    "an end that is not finite": (acts(act(end="inf")), "acts.0.end"),
    "two at once": (acts(RUN, act(start=1, end=3)), "acts.1"),
    "two at once, the later first": (acts(act(start=1, end=3), RUN), "acts.1"),
    "the same twice": (acts(RUN, RUN), "acts.1"),
    "one within another": (acts(act(end=6), act(start=2, end=3)), "acts.1"),
    "one arm twice": (acts(act(parts="[left_arm]"), act(start=1, end=3, parts="[left_arm,head]")), "left_arm"),
    "legs twice": (acts(RUN, act(parts="[legs]"), act(start=1, end=3, parts="[legs]")), "legs"),
    "an unknown part": (acts(act(parts="[tail]")), "acts.0.parts"),
    "a joint as a part": (acts(act(parts="[left_elbow]")), "acts.0.parts"),
    "a part of either side": (acts(act(parts="[arms]")), "acts.0.parts"),
    "a part twice": (acts(act(parts="[head,head]")), "acts.0.parts"),
    "parts that are no list": (acts(act(parts="head")), "acts.0.parts"),
    "an unknown limb": (acts(act(strikes="tail")), "acts.0.strikes"),
    "a joint that is no limb": (acts(act(strikes="left_elbow")), "acts.0.strikes"),
    "no limb to find": (acts(act("a person waits", strikes="auto")), "acts.0.strikes"),
    "two limbs to find": (
        acts(act("a person punches with the left hand and the right foot", strikes="auto")),
        "acts.0",
    ),
    "another limb than the sentence's": (
        acts(act("a person kicks with the left foot", strikes="right_hand")),
        "left_foot",
    ),
    "a limb that is still": (acts(act("a person strikes", strikes="right_foot", parts="[head]")), "acts.0.strikes"),
    "a hand of the other arm": (acts(act("a person hits", strikes="left_hand", parts="[right_arm]")), "acts.0.strikes"),
    "a time without a strike": (acts(act(at=1)), "acts.0.at"),
    "a strike before its act": (acts(RUN, act("a person hits", 2, 4, strikes="left_hand", at=1)), "acts.1.at"),
    "a strike after its act": (acts(RUN, act("a person hits", 2, 4, strikes="left_hand", at=5)), "acts.1.at"),
    "a strike after T": (acts(act("a person hits", 4, 6, strikes="left_hand", at=7)), "acts.0.at"),
    "a strike at no number": (acts(act("a person hits", strikes="left_hand", at="soon")), "acts.0.at"),
    "a way without a strike": (acts(act(sends="[0,1,0]")), "acts.0.sends"),
    "a way of two numbers": (acts(act("a person hits", strikes="left_hand", sends="[0,1]")), "acts.0.sends"),
    "no way": (acts(act("a person hits", strikes="left_hand", sends="[0,0,0]")), "acts.0.sends"),
    "a tempo without a strike": (acts(act(tempo=2)), "acts.0.tempo"),
    "too slow": (acts(act("a person hits", strikes="left_hand", tempo=0.1)), "acts.0.tempo"),
    "backwards": (acts(act("a person hits", strikes="left_hand", tempo=-1)), "acts.0.tempo"),
    "too fast": (acts(act("a person hits", strikes="left_hand", tempo=9)), "acts.0.tempo"),
    "more bounce than there is": (acts(act("a person hits", strikes="left_hand", flesh=2)), "acts.0.flesh"),
    "less than none": (acts(act("a person hits", strikes="left_hand", flesh=-1)), "acts.0.flesh"),
    "flesh without a strike": (acts(act(flesh=0)), "acts.0.flesh"),
    "an unknown key": (acts(act(speed=2)), "speed"),
    "no list": (("scene.acts=walk",), "scene.acts"),
    "a mapping": (("scene.acts={prompt:walk}",), "scene.acts"),
    "a scene too short": (
        ("scene.frames=30", "scene.contact_frame=20", f"scene.acts=[{act(end=1.5)}]"),
        "scene.frames",
    ),
    "no contacts": (("scene.contacts=0",), "scene.contacts"),
    "fewer than none": (("scene.contacts=-3",), "scene.contacts"),
    "too many contacts": (("scene.contacts=100",), "scene.contacts"),
    "half a contact": (("scene.contacts=1.5",), "scene.contacts"),
    "hands that push together": (("scene=push_box", *FINE), "scene.striking_joints"),
    "a file's motion": (("stage/motion=file", "stage.motion.path=walk.bvh", *FINE), "scene.acts"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_one_line(case):
    overrides, named = BAD[case]
    with pytest.raises(InputError) as refused:
        config_of(*overrides)
    message = str(refused.value)
    assert "\n" not in message and named in message, message


def test_many_cases():
    assert len(BAD) >= 40


def test_the_command_ends_with_2(tmp_path):
    command = [sys.executable, "-m", "hoi.run", *BAD["after T"][0], f"out={tmp_path / 'run'}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "Traceback" not in done.stderr and "scene.acts.0.start" in done.stderr
    assert not (tmp_path / "run").exists() or not list((tmp_path / "run").glob("run.mcap"))


def test_the_first_strike_is_the_scenes():
    config = config_of(*FINE)
    assert [each.strikes for each in config.scene.acts] == [None, "right_foot"]
    assert config.scene.striking_limb == config.scene.expected_limb == "right_foot"
    left = config_of("scene.frames=120", f"scene.acts=[{act('a person throws a left jab', strikes='auto')}]")
    assert (left.scene.striking_limb, left.scene.contact_joint) == ("left_hand", "left_hand")


def test_parts_beside_a_whole_body_are_fine():
    config = config_of(
        *acts(act(end=6), act("a person waves", 1, 3, parts="[left_arm]"), act(start=3, end=4, parts="[head]"))
    )
    assert len(config.scene.acts) == 3


def test_the_parts_are_the_features():
    assert tuple(features.PARTS) == PARTS


def test_the_plan_says_what_is_computed_when():
    overrides = acts(RUN, act("a person kicks with the right foot", 2, 4, strikes="auto"),
                     act("a person throws a left jab", 4, 6, strikes="auto"))  # fmt: skip
    plan = make_plan(config_of(*overrides))
    (order,) = [check for check in plan.checks if check.name == "order"]
    assert order.value == "2 strikes"
    assert "right_foot" in order.detail and "left_hand" in order.detail and "4 s" in order.detail
    assert "right_foot" in format_plan(plan)
    assert not [check for check in make_plan(config_of()).checks if check.name in ("order", "acts")]
