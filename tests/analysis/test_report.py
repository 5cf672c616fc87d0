"""The report: what stands in it, that records cannot break or script it, and how it behaves in a real browser."""

import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from analysis.report.__main__ import main
from analysis.report.extras import read_extra, to_html
from analysis.report.media import choose, film
from analysis.report.page import clean
from analysis.report.shown import OTHER, Part, parts_of
from hoi import record
from hoi.data import Omission, Plan, Run, State, Step
from hoi.errors import InputError
from hoi.render.cameras import look_at
from hoi.render.encode import encode, write_mp4, write_png
from tests.browser import chromium, until
from tests.demo_run import make_run

ROOT = Path(__file__).parents[2]
FRAMES = 10
EVIL = "</details></script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\">{{7*7}}"
QUIET = {"say": lambda line: None}


@pytest.fixture(scope="module")
def demo() -> tuple[Run, np.ndarray, np.ndarray]:
    run, points, colours = make_run(frames=FRAMES, points=40, gaussians=20, particles=30, contact_frame=4.0)
    facts = {"scene": "kick_ball", "experiment": "demo", "git": "c0ffee", "overrides": "seed=0 scene=kick_ball"}
    config = "scene:\n  expected_limb: right_foot\n  scene_prompt: a person kicks a ball\n  fps: 20.0\n"
    return replace(run, config_yaml=config, provenance=run.provenance | facts), points, colours


def pictures(count: int = FRAMES) -> list[np.ndarray]:
    """The k-th of them has shade 20 k."""
    return [np.full((32, 48, 3), 20 * shade, np.uint8) for shade in range(count)]


def save(demo, path: Path, video: bool = True, facts: dict[str, str] | None = None, plan=None, **result: str) -> Path:
    run, points, colours = demo
    path.parent.mkdir(parents=True, exist_ok=True)
    camera = look_at((5.0, -3.0, 2.0), (0.0, 1.0, 0.8), width=48, height=32)
    seen = {"footage": record.Footage(encode(pictures(), 20).units, (camera,) * FRAMES)} if video else {}
    run = replace(run, provenance=run.provenance | (facts or {}), result=run.result | result, plan=plan or run.plan)
    record.write(run, path, points, colours, plan_text="", **seen)
    return path


@pytest.fixture(scope="module")
def runs(demo, tmp_path_factory) -> Path:
    """Done with and without a video, failed, no record at all; pictures of the precision beside them."""
    folder = tmp_path_factory.mktemp("report") / "runs"
    save(demo, folder / "0/run.mcap", variant="full", seconds="4")
    save(demo, folder / "1/run.mcap", facts={"seed": "1"}, variant="full", seconds="2")
    save(demo, folder / "2/run.mcap", video=False, variant="no_mpm", seconds="8")
    save(demo, folder / "3/run.failed.mcap", video=False, variant="no_mdm", status="failed", outcome="it blew up")
    (folder / "4").mkdir()
    (folder / "4/run.mcap").write_bytes((folder / "0/run.mcap").read_bytes()[:2000])
    save(demo, folder / "5/run.mcap", facts={"scene": "punch"}, variant="no_mpm", seconds="9")
    (folder / "precision").mkdir()
    write_png(np.zeros((8, 12, 3), np.uint8), folder / "precision/precision.png")
    (folder / "precision/precision.md").write_text("# Errors\n\n| a | b |\n|---|---|\n| 1 | <i>2</i> |\n")
    return folder


@pytest.fixture(scope="module")
def page(runs, tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    assert main([str(runs), "-o", str(file), "--jobs", "1"], **QUIET) == 2  # one cannot be read
    return file


class Outline(HTMLParser):
    """The tags and attributes of a page, its text without markup, and whether all that opens also closes."""

    VOID = ("meta", "link", "img", "input", "br", "path", "use")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in self.VOID:
            return
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data):
        self.text += data

    def count(self, tag: str, **wanted: str) -> int:
        return sum(t == tag and all(a.get(k) == v for k, v in wanted.items()) for t, a in self.tags)


