"""The table of what variations do, from made-up records."""

from dataclasses import replace

import pytest

from analysis.variations import collect, row
from hoi.errors import InputError
from hoi.record import write
from tests.demo_run import make_run

CONFIG = "scene:\n  expected_limb: right_foot\n"


@pytest.fixture
def runs(tmp_path):
    """Two runs of one variation, one of another that missed, one of no variation, one that failed."""
    run, points, colours = make_run()
    assert run.state.contact is not None

    def save(name: str, experiment: str, status: str = "done", missed: bool = False) -> None:
        search = replace(run.state.contact, contacts=()) if missed else run.state.contact
        path = tmp_path / name / "run.mcap"
        path.parent.mkdir()
        made = replace(
            run,
            config_yaml=CONFIG,
            provenance=run.provenance | {"experiment": experiment},
            result=run.result | {"status": status},
            state=replace(run.state, contact=search),
        )
        write(made, path, points, colours, plan_text="")

    save("a", "hard")
    save("b", "hard", missed=True)
    save("c", "gentle")
    save("d", "laptop")
    save("e", "gentle", status="failed")
    return tmp_path


def test_a_row_a_variation(runs):
    found = collect(runs)
    assert {name: len(of) for name, of in found.items()} == {"gentle": 1, "hard": 2}
    push = found["gentle"][0].state.contact.push
    name, count, v_in, _, height, limbs, expected = row("gentle", found["gentle"])
    assert (name, count, v_in, height) == ("gentle", "1", f"{push.v_in:.2f}", f"{push.point[2]:.2f}")
    assert limbs.startswith("right_foot 1") and expected == "1 of 1"
    assert row("hard", found["hard"])[-2:] == ("right_foot 1, nothing 1", "1 of 2")


def test_no_variation_is_one_line(tmp_path):
    with pytest.raises(InputError, match=r"no run\.mcap below|no finished run of a variation"):
        collect(tmp_path)
