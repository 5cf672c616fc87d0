"""What the person's answer costs: what is counted, and that nothing of it is loaded where it is left out."""

import pytest

from analysis.answer_bench import SCENES, Spent, apart, counted
from hoi.body.people import load_person
from hoi.body.skinning import stand_motion


def test_time_is_counted_once():
    now = [0.0]

    def work(seconds: float) -> None:
        now[0] += seconds

    spent = Spent(lambda: now[0])
    inner = spent.counting(lambda: work(3))
    spent.counting(lambda: (inner(), work(2), inner()))()
    assert spent.seconds == 8
    with pytest.raises(ZeroDivisionError):
        spent.counting(lambda: (work(1), 1 / 0))()
    work(100)
    inner()
    assert spent.seconds == 12


def test_what_the_person_does_is_counted_and_put_back():
    from hoi.body.dynamics import Person
    from hoi.method import reaction

    before, man = reaction.react, load_person("man", 8000)
    person = Person(man, stand_motion(man, 3, 20.0), start=0.0, gravity=9.81, recovery=0.3, one_piece=0.85)
    with counted() as spent:
        assert reaction.react is not before
        person.advance(0.01)
        assert spent.seconds == 0
        person.inverse_mass(11, person.q[:3], person.q[:3])
        assert spent.seconds > 0
    assert reaction.react is before


def test_a_limb_that_nothing_stops_loads_no_mujoco():
    quick = ["experiment=smoke", "stage.coordinate.iterations=20"]
    assert apart(f"loads_mujoco({[SCENES['impulse'], *quick]!r})") == [0.0]
