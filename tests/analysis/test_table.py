"""The tables, from records of made-up runs: what they count, what they say, and that they are the same each time."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis import kept_rows, table
from analysis.learned import sidecar
from analysis.metrics import GROUPS, METRICS
from analysis.reported import reported
from analysis.table import collect, main, summarise, variant_place
from analysis.writers import number, plain
from hoi.data import Run
from hoi.errors import InputError
from hoi.record import message_digest, write
from tests.demo_run import make_run

ROOT = Path(__file__).parents[2]
FILES = ["runs.csv", "table.csv", "table.md", "table.tex", "table.html"]


@pytest.fixture(scope="module")
def demo() -> tuple[Run, np.ndarray, np.ndarray]:
    run, points, colours = make_run()
    facts = {"scene": "kick", "experiment": "demo", "ablation": "full"}
    made = replace(run, config_yaml="scene:\n  expected_limb: right_foot\n", provenance=run.provenance | facts)
    return made, points, colours


def save(demo, path: Path, *, provenance=None, **result) -> None:
    run, points, colours = demo
    path.parent.mkdir(parents=True, exist_ok=True)
    facts = run.provenance | (provenance or {})
    write(replace(run, provenance=facts, result=run.result | result), path, points, colours, plan_text="")


@pytest.fixture
def runs(demo, tmp_path) -> Path:
    """Two finished runs of one variant, one finished and one failed of another, one file that is no record."""
    folder = tmp_path / "runs"
    save(demo, folder / "0/run.mcap", variant="full", seconds="1")
    save(demo, folder / "1/run.mcap", variant="full", seconds="3", provenance={"seed": "1"})
    save(demo, folder / "2/run.mcap", variant="no_mpm", seconds="5")
    facts = {"config_hash": "11ee"}
    save(demo, folder / "3/run.failed.mcap", provenance=facts, variant="no_mpm", status="failed", outcome="it blew up")
    (folder / "4").mkdir()
    (folder / "4/run.mcap").write_bytes((folder / "0/run.mcap").read_bytes()[:2000])
    return folder


def test_a_row_a_variant(runs):
    rows = collect(runs)
    assert rows["status"].tolist() == ["done", "done", "done", "failed", "unreadable"]
    assert set(METRICS) <= set(rows)
    table = summarise(rows).set_index("variant")
    assert table.loc["full", ["n", "failed", "seconds", "seconds_sd", "seconds_n"]].tolist() == [2, 0, 2, 2**0.5, 2]
    assert table.loc["no_mpm", ["n", "failed", "reasons", "seconds"]].tolist() == [1, 1, "it blew up", 5]
    assert np.isnan(table.loc["no_mpm", "seconds_sd"])
    assert table.loc["", ["n", "unreadable"]].tolist() == [0, 1]
    by_seed = summarise(rows, ["seed"])
    assert by_seed.loc[by_seed["variant"] == "full", "seconds"].tolist() == [1, 3]


def test_a_finished_run_supersedes_a_failed_one_of_the_same_config(demo, tmp_path):
    save(demo, tmp_path / "0/run.mcap", variant="full")
    save(demo, tmp_path / "0/run.failed.mcap", variant="full", status="failed", outcome="before")
    save(demo, tmp_path / "1/run.mcap", variant="full")
    other = {"config_hash": "other"}
    save(demo, tmp_path / "1/run.failed.mcap", provenance=other, variant="full", status="failed", outcome="other")
    assert collect(tmp_path)["reason"].tolist() == ["", "other", ""]


def test_order_of_variants():
    wanted = [
        ("demo", "full"), ("demo", "no_attraction"), ("demo", "no_contact"), ("demo", "no_mdm"), ("demo", "no_mpm"),
        ("demo", "no_video_sds"), ("demo", "no_mdm+no_mpm"), ("demo", "no_mpm+no_video_sds"), ("demo", "mine"),
        ("other", "full"), ("baseline", "4D-fy"), ("baseline", "kinematic replay"),
    ]  # fmt: skip
    shuffled = [wanted[i] for i in np.random.default_rng(0).permutation(len(wanted))]
    assert sorted(shuffled, key=lambda place: variant_place(*place)) == wanted


def test_same_records_same_bytes(runs, tmp_path):
    """Whatever the folder is called, however many processes read it, whatever was there before."""
    written = []
    for name, jobs in (("a", "1"), ("b", "2"), ("a", "2")):
        assert main([str(runs), "-o", str(tmp_path / name), "--jobs", jobs], say=lambda line: None) == 2
        assert sorted(file.name for file in (tmp_path / name).iterdir()) == sorted([*FILES, kept_rows.NAME])
        written.append([(tmp_path / name / file).read_bytes() for file in FILES])
    runs.rename(tmp_path / "elsewhere")
    main([str(tmp_path / "elsewhere")], say=lambda line: None)
    written.append([(tmp_path / "elsewhere/table" / file).read_bytes() for file in FILES])
    assert written[0] == written[1] == written[2] == written[3]


def test_records_that_have_not_changed_are_not_read_again(runs, tmp_path, monkeypatch):
    fresh, kept, read = collect(runs), tmp_path / "kept", []
    kept.mkdir()
    row_of = table._row
    monkeypatch.setattr(table, "_row", lambda folder, path: read.append(path.parent.name) or row_of(folder, path))
    for expected in (["0", "1", "2", "3", "4"], ["4"]):  # what cannot be read is tried again
        read.clear()
        pd.testing.assert_frame_equal(collect(runs, kept=kept), fresh)
        assert read == expected

    shutil.copy(runs / "2/run.mcap", runs / "1/run.mcap")
    read.clear()
    assert collect(runs, kept=kept)["variant"].tolist() == ["full", "no_mpm", "no_mpm", "no_mpm", ""]
    assert read == ["1", "4"]

    for spoilt in ('{"readers": 1}', "no JSON", '{"readers": "older code", "rows": {}}'):
        (kept / kept_rows.NAME).write_text(spoilt)
        read.clear()
        collect(runs, kept=kept)
        assert len(read) == 5


def test_several_processes_give_the_same_rows(demo, tmp_path):
    for seed in range(9):
        save(demo, tmp_path / f"{seed}/run.mcap", variant="full", seconds=str(seed))
    pd.testing.assert_frame_equal(collect(tmp_path), collect(tmp_path, jobs=2))


def test_what_is_written(runs, capsys):
    said = []
    assert main([str(runs)], say=said.append) == 2
    text, said = said
    assert "\nvariant" in text and "Contact" in text and "full" in text and "no_mpm" in text
    assert said == f"5 records (3 done, 1 failed, 1 unreadable): {', '.join(FILES)} in {runs / 'table'}"
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1 and "4/run.mcap" in errors[0] and "unfinished" in errors[0]

    markdown = (runs / "table/table.md").read_text()
    for heading in (*GROUPS, "Scores of the videos", "Reported by the paper", "Failed and unreadable"):
        assert f"## {heading}\n" in markdown
    assert "| full | 2 | 0 |" in markdown and "2 ± 1.4" in markdown
    assert "3/run.failed.mcap failed: it blew up" in markdown
    assert "[a] empty: no record has scores" in markdown and "refine \\[s\\] ↓ \\[a\\]" in markdown
    assert "| w/o MPM (reported) | Ablation Study | 0.21 | 0.23 | 3.04 | 3.58 | 3.65 | 3.56 |" in markdown

    tables = pd.read_html(runs / "table/table.html", flavor="lxml") if _lxml() else []
    assert all(len(table) >= 2 for table in tables)
    latex = (runs / "table/table.tex").read_text()
    for mark in ("toprule", "midrule", "bottomrule", "begin{tabular}", "end{tabular}"):
        assert latex.count(f"\\{mark}") == len(GROUPS) + 2
    assert "no\\_mpm & 1 & 1" in latex and "$\\pm$" in latex and "±" not in latex
    table = pd.read_csv(runs / "table/table.csv").set_index("variant")
    assert table.loc["(unreadable)", "unreadable"] == 1 and table.loc["full", "seconds"] == 2


def _lxml() -> bool:
    from importlib.util import find_spec

    return find_spec("lxml") is not None


def test_names_that_would_be_markup(demo, tmp_path):
    evil = "<script>|$x_1$\\input{x}&\n=1+1"
    save(demo, tmp_path / "0/run.mcap", variant=evil)
    save(demo, tmp_path / "1/run.failed.mcap", variant="=cmd()", status="failed", outcome=evil)
    main([str(tmp_path)], say=lambda line: None)
    html, markdown, latex = ((tmp_path / "table" / f"table.{kind}").read_text() for kind in ("html", "md", "tex"))
    assert "<script>" not in html + markdown and "&lt;script&gt;" in html
    assert "\\input" not in latex and "\\textbackslash{}input\\{x\\}\\&" in latex
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    assert lines and all(line.endswith("|") for line in lines)
    assert "'=cmd()" in (tmp_path / "table/table.csv").read_text()


def test_learned_scores_come_from_the_sidecar(runs, capsys):
    good, wrong = runs / "0/run.mcap", runs / "1/run.mcap"
    scores, models = {"viclip": 0.25}, {"viclip": "file"}
    sidecar.write(sidecar.sidecar_path(good), sidecar.Sidecar(message_digest(good), scores, models))
    sidecar.write(sidecar.sidecar_path(wrong), sidecar.Sidecar("0" * 64, scores, models))
    assert main([str(runs)], say=lambda line: None) == 2
    rows = pd.read_csv(runs / "table/runs.csv")
    assert rows["viclip"].notna().tolist() == [True, False, False, False, False] and rows["viclip"][0] == 0.25
    assert rows["status"][1] == "done"
    assert "1/run.learned.json has the scores of another record" in capsys.readouterr().err
    assert "0.25 (1)" in (runs / "table/table.md").read_text()


def test_opinion_scores_of_ours(runs, tmp_path, capsys):
    file = tmp_path / "study.csv"
    file.write_text("experiment,variant,Q1,Q2,Q3,Q4\ndemo,full,4.5,4.25,4,3.5\n")
    main([str(runs), "--mos", str(file)], say=lambda line: None)
    markdown = (runs / "table/table.md").read_text()
    assert "| 4.5 | 4.25 | 4 | 3.5 |" in markdown and "no opinion scores" not in markdown
    file.write_text("variant,Q1\nfull,4\n")
    capsys.readouterr()
    assert main([str(runs), "--mos", str(file)]) == 2
    assert capsys.readouterr().err == f"analysis.table: {file} lacks the column experiment; must have " + (
        "experiment, variant, Q1, Q2, Q3, Q4\n"
    )


def test_reported_rows_are_the_papers():
    paper = ROOT.parent / "shared/reference/paper.tex"
    if not paper.is_file():
        pytest.skip("the paper's source is not here")
    text = paper.read_text()
    for row in reported().to_dict("records"):
        name = {"4D-fy": "4DFY", "PhyGenHOI": "Ours"}.get(row["method"], row["method"])
        cells = [f"{row[key]:.2f}" for key in ("vqa_yes", "viclip", "q1", "q2", "q3", "q4")]
        lines = [line.replace("\\textbf{", "").replace("}", "") for line in text.splitlines() if name in line]
        found = [[cell.strip(" \\") for cell in line.split("&")[1:]] for line in lines]
        assert cells in found, row["method"]


def test_numbers_and_texts_in_cells():
    values = (float("nan"), 0.0, 0.01234, 12.345, 123.45, 12345.6, 1e9)
    assert [number(value) for value in values] == ["", "0", "0.0123", "12.3", "123", "12346", "1e+09"]
    assert plain("a\nb\x00  c") == "a b c" and len(plain("x" * 999)) == 200


def test_empty_folder_is_one_line(tmp_path):
    with pytest.raises(InputError, match=r"no run.mcap"):
        collect(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "analysis.table", str(tmp_path)], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1


def test_the_table_is_light(demo, tmp_path):
    """Neither torch nor taichi, with a scene's prompt to be judged."""
    run, points, colours = demo
    scene = replace(run.scene, motion_prompt="a person does a front kick with the right leg")
    save((replace(run, scene=scene), points, colours), tmp_path / "run.mcap", variant="full")
    heavy = ("torch", "taichi", "transformers", "matplotlib", "av")
    code = (
        "import sys; from analysis.table import main, collect; from pathlib import Path;"
        f"row = collect(Path({str(tmp_path)!r})).iloc[0]; assert row['alignment'] == row['alignment'], row;"
        f"main([{str(tmp_path)!r}]); print([m for m in {heavy} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stderr