def test_all_is_in_the_page(page):
    text = page.read_text()
    found = Outline(text)
    assert found.open == []
    assert found.count("details", **{"class": "run"}) == 6
    assert found.count("video") == 3
    assert found.count("li", **{"class": "struck"}) == 3
    for words in (
        "a person kicks", "it blew up", "4/run.mcap is an unfinished record", "has no video", "stage.refine is none",
        "a prompt is given", "saves the video prior", "python -m hoi.run seed=0 scene=kick_ball", "c0ffee", "00ff",
        "w/o MPM (reported)", "expected_limb: right_foot", "1 of 2",
    ):  # fmt: skip
        assert words in found.text, words
    assert "Not here. make stability makes it." in found.text
    assert "<td>&lt;i&gt;2&lt;/i&gt;</td>" in text  # the precision's report is a table
    anchors = {attributes["id"] for _, attributes in found.tags if "id" in attributes}
    links = [attributes["href"] for tag, attributes in found.tags if tag == "a"]
    assert links and all(link is not None and link[0] == "#" and link[1:] in anchors for link in links)


def test_nothing_comes_from_elsewhere(page):
    text = page.read_text()
    places = re.findall(r'(?:src|href|action|poster)="([^"]{0,40})', text)
    assert places and all(place.startswith(("data:", "#")) for place in places)
    assert not re.search(r"url\(\s*['\"]?(?!#)", text) and "@import" not in text
    assert "{{" not in text and "{%" not in text


