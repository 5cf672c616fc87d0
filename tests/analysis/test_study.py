"""The user study without a browser: the page's making, answers from outside, scores and agreement."""

import json
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_1samp

from analysis.study.__main__ import main
from analysis.study.agreement import alpha
from analysis.study.answers import Key, read_answers, read_key
from analysis.study.make import find_clips, make
from analysis.study.opinions import read_opinions
from analysis.study.questions import COLUMNS
from analysis.study.score import interval, opinion_scores, rater_agreement, to_markdown
from hoi.data import Plan, Run, State
from hoi.errors import InputError
from hoi.record import write
from hoi.render.encode import encode, write_mp4

NAN = float("nan")


def record(folder: Path, variant: str, scene: str = "kick", pictures: int = 4) -> Path:
    """A record of nothing but its labels, and a video beside it."""
    labels = {"scene": scene, "experiment": "demo", "variant": variant, "seed": "0", "status": "done"}
    run = Run("", {}, labels, Plan(variant, (), (), ()), (), (), None, State())
    folder.mkdir(parents=True)
    write(run, folder / "run.mcap", plan_text="")
    if pictures:
        colour = np.random.default_rng(len(str(folder))).integers(0, 256, (pictures, 1, 1, 3), np.uint8)
        write_mp4(encode(np.broadcast_to(colour, (pictures, 32, 48, 3)), 20), folder / "run.mp4")
    return folder / "run.mcap"


@pytest.fixture
def runs(tmp_path) -> Path:
    for variant in ("full", "no_mpm", "4D-fy"):
        for scene in ("kick_ball", "punch_jelly"):
            record(tmp_path / "runs" / scene / variant, variant, scene)
    return tmp_path / "runs"


def test_page_is_whole_and_says_nothing_about_the_systems(runs, tmp_path):
    record(runs / "without", "full", pictures=0)
    clips, without = find_clips([runs, runs / "kick_ball"])
    assert len(clips) == 6 and without == [runs / "without" / "run.mcap"]
    study = make(clips, tmp_path / "page", seed=3)
    key = json.loads((tmp_path / "page.key.json").read_text())
    files = sorted(file for file in (tmp_path / "page").rglob("*") if file.is_file())
    assert [file.name for file in files] == ["index.html", *(f"{name}.mp4" for name in sorted(key["videos"]))]
    assert {video["variant"] for video in key["videos"].values()} == {"full", "no_mpm", "4D-fy"}
    for file in files:
        content = file.read_bytes() + file.name.encode()
        for secret in (b"no_mpm", b"4D-fy", b"kick_ball", b"punch_jelly", b"demo", str(tmp_path).encode(), b"hoi"):
            assert secret not in content.replace(b"hoi.study.answers/1", b""), (file.name, secret)
    page = files[0].read_text()
    assert study.name in page and "{{" not in page and "://" not in page
    assert sorted(page.split('"videos": [')[1].count(name) for name in key["videos"]) == [2] * 6  # id and src


def test_same_seed_same_study_and_no_seed_another(runs, tmp_path):
    clips, _ = find_clips([runs])
    pages = [make(clips, tmp_path / name, seed=seed) for name, seed in (("a", 5), ("b", 5), ("c", None))]
    assert pages[0].name == pages[1].name != pages[2].name
    assert pages[0].page.read_bytes() == pages[1].page.read_bytes()
    assert pages[0].key.read_bytes() == pages[1].key.read_bytes()


def test_tags_and_sound_are_lost_and_pictures_kept(runs, tmp_path):
    source = runs / "kick_ball" / "full" / "run.mp4"
    tagged = tmp_path / "tagged.mp4"
    with av.open(str(source)) as plain, av.open(str(tagged), "w") as out:
        out.metadata["title"] = "SECRET no_mpm"
        copy = out.add_stream_from_template(plain.streams.video[0])
        copy.metadata["handler_name"] = "SECRET"
        for packet in plain.demux(video=0):
            if packet.dts is not None:
                packet.stream = copy
                out.mux(packet)
    assert b"SECRET" in tagged.read_bytes()
    tagged.replace(source)
    study = make(find_clips([runs])[0], tmp_path / "page")
    name = next(n for n, v in json.loads(study.key.read_text())["videos"].items() if v["video"] == str(source))
    made = study.page.parent / "videos" / f"{name}.mp4"
    assert b"SECRET" not in made.read_bytes()
    with av.open(str(source)) as a, av.open(str(made)) as b:
        for one, other in zip(a.decode(video=0), b.decode(video=0), strict=True):
            assert np.array_equal(one.to_ndarray(), other.to_ndarray())


