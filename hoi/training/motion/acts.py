"""Acts that no motion prior here is trained on, in words: what tells a sentence of one from the captions that it shares
its other words with ("a person lifts a box" from "a person pushes a box")."""

WITH_SOMETHING = """
    catches X / lifts X / lifts up X with both hands / picks up X / picks X up from the floor / carries X / holds X
    drags X / pulls X / pulls X towards himself / rolls X along the floor / hugs X / kisses X / squeezes X / strokes X
    turns X over / opens X / closes X / breaks X / breaks X into pieces / cuts X with a knife / eats X / paints X
    washes X / looks at X / points at X / ignores X / sits on X / stands on X / climbs onto X / lies on X / jumps over X
    walks around X / walks past X / runs away from X / hides behind X / balances X on the head / juggles X
    spins X on a finger / heads X / headbutts X / hits X with a bat / hits X with a stick / hits X with a racket
    hits X with a hammer / bounces X / drops X / throws X away / throws X in the air / tosses X to someone / puts X down
    places X on the table / gives X to someone / receives X / shakes X / tears X apart / ties X / wraps X / stops X
    blocks X / spikes X / serves X / elbows X / stomps on X / tramples on X / tackles X / wrestles with X
    dances with X / talks to X / sings to X / photographs X / steers X / rides X
"""
ALONE = """
    swims / flies / skates / skis / surfs / rows a boat / rides a horse / drives a car / plays tennis / plays golf
    plays the piano / plays the drums / cooks / sleeps / writes a letter / reads a book / drinks coffee / climbs a rope
    climbs a wall / does a handstand / does yoga / stretches / lifts weights / bowls / shoots with a bow / shoots a gun
    digs a hole / chops wood / sweeps the floor / types on a computer / makes a phone call / combs the hair
    brushes the teeth / gets dressed / opens the door / pushes the button / cries / laughs / sneezes / prays / claps
    whistles
"""
THINGS = ("a ball", "a box", "something")


def _acts(table: str) -> list[str]:
    return [act.strip() for act in table.replace("\n", "/").split("/") if act.strip()]


UNTRAINED = tuple(
    dict.fromkeys(
        [f"a person {act.replace('X', thing)}" for act in _acts(WITH_SOMETHING) for thing in THINGS]
        + [f"a person {act}" for act in _acts(ALONE)]
    )
)