def test_the_same_records_give_the_same_bytes(runs, page, tmp_path):
    shutil.copytree(runs, tmp_path / "elsewhere")
    code = (
        f"import sys; from analysis.report.__main__ import main; main([{str(tmp_path / 'elsewhere')!r}]);"
        "print([name for name in ('torch', 'taichi') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stderr
    assert (tmp_path / "elsewhere/report.html").read_bytes() == page.read_bytes()


@pytest.fixture(scope="module")
def hostile(demo, tmp_path_factory) -> Path:
    """The page of records that hold markup wherever they hold text."""
    folder = tmp_path_factory.mktemp("hostile")
    run, points, colours = demo
    config = json.dumps({"scene": {"fps": 20.0, "scene_prompt": EVIL, "negative_prompt": [EVIL, 2]}})
    evil = replace(run, config_yaml=config, scene=replace(run.scene, motion_prompt=EVIL)), points, colours
    plan = Plan(EVIL, (Step(EVIL, EVIL, "\ud800\x00\u202e"),), (Omission(EVIL, EVIL, EVIL),), ())
    facts = dict.fromkeys(("scene", "experiment", "seed", "git", "overrides", "config_hash"), EVIL)
    save(evil, folder / "0/run.mcap", facts=facts, plan=plan, variant=EVIL, outcome=EVIL, seconds="nan")
    facts = {"scene": "a" * 10**6}
    save(evil, folder / "1/run.failed.mcap", facts=facts, variant="$\\frac{", status="failed", outcome=EVIL)
    save(evil, folder / "2/run.mcap", variant="$\\frac{", seconds="1e999")
    (folder / "stability").mkdir()
    (folder / "stability/a.md").write_text(f"{EVIL}\n\n[x](javascript:alert(1)) ![y](http://x/y.png)\n")
    (folder / "stability/b.png").write_bytes(EVIL.encode())
    assert main([str(folder)], **QUIET) == 0
    return folder / "report.html"


def test_records_cannot_write_markup(hostile):
    text = hostile.read_bytes().decode()
    found = Outline(text)
    assert found.open == [] and found.count("script") == 1
    assert not any(name.startswith("on") for _, attributes in found.tags for name in attributes)
    assert not any("javascript" in (attributes.get("href") or "") for _, attributes in found.tags)
    assert "{{7*7}}" in found.text and "owned" in found.text  # as text
    assert "b.png is no PNG" in found.text
    assert not {"\x00", "\u202e"} & set(text)
    assert len(text) < 2_000_000


def test_a_record_of_nothing(tmp_path):
    """No scene, no stage, no plan, no config; then one whose video is noise."""
    labels = {"status": "done", "variant": "4D-fy"}
    bare = Run("", {}, labels, Plan("4D-fy", (), (), ()), (), (), None, State())
    for name in ("0", "1", "2"):
        (tmp_path / name).mkdir()
    record.write(bare, tmp_path / "0/run.mcap", plan_text="")
    noise = record.Footage((b"\0\0\0\1noise", b"no picture"), (), 20.0)
    record.write(bare, tmp_path / "1/run.mcap", plan_text="", footage=noise)
    record.write(replace(bare, config_yaml="[1, 2]"), tmp_path / "2/run.mcap", plan_text="")
    (tmp_path / "2/run.mp4").write_bytes(b"no film")
    main([str(tmp_path), "-o", str(tmp_path / "new/page.html")], **QUIET)
    found = Outline((tmp_path / "new/page.html").read_text())
    assert found.count("details", **{"class": "run"}) == 3 and found.count("video") == 0
    assert "No finished run says its time" in found.text


def test_limits(runs, tmp_path):
    counts = []
    for options in (["--no-videos"], ["--limit-mb", "0"], []):
        file = tmp_path / "page.html"
        main([str(runs), "-o", str(file), *options], **QUIET)
        found = Outline(file.read_text())
        counts.append((found.count("video"), found.count("ol", **{"class": "strip"}), "3 videos" in found.text))
    assert counts == [(0, 3, False), (0, 0, True), (3, 3, False)]


def test_one_line_for_bad_input(tmp_path, runs, capsys):
    (tmp_path / "study").mkdir()
    (tmp_path / "study/study.csv").write_text("experiment,variant,Q1\ndemo,full,4\n")
    for arguments, words in (
        ([str(tmp_path)], "no run.mcap below it"),
        ([str(tmp_path / "none")], "no such folder"),
        ([str(runs), "--study", str(tmp_path)], "study.csv cannot be read"),
        ([str(runs), "--study", str(tmp_path / "study")], "study.csv lacks the column Q2"),
        ([str(runs), "--limit-mb", "-1"], "0 or more is allowed"),
        ([str(runs), "-o", str(runs / "0/run.mcap/page.html")], "run.mcap"),
    ):
        assert main(arguments, **QUIET) == 2
        errors = capsys.readouterr().err.splitlines()
        assert len(errors) == 1 and errors[0].startswith("analysis.report: ") and words in errors[0], errors


def test_stills_are_the_videos_pictures(demo, tmp_path):
    path = save(demo, tmp_path / "run.mcap")
    seen = film(path, 20.0, 4 / 20)
    assert (seen.width, seen.height, seen.fps, seen.seconds) == (48, 32, 20, 0.5)
    assert [round(still.time * 20) for still in seen.stills if still.struck] == [4]
    shades = [shade_of(still.jpeg) for still in seen.stills]
    assert np.allclose(shades, [20 * round(still.time * 20) for still in seen.stills], atol=6)
    again = tmp_path / "again.mp4"
    again.write_bytes(seen.mp4)
    with av.open(str(again)) as clip:
        assert len(list(clip.decode(video=0))) == FRAMES

    bare = save(demo, tmp_path / "bare/run.mcap", video=False)
    with pytest.raises(InputError, match="has no video"):
        film(bare, 20.0, None)
    write_mp4(encode(pictures(4), 10), bare.with_name("run.mp4"))  # the one beside it
    seen = film(bare, 20.0, None)
    assert (len(seen.stills), seen.fps, seen.seconds) == (4, 10, 0.4) and not any(still.struck for still in seen.stills)


def shade_of(jpeg: bytes) -> float:
    return float(np.asarray(Image.open(io.BytesIO(jpeg))).mean())


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 40, 600])
def test_chosen_pictures(count):
    for struck in (None, 0, count // 3, count - 1):
        chosen = choose(count, 8, struck)
        assert chosen == sorted(set(chosen)) and len(chosen) == min(8, count)
        assert 0 <= chosen[0] and chosen[-1] < count
        assert struck is None or struck in chosen
        assert count < 3 or (chosen[0], chosen[-1]) == (0, count - 1)


def test_shares_of_the_time():
    parts = parts_of([Part("motion", 3.0, 1), Part("odd", float("nan"), 2), Part("render", 1.0, 6)], 5.0)
    assert [(part.name, part.share) for part in parts] == [("motion", 0.6), ("render", 0.2), ("between", 0.2)]
    assert parts[-1].colour == OTHER
    assert [part.share for part in parts_of([Part("motion", 3.0, 1)], float("nan"))] == [1.0]
    assert [part.share for part in parts_of([Part("motion", 0.0, 1)], 0.0)] == [0.0]


def test_texts_are_bounded_and_visible():
    assert clean("a\x00b\u202ec\nd") == "a b c\nd" and len(str(clean("x" * 10**6))) < 30_000
    assert clean(3.5) == 3.5
    assert "<script>" not in to_html("<script>x</script>") and "<td>1</td>" in to_html("|a|\n|-|\n|1|")


def test_what_no_command_has_left_is_empty(tmp_path):
    assert read_extra("a", "A", "make a", None) == read_extra("a", "A", "make a", tmp_path / "no")


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as opened:
        yield opened


@pytest.fixture
def opened(browser, page) -> Iterator:
    """The page, newly loaded; what it logs fails the test."""
    browser.get("about:blank")
    browser.get(page.as_uri())
    yield browser
    assert browser.get_log("browser") == []


def test_tables_sort(opened):
    column = """
    const table = [...document.querySelectorAll("h3")].find((each) => each.textContent === "Cost")
      .nextElementSibling.querySelector("table");
    const at = [...table.tHead.rows[0].cells].findIndex((cell) => cell.textContent.startsWith(arguments[0]));
    if (arguments[1]) table.tHead.rows[0].cells[at].querySelector("button").click();
    return [...table.tBodies[0].rows].map((row) => row.cells[at].textContent);
    """
    assert opened.execute_script(column, "variant", False) == ["full", "no_mdm", "no_mpm"]
    assert opened.execute_script(column, "run", False) == ["3 ± 1.4", "", "8.5 ± 0.71"]
    assert opened.execute_script(column, "run", True) == ["3 ± 1.4", "8.5 ± 0.71", ""]
    assert opened.execute_script(column, "run", True) == ["8.5 ± 0.71", "3 ± 1.4", ""]  # empty cells stay last
    assert opened.execute_script(column, "variant", True) == ["full", "no_mdm", "no_mpm"]


def test_videos_play_and_pictures_show(opened):
    opened.execute_script("document.getElementById('open').click()")
    until(
        lambda: (
            opened.execute_script(
                "return [...document.querySelectorAll('video')].map((video) => [video.videoWidth, video.videoHeight])"
            )
            == [[48, 32]] * 3
        )
    )
    opened.execute_script("document.querySelector('video').play()")
    until(lambda: opened.execute_script("return document.querySelector('video').currentTime > 0.1"))
    opened.execute_script("document.getElementById('close').click()")
    until(lambda: opened.execute_script("return document.querySelector('video').paused"))
    script = "return [...document.images].filter((each) => each.loading !== 'lazy' && !each.naturalWidth).length"
    assert opened.execute_script(script) == 0


def test_runs_filter_and_links_open_them(opened):
    field = opened.find_element("id", "filter")
    shown = (
        "return [...document.querySelectorAll('details.run:not([hidden]) summary b')].map((each) => each.textContent)"
    )
    assert len(opened.execute_script(shown)) == 6
    field.send_keys("PUNCH no_mpm")
    assert opened.execute_script(shown) == ["no_mpm"]
    assert opened.execute_script("return document.querySelectorAll('.scene:not([hidden])').length") == 1
    field.clear()
    field.send_keys("x", "\ue003")
    assert len(opened.execute_script(shown)) == 6
    opened.execute_script("document.querySelector('.matrix a').click()")
    until(lambda: opened.execute_script("return document.getElementById(location.hash.slice(1)).open"))


def test_it_fits_a_phone_and_follows_the_scheme(opened):
    grounds = []
    for width, mobile, scheme in ((360, True, "dark"), (1280, False, "light")):
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": mobile}
        opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        opened.execute_script("document.getElementById('open').click()")
        assert opened.execute_script("return document.documentElement.scrollWidth") <= width
        wide = "return [...document.querySelectorAll('.sortable td:first-child')].map((cell) => cell.offsetWidth)"
        assert min(opened.execute_script(wide)) >= 80
        ground = opened.execute_script("return getComputedStyle(document.body).backgroundColor")
        grounds.append(sum(map(int, re.findall(r"\d+", ground)[:3])))
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert grounds[0] < 150 < 600 < grounds[1]


def test_nothing_is_asked_for_and_no_foreign_script_runs(opened):
    names = opened.execute_script("return performance.getEntriesByType('resource').map((each) => each.name)")
    assert all(name.startswith("data:") for name in names)
    script = (
        "const s = document.createElement('script'); s.textContent = 'document.title = 1'; document.body.append(s);"
    )
    title = opened.execute_script(f"{script} return document.title")
    assert title == "Runs: report"
    assert any("Content Security Policy" in entry["message"] for entry in opened.get_log("browser"))


def test_a_hostile_page_does_nothing(browser, hostile):
    browser.get(hostile.as_uri())
    browser.execute_script("document.getElementById('open').click()")
    assert len(browser.find_elements("css selector", "details.run[open]")) == 3
    assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    assert browser.title == "Runs: report" and browser.get_log("browser") == []