def test_other_codecs_are_encoded_for_browsers(runs, tmp_path):
    source = runs / "kick_ball" / "full" / "run.mp4"
    with av.open(str(source), "w") as out:
        track = out.add_stream("mpeg4", rate=10)
        track.width, track.height, track.pix_fmt = 47, 33, "yuv420p"
        for _ in range(3):
            picture = av.VideoFrame.from_ndarray(np.full((33, 47, 3), 200, np.uint8), format="rgb24")
            out.mux(track.encode(picture))
        out.mux(track.encode(None))
    study = make(find_clips([source.parent])[0], tmp_path / "page.html")
    assert study.page == tmp_path / "page.html" and study.key == tmp_path / "page.key.json"
    assert "data:video/mp4;base64," in study.page.read_text()
    folder = make(find_clips([source.parent])[0], tmp_path / "folder").page.parent
    with av.open(str(next(folder.glob("videos/*.mp4")))) as made:
        track = made.streams.video[0]
        assert (track.codec_context.name, track.width, track.height, track.average_rate) == ("h264", 46, 32, 10)
        assert abs(int(next(made.decode(track)).to_ndarray(format="rgb24").mean()) - 200) < 6


def test_what_cannot_be_made_is_one_line(runs, tmp_path, capsys):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "answers.json").write_text("{}")
    (tmp_path / "empty").mkdir()
    record(tmp_path / "bad" / "video", "full", pictures=0).with_suffix(".mp4").write_bytes(b"\0" * 999)
    (tmp_path / "foreign").mkdir()
    for name in ("run.mcap", "run.mp4"):
        (tmp_path / "foreign" / name).write_bytes(b"nothing")
    out = ["-o", str(tmp_path / "out")]
    for arguments, message in (
        ([str(runs), "-o", str(tmp_path / "taken")], "is not overwritten"),
        ([str(runs), *out, "--key", str(tmp_path / "out" / "key.json")], "would be part of the page"),
        ([str(tmp_path / "empty"), *out], "no run.mcap with a run.mp4"),
        ([str(tmp_path / "bad"), *out], "run.mp4 is no video that can be read"),
        ([str(tmp_path / "foreign"), *out], "is not an MCAP file"),
        ([str(runs), "-o", "/proc/none/page"], "cannot write"),
    ):
        assert main(["make", *arguments]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
    left = {file.name for file in tmp_path.iterdir()}
    assert left == {"runs", "taken", "empty", "bad", "foreign"}  # nothing half made


KEY = Key("s1", {f"v{n}": {"scene": "kick", "experiment": "demo", "variant": v, "seed": "0"} for n, v in
                 enumerate(("full", "full", "no_mpm", "no_mpm", "4D-fy"))})  # fmt: skip
GOOD = [("s1", "anna", 1, "v0", 4, 5, 3, 4), ("s1", "anna", 2, "v2", 1, 2, 3, 4)]


def as_csv(rows, header=COLUMNS, end="\r\n") -> str:
    return "".join(",".join(map(str, row)) + end for row in (header, *rows))


def as_json(rows, **changes) -> str:
    answers = [dict(zip(COLUMNS[2:], row[2:], strict=True)) for row in rows]
    return json.dumps({"format": "hoi.study.answers/1", "study": "s1", "rater": "anna", "answers": answers} | changes)


def test_csv_and_json_say_the_same(tmp_path):
    (tmp_path / "a.csv").write_text("\ufeff" + as_csv(GOOD, end="\n") + "\n")
    (tmp_path / "a.json").write_text(as_json(GOOD))
    tables = [read_answers([tmp_path / name], KEY) for name in ("a.csv", "a.json")]
    pd.testing.assert_frame_equal(*tables)
    assert tables[0].to_numpy().tolist() == [list(row) for row in GOOD]


def changed(column: str, value: object) -> list[tuple]:
    row = dict(zip(COLUMNS, GOOD[1], strict=True)) | {column: value}
    return [GOOD[0], tuple(row.values())]


HUGE = "1" + "0" * 5000
"""A number that Python's int() refuses to read."""
HOSTILE = [
    ("Q3", 6, "Q3 is"),
    ("Q3", 0, "Q3 is"),
    ("Q1", -1, "Q1 is"),
    ("Q1", "", "Q1 is ''"),
    ("Q1", 4.5, "Q1 is '4.5'"),
    ("Q1", "1e9", "Q1 is '1e9'"),
    ("Q1", "NaN", "Q1 is 'NaN'"),
    ("Q1", "٣", "Q1 is '\\u0663'"),
    ("Q2", HUGE, "Q2 is '1000"),
    ("Q2", "=HYPERLINK(1)", "Q2 is '=HYPERLINK(1)'"),
    ("Q4", "<script>alert(1)</script>", "Q4 is"),
    ("position", 6, "position is 6, allowed are 1 to 5"),
    ("rater", "=cmd|calc", "rater is '=cmd|calc'"),
    ("rater", "<b>anna</b>", "rater is"),
    ("rater", "a" * 33, "rater is"),
    ("video", "../../etc/passwd", "video is '../../etc/passwd', which the key does not have"),
    ("study", "s2", "study is 's2', the key is of s1"),
    ("video", "v0", "rater anna has rated video v0 before, in"),
]


@pytest.mark.parametrize("column, value, message", HOSTILE, ids=[f"{row[0]}:{row[1]!s:.12}" for row in HOSTILE])
@pytest.mark.parametrize("form", ["csv", "json"])
def test_a_bad_row_is_named(tmp_path, form, column, value, message):
    file = tmp_path / f"answers.{form}"
    if form == "csv":
        file.write_text(as_csv(changed(column, value)))
    elif column in ("study", "rater"):
        file.write_text(as_json(GOOD, **{column: value}))
    else:
        file.write_text(as_json(changed(column, value)).replace(f'"{HUGE}"', HUGE))
    with pytest.raises(InputError) as caught:
        read_answers([file], KEY)
    row = 3 if form == "csv" else 1 if column in ("study", "rater") else 2
    assert str(caught.value).startswith(f"{file} row {row}: ") and message in str(caught.value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < len(str(file)) * 2 + 150


MALFORMED = [
    ("a.json", "", "a.json is not JSON"),
    ("a.json", "[" * 200_000, "a.json is not JSON"),
    ("a.json", "[]", "a.json is not a file of answers"),
    ("a.json", as_json([], answers={}), "answers should be a list"),
    ("a.json", as_json([], answers=[5]), "row 1: 5 should have position, video"),
    ("a.json", as_json(GOOD).replace('"Q2": 5', '"Q1": 5'), "a name stands twice"),
    ("a.json", as_json(GOOD).replace('"Q1": 4', '"Q1": true'), "row 1: Q1 is True"),
    ("a.json", as_json(GOOD).replace('"Q1": 4', '"Q1": "4"'), "row 1: Q1 is '4'"),
    ("a.json", as_json(GOOD).replace('"Q1": 4', '"Q1": Infinity'), "row 1: Q1 is 'Infinity'"),
    ("a.json", as_json(GOOD).replace('"Q1": 4', '"Q1": [4]'), "row 1: Q1 is [4]"),
    ("a.json", as_json([]), "a.json has no answers"),
    ("a.csv", as_csv([]), "a.csv has no answers"),
    ("a.csv", "", "a.csv has no answers"),
    ("a.csv", as_csv(GOOD).replace(",", ";"), "row 1: the header is"),
    ("a.csv", as_csv([*GOOD, GOOD[0][:-1]]), "row 4: 7 cells where 8 should be"),
    ("a.csv", as_csv([GOOD[0]]) + 's1,"anna', "row 3: unexpected end of data"),
    ("a.csv", as_csv([GOOD[0]]) + "x" * 140_000, "row 3: field larger than field limit"),
    ("a.csv", as_csv([("s1", '"a\nb"', *GOOD[0][2:])]), "row 2: rater is 'a\\nb'"),
    ("a.csv", "\udcff", "a.csv is not text in UTF-8"),
    ("a.csv", "x" * (17 << 20), "at most 16777216 are read"),
    ("none.csv", None, "cannot be read: No such file"),
]


@pytest.mark.parametrize("name, content, message", MALFORMED, ids=[row[2][:30] for row in MALFORMED])
def test_malformed_files_are_refused_in_one_line(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(InputError) as caught:
        read_answers([tmp_path / name], KEY)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "videos", [{}, [], {"v": 1}, {"v": {"scene": "s", "experiment": "e", "variant": 3, "seed": "0"}}]
)
def test_a_bad_key_is_refused(tmp_path, videos):
    file = tmp_path / "key.json"
    file.write_text(json.dumps({"format": "hoi.study.key/1", "study": "s", "videos": videos}))
    with pytest.raises(InputError, match=r"key\.json"):
        read_key(file)
    file.write_text(as_json(GOOD))
    with pytest.raises(InputError, match="is not the key of a study"):
        read_key(file)


# Krippendorff (2011), section E: four observers, twelve units, missing data.
PUBLISHED = np.array(
    [
        [1, 2, 3, 3, 2, 1, 4, 1, 2, NAN, NAN, NAN],
        [1, 2, 3, 3, 2, 2, 4, 1, 2, 5, NAN, 3],
        [NAN, 3, 3, 3, 2, 3, 4, 2, 2, 5, 1, NAN],
        [1, 2, 3, 3, 2, 4, 4, 1, 2, 5, 1, NAN],
    ]
)


@pytest.mark.parametrize("level, published", [("nominal", 0.743), ("ordinal", 0.815), ("interval", 0.849)])
def test_alpha_of_the_published_example(level, published):
    assert alpha(PUBLISHED, level) == pytest.approx(published, abs=5e-4)


def test_alpha_at_its_ends():
    agreed = np.tile([1.0, 3, 5, 2], (3, 1))
    chance = np.random.default_rng(0).integers(1, 6, (4, 4000)).astype(float)
    opposed = np.array([[1.0, 5], [5, 1]])
    for level in ("nominal", "ordinal", "interval"):
        assert alpha(agreed, level) == 1
        assert abs(alpha(chance, level)) < 0.02
        assert alpha(opposed, level) < 0
        assert np.isnan(alpha(np.full((3, 4), 2.0), level))  # nothing varies
        assert np.isnan(alpha(np.array([[1.0, NAN], [NAN, 2.0]]), level))  # nobody shares a video
    with pytest.raises(ValueError, match="nominal, ordinal, interval"):
        alpha(agreed, "ratio")


def test_interval_is_students():
    means = np.random.default_rng(1).normal(3, 0.4, 23)
    expected = ttest_1samp(means, 0).confidence_interval(0.95)
    assert interval(means) == pytest.approx((means.mean(), expected.low, expected.high))
    assert np.isnan(interval(np.array([4.0]))[1:]).all()
    assert interval(np.array([5.0, 4.0]))[1:] == (1, 5)  # cut to the scale


def test_interval_covers_as_it_says():
    """Raters who differ in leniency, videos that differ, ratings rounded to the scale."""
    rng, hits = np.random.default_rng(2), 0
    for _ in range(1000):
        ratings = rng.normal(3.2, 0.5, (12, 1)) + rng.normal(0, 0.8, (12, 5))
        _, low, high = interval(np.clip(np.round(ratings), 1, 5).mean(axis=1))
        hits += low <= 3.2 <= high
    assert 0.93 < hits / 1000 < 0.97


def test_scores_by_hand():
    rows = [*GOOD, ("s1", "anna", 3, "v1", 2, 5, 3, 4), ("s1", "bert", 1, "v0", 5, 5, 3, 4)]
    answers = pd.DataFrame(rows, columns=list(COLUMNS))
    scores = opinion_scores(answers, KEY).set_index("variant")
    assert list(scores.index) == ["full", "no_mpm", "4D-fy"]
    assert scores.loc["full", "Q1"] == 4  # anna's mean is 3, bert's 5
    assert list(scores.loc["full", ["videos", "raters", "ratings"]]) == [2, 2, 3]
    assert scores.loc["no_mpm", "Q1"] == 1 and np.isnan(scores.loc["no_mpm", "Q1_low"])
    assert scores.loc["4D-fy", "raters"] == 0 and np.isnan(scores.loc["4D-fy", "Q1"])
    agreement = rater_agreement(answers).set_index("question")
    assert agreement.loc["Q1", "raters"] == 2 and agreement.loc["Q1", "videos"] == 3
    assert np.isnan(agreement.loc["Q2", "alpha_ordinal"])  # the one shared video: both say 5


def test_score_writes_the_same_bytes_and_no_formula(tmp_path, capsys):
    videos = {
        f"v{n}": video | ({"variant": '=1+1|<b>"x"'} if n == 4 else {}) for n, video in enumerate(KEY.videos.values())
    }
    key = {"format": "hoi.study.key/1", "study": "s1", "seed": 2**64, "videos": videos}
    (tmp_path / "key.json").write_text(json.dumps(key))
    (tmp_path / "a.json").write_text(as_json(GOOD))
    bert = [("s1", "bert", 1, "v0", 5, 4, 4, 4), ("s1", "bert", 2, "v4", 1, 1, 2, 2)]
    (tmp_path / "b.csv").write_text(as_csv(bert))
    command = ["score", str(tmp_path / "a.json"), str(tmp_path / "b.csv"), "--key", str(tmp_path / "key.json")]
    for folder in ("one", "two"):
        assert main([*command, "-o", str(tmp_path / folder)]) == 0
    for name in ("study.csv", "study_agreement.csv", "study.md"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    table = pd.read_csv(tmp_path / "one" / "study.csv")
    assert list(table["variant"]) == ["full", "no_mpm", '\'=1+1|<b>"x"']
    assert table.loc[0, "Q1"] == 4.5
    opinions = read_opinions(tmp_path / "one" / "study.csv")
    assert opinions["variant"].tolist() == table["variant"].tolist() and opinions["q1"][0] == 4.5
    markdown = (tmp_path / "one" / "study.md").read_text()
    assert "| 4.50 [1.00, 5.00] |" in markdown and "=1+1\\|&lt;b&gt;" in markdown and "Student's t" in markdown
    assert capsys.readouterr().out == markdown * 2


def test_opinions_for_the_tables(tmp_path):
    file = tmp_path / "study.csv"
    file.write_text("experiment,variant,Q1,Q2,Q3,Q4,Q1_low\n,4D-fy,1,2,3,4,1\ndemo,full,5,5,,5,4\n")
    scores = read_opinions(file)
    assert list(scores) == ["experiment", "variant", "q1", "q2", "q3", "q4"]
    assert scores["experiment"].tolist() == ["", "demo"] and pd.isna(scores["q3"][1])
    for text, said in (
        ("a,b,1,2,3,4\na,b,1,2,3,4\n", "a variant twice"),
        ("a,b,much,2,3,4\n", "cannot be read"),
    ):
        file.write_text(f"experiment,variant,Q1,Q2,Q3,Q4\n{text}")
        with pytest.raises(InputError, match=f"study.csv .*{said}"):
            read_opinions(file)


def test_score_refuses_by_file_and_row(tmp_path, capsys):
    key = {"format": "hoi.study.key/1", "study": "s1", "videos": KEY.videos}
    (tmp_path / "key.json").write_text(json.dumps(key))
    (tmp_path / "bad.csv").write_text(as_csv(changed("Q3", 6)))
    out = tmp_path / "out"
    assert main(["score", str(tmp_path / "bad.csv"), "--key", str(tmp_path / "key.json"), "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert error == f"analysis.study: {tmp_path / 'bad.csv'} row 3: Q3 is 6, allowed are 1 to 5\n"
    assert not out.exists()


def test_order_of_variants():
    names = ["4D-fy", "no_mpm+no_video_sds", "no_video_sds", "full", "no_mdm", "AnimateAnyMesh"]
    key = Key("s", {n: {"scene": "s", "experiment": "e", "variant": n, "seed": "0"} for n in names})
    answers = pd.DataFrame([("s", "r", 1, n, 1, 2, 3, 4) for n in names], columns=list(COLUMNS))
    scores = opinion_scores(answers, key)
    expected = ["full", "no_mdm", "no_video_sds", "no_mpm+no_video_sds", "4D-fy", "AnimateAnyMesh"]
    assert list(scores["variant"]) == expected
    assert to_markdown(scores, rater_agreement(answers)).count("\n| e |") == 6
