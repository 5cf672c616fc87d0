"""Contact fidelity against run time: what is compared, the summary, the report."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refine_scenes import struck

from analysis.precision import closeups, contact_report, contacts
from analysis.reach import config_of
from hoi.data import Plan, Run


def rows(way: str, depths: list[float], before: float = 0.05) -> pd.DataFrame:
    common = {"setting": "laptop", "scene": "s", "kind": way, "way": way, "touching": 0.5, "gap": 0.0, "strange": 0.1}
    seconds = np.arange(1.0, len(depths) + 1)
    return pd.DataFrame(
        [
            {**common, "seed": i, "seconds": s, "penetration": d, "deepest before": before, "stopped": 0.0}
            for i, (d, s) in enumerate(zip(depths, seconds, strict=True))
        ]
    )


def test_every_way_composes_and_does_what_its_name_says() -> None:
    found = contacts.ways()
    assert len({way.name for way in found}) == len(found)
    for way in found:
        refine = config_of(f"scene={contacts.SCENES[0]}", *way.overrides).stage.refine
        assert ("geometric" in way.kind) == (getattr(refine, "lambda_geometry", 0) > 0 or refine.name == "geometric")
        if way.kind != "none":
            assert refine.when == ("always" if way.iterations else "needed")
            assert refine.iterations == (way.iterations or 25)


def test_summary_is_mean_spread_and_count() -> None:
    table = pd.concat([rows("none", [0.05, 0.05]), rows("geometric", [0.01, 0.03, 0.08])])
    summary = contact_report.summarise(table).set_index("way")
    assert summary["n"].to_dict() == {"none": 2, "geometric": 3}
    assert summary.loc["geometric", "penetration"] == pytest.approx(0.04)
    assert summary.loc["geometric", "penetration sd"] == pytest.approx(np.std([0.01, 0.03, 0.08]))
    assert summary.loc["geometric", "seconds"] == 2
    assert summary["shallower"].to_dict() == {"none": 0, "geometric": 2}


def test_report_says_it_in_millimetres(tmp_path: Path) -> None:
    table = pd.concat([rows("none", [0.05, 0.05]), rows("geometric", [0.01, 0.03])])
    paths = contact_report.write(tmp_path, table, {"machine": "a laptop"})
    assert [path.name for path in paths] == ["contacts.csv", "contacts.md", "contacts.png"]
    text = paths[1].read_text()
    assert "a laptop" in text and "20.0 ± 10.0" in text and "50.0 ± 0.0" in text
    pd.testing.assert_frame_equal(pd.read_csv(paths[0])[list(table)], table.reset_index(drop=True))
    assert paths[2].stat().st_size > 10_000


def test_study_refines_the_same_start_in_every_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene, state = struck(depth=0.03)
    run = Run("", {}, {}, Plan("", (), (), ()), (), (), scene, state)
    start = contacts.Start("laptop", "kick_soccer_ball", 0, run, ("scene=kick_soccer_ball",))
    geometric = [way for way in contacts.ways() if way.kind in ("none", "geometric")][:3]
    monkeypatch.setattr(contacts, "starts", lambda *given: [start])
    monkeypatch.setattr(contacts, "ways", lambda quick: geometric)
    table = contacts.study(tmp_path, ["kick_soccer_ball"], 1, 1).set_index("kind")
    assert len(table) == 3
    assert table.loc["none", "penetration"] == pytest.approx(0.03, abs=0.004)
    assert (table["deepest before"] == table.loc["none", "penetration"]).all()
    assert (table.loc["geometric", "penetration"] < 0.3 * table.loc["none", "penetration"]).all()
    assert (table["strange"] > 0).all() and table["strange"].nunique() > 1
    assert (table["stopped"] == 0).all()


def test_a_start_that_has_no_contact_has_no_depth(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene, state = struck(depth=0.03)
    away = replace(state, contact=replace(state.contact, contacts=()) if state.contact else None)
    run = Run("", {}, {}, Plan("", (), (), ()), (), (), scene, away)
    start = contacts.Start("laptop", "kick_soccer_ball", 0, run, ("scene=kick_soccer_ball",))
    monkeypatch.setattr(contacts, "starts", lambda *given: [start])
    geometric = [way for way in contacts.ways() if way.kind in ("none", "geometric")][:2]
    monkeypatch.setattr(contacts, "ways", lambda quick: geometric)
    assert contacts.study(tmp_path, ["kick_soccer_ball"], 1, 1)["penetration"].isna().all()


def test_closeups_show_before_and_after(tmp_path: Path) -> None:
    scene, state = struck(depth=0.03)
    run = Run("", {}, {}, Plan("", (), (), ()), (), (), scene, state)
    start = contacts.Start("paper", "kick_soccer_ball", 0, run, ("scene=kick_soccer_ball",))
    assert {way.name for way in contacts.ways()} >= set(closeups.WAYS)
    geometric = [way for way in contacts.ways() if way.kind == "geometric"][:1]
    closeups.draw([start], geometric, tmp_path / "closeups.png")
    assert (tmp_path / "closeups.png").stat().st_size > 20_000
    camera, motion = closeups.across(start), state.motion
    picture = closeups.closeup(start, motion, camera)
    assert picture.shape == (closeups.SIZE, closeups.SIZE, 3) and picture.std() > 0.05
    apart = replace(motion, translation=motion.translation + np.array([0, -0.3, 0]))
    assert np.abs(closeups.closeup(start, apart, camera) - picture).max() > 0.2
