"""The user study's page in a real browser: headless Chromium through Selenium, from file://, offline."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from analysis.study.answers import read_answers, read_key
from analysis.study.make import Study, find_clips, make
from analysis.study.questions import QUESTIONS
from tests.analysis.test_study import record
from tests.browser import chromium, until

RATE_ALL = """
const seen = [];
while (document.getElementById("done").hidden) {
  seen.push(document.getElementById("video").getAttribute("src"));
  for (const group of document.querySelectorAll("fieldset")) group.querySelector(`input[value="3"]`).click();
  document.getElementById("next").click();
}
return seen;
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Study:
    folder = tmp_path_factory.mktemp("study")
    for number, variant in enumerate(("full", "no_mpm", "no_contact", "4D-fy", "full", "no_mpm")):
        record(folder / "runs" / str(number), variant, pictures=10)
    return make(find_clips([folder / "runs"])[0], folder / "page", seed=1)


@pytest.fixture(scope="module")
def downloads(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def opened(downloads) -> Iterator:
    with chromium(downloads=downloads) as browser:
        yield browser


@pytest.fixture
def page(opened, study) -> Iterator:
    """The page as a new rater finds it; what it logs fails the test."""
    opened.get(study.page.as_uri())
    opened.execute_script("localStorage.clear()")
    opened.refresh()
    opened.get_log("browser")
    yield opened
    assert opened.get_log("browser") == []


def element(page, name: str):
    return page.find_element("id", name)


def start(page, rater: str = "anna") -> None:
    element(page, "rater").clear()
    element(page, "rater").send_keys(rater, "\ue007")


def press(page, keys: str) -> None:
    for key in keys:
        page.switch_to.active_element.send_keys({"\n": "\ue007", "\t": "\ue004"}.get(key, key))


def count(page) -> str:
    return element(page, "count").text


def saved(page, downloads: Path, name: str, button: str) -> Path:
    (downloads / name).unlink(missing_ok=True)
    element(page, button).click()
    until((downloads / name).exists)
    return downloads / name


def test_a_rater_with_a_keyboard_stops_comes_back_and_saves(page, study, downloads):
    start(page, "bert-1")
    assert count(page) == "Video 1 of 6" and not element(page, "next").is_enabled()
    until(lambda: page.execute_script("return document.getElementById('video').currentTime > 0.1"))
    press(page, "1234")
    assert page.switch_to.active_element.get_attribute("id") == "next"
    press(page, "\n")
    assert count(page) == "Video 2 of 6"
    press(page, "55")
    page.refresh()  # in the midst of it
    assert count(page) == "Video 2 of 6" and not element(page, "next").is_enabled()
    assert [box.get_attribute("name") for box in page.find_elements("css selector", ":checked")] == ["Q1", "Q2"]
    press(page, "21\n")  # the two that are left
    assert count(page) == "Video 3 of 6"
    press(page, "b")
    assert count(page) == "Video 2 of 6"
    press(page, "\n")
    while page.switch_to.active_element.tag_name != "input":  # the way of forms: Tab past the video, then Space
        press(page, "\t")
    press(page, " ")
    assert [box.get_attribute("value") for box in page.find_elements("css selector", ":checked")] == ["1"]
    page.execute_script("document.activeElement.blur()")
    press(page, "543\n")
    for _ in range(3):
        press(page, "4444\n")
    assert element(page, "done").is_displayed() and element(page, "rated").text == "You rated 6 of 6 videos."
    page.refresh()
    assert element(page, "thanks").text == "Thank you!"

    key = read_key(study.key)
    tables = [read_answers([saved(page, downloads, f"answers-bert-1.{form}", form)], key) for form in ("json", "csv")]
    assert tables[0].equals(tables[1])
    ratings = tables[0][["Q1", "Q2", "Q3", "Q4"]].to_numpy().tolist()
    assert ratings[:2] == [[1, 2, 3, 4], [5, 5, 2, 1]] and ratings[2][1:] == [5, 4, 3]
    assert ratings[3:] == [[4] * 4] * 3
    assert set(tables[0]["video"]) == set(key.videos) and list(tables[0]["position"]) == [1, 2, 3, 4, 5, 6]


def test_order_is_the_raters_own(page, study):
    orders = {}
    for rater in ("anna", "anna ", "carl", "dora"):
        page.execute_script("localStorage.clear()")
        page.refresh()
        start(page, rater.strip())
        orders[rater] = page.execute_script(RATE_ALL)
    files = sorted(f"videos/{file.name}" for file in (study.page.parent / "videos").iterdir())
    assert all(sorted(order) == files for order in orders.values())
    assert orders["anna"] == orders["anna "]
    assert len({tuple(order) for order in orders.values()}) == 3


def test_stopping_early_saves_what_is_whole(page, study, downloads):
    start(page, "early")
    press(page, "1111\n")
    press(page, "22")
    element(page, "leave").click()
    assert element(page, "rated").text == "You rated 1 of 6 videos."
    answers = read_answers([saved(page, downloads, "answers-early.csv", "csv")], read_key(study.key))
    assert len(answers) == 1
    element(page, "return").click()
    assert count(page) == "Video 2 of 6"
    element(page, "leave").click()
    element(page, "another").click()
    page.switch_to.alert.dismiss()
    assert element(page, "done").is_displayed()
    element(page, "another").click()
    page.switch_to.alert.accept()
    until(lambda: element(page, "intro").is_displayed())
    assert element(page, "rater").get_attribute("value") not in ("", "early")


def test_codes_that_are_none_are_refused(page):
    for code in ("=1+1", "<b>x</b>", "a b", "ä"):
        start(page, code)
        assert element(page, "intro").is_displayed(), code
    start(page, "A-1_b")
    assert element(page, "trial").is_displayed()


def test_foreign_storage_does_no_harm(page, study):
    slot = f"video-study:{study.name}"
    video = next(iter(read_key(study.key).videos))
    for stored in ("{", "null", "5", '{"rater": "<b>"}', '{"rater": ["a"], "at": 1}'):
        page.execute_script("localStorage.setItem(arguments[0], arguments[1])", slot, stored)
        page.refresh()
        assert element(page, "intro").is_displayed(), stored
    answers = {video: {"Q1": 9, "Q2": "<img src=x>", "Q3": 3}, "foreign": {"Q1": 1}, "__proto__": {"Q1": 1}}
    stored = json.dumps({"rater": "anna", "at": 1e9, "answers": answers})
    page.execute_script("localStorage.setItem(arguments[0], arguments[1])", slot, stored)
    page.refresh()
    assert element(page, "rated").text == "You rated 0 of 6 videos."
    element(page, "return").click()
    kept = json.loads(page.execute_script("return localStorage.getItem(arguments[0])", slot))["answers"]
    assert kept == {video: {"Q3": 3}}


def test_a_browser_that_keeps_nothing_is_told_of(page):
    script = "Storage.prototype.setItem = () => { throw new DOMException('full', 'QuotaExceededError'); }"
    page.execute_script(script)
    start(page)
    assert "does not remember your answers" in element(page, "warning").text
    press(page, "1111\n")
    assert count(page) == "Video 2 of 6"


def test_two_tabs_do_not_overwrite_each_other(page, study):
    start(page)
    first = page.current_window_handle
    page.switch_to.new_window("tab")
    page.get(study.page.as_uri())
    press(page, "1111\n")
    page.close()
    page.switch_to.window(first)
    until(lambda: count(page) == "Video 2 of 6")


def test_a_broken_video_can_be_skipped(opened, study, tmp_path):
    shutil.copytree(study.page.parent, tmp_path / "page")
    for file in (tmp_path / "page" / "videos").iterdir():
        file.write_bytes(b"no video")
    opened.get((tmp_path / "page" / "index.html").as_uri())
    opened.execute_script("localStorage.clear()")
    opened.refresh()
    start(opened, "anna")
    until(element(opened, "broken").is_displayed)
    assert element(opened, "next").text == "Skip"
    press(opened, "1111\n")
    assert count(opened) == "Video 2 of 6"
    opened.get_log("browser")


def test_one_file_plays_what_is_inside_and_asks_for_nothing(opened, study, tmp_path):
    clips = study.clips[:2]
    single = make(clips, tmp_path / "page.html", seed=1)
    opened.get(single.page.as_uri())
    start(opened)
    until(lambda: opened.execute_script("return document.getElementById('video').videoWidth") == 48)
    names = opened.execute_script("return performance.getEntriesByType('resource').map(each => each.name)")
    assert all(name.startswith("data:") for name in names)
    asked = "return fetch('https://example.org').then(() => 'sent', () => 'refused')"
    assert opened.execute_script(asked) == "refused"
    assert any("Content Security Policy" in entry["message"] for entry in opened.get_log("browser"))


def test_it_fits_a_phone_and_a_small_laptop(page):
    def box(name: str) -> dict:
        return page.execute_script("return document.getElementById(arguments[0]).getBoundingClientRect()", name)

    for width, height, mobile in ((360, 640, True), (390, 844, True), (1280, 640, False)):
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        page.execute_script("localStorage.clear()")
        page.refresh()
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
        start(page)
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
        for place in (0, 10_000):
            page.execute_script("scrollTo(0, arguments[0])", place)
            assert box("video")["top"] >= -1 and box("video")["height"] > 200
            assert box("next")["bottom"] <= height + 1
            assert box("next")["top"] > box("video")["top"]
        sizes = page.execute_script(
            "return [...document.querySelectorAll('.scale label')].map(each => each.getBoundingClientRect())"
        )
        assert len(sizes) == 5 * len(QUESTIONS)
        assert all(size["width"] >= 40 and size["height"] >= 44 for size in sizes)  # a finger's
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_screen_reader_has_names(page):
    start(page)
    groups = page.find_elements("tag name", "fieldset")
    assert [group.accessible_name for group in groups] == [question.title for question in QUESTIONS]
    labels = [box.accessible_name for box in groups[0].find_elements("tag name", "input")]
    assert labels == ["1 worst", "2", "3", "4", "5 best"]
