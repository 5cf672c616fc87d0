"""What the docs say holds: every command in README and docs runs in its reduced form, the reference is complete.

Reduced means: a run is composed, checked and planned (`plan_only=true`) with the user's files as empty stand-ins; a
sweep is composed (`--cfg hydra`); any other command is asked for `--help`, which must know every option given; of
`make`, the same for what the target would call.
"""

import ast
import contextlib
import io
import pkgutil
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import get_type_hints

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from hoi.config import CONF, SCHEMAS, register
from hoi.gaussians import fibonacci_sphere, write_ply, write_splat, write_spz
from hoi.record import write
from hoi.record.schemas import ATTACHMENTS, JSON_SCHEMAS, PROTOBUF_SCHEMAS
from hoi.runner.arguments import arguments as typed
from hoi.runner.execute import execute
from tests.bodies import cloud_of
from tests.conftest import ROOT
from tests.demo_run import make_run

sys.path.insert(0, str(ROOT / "scripts"))
import docs_config
import docs_record

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CANNOT = {
    "hf download": "fetches gigabytes",
    "pip install hydra-ray-launcher": "another package index and environment",
    "git clone": "asks the network",
    "rerun": "opens a window",
    "python -m tests.": "a test program, which takes minutes",
}
"""How a command begins that is not run, and what it would take."""
STANDS_IN = re.compile(r"\.(bvh|npz|splat|ply|spz|mcap|mp4|glb|json|safetensors|ckpt)$")
"""Files that the commands take to be the user's."""

METADATA = {"hoi.record", "hoi.run", "hoi.result", "hoi.Array", "hoi.ObjectState"}
"""Names in a record that look like Python's."""


def commands_of(page: Path) -> Iterator[str]:
    """The commands of a page's shell blocks, and those in running text that can be copied as they are."""
    text = page.read_text()
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    for language, block in blocks:
        if language in ("", "sh", "bash", "shell", "console"):
            for line in block.replace("\\\n", " ").splitlines():
                if words := shlex.split(line, comments=True):
                    yield shlex.join(words)
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    for span in re.findall(r"`([^`]+)`", prose):
        span = " ".join(span.split())
        if re.match(r"(python -m [\w.]+|hoi [a-z-]+|make [a-z]+|pip install)\b", span):
            yield shlex.join(shlex.split(span))


COMMANDS = sorted({command for page in PAGES for command in commands_of(page)})


def words_of(command: str) -> list[str]:
    """The words of a command, `hoi X` as the `python -m` that it stands for."""
    words = shlex.split(command, comments=True)
    if words == ["hoi"]:
        words = ["python", "-m", "hoi"]
    elif words[0] == "hoi":
        from hoi.runner.cli import modules

        assert words[1] in modules(), f"hoi has no command {words[1]}"
        words = ["python", "-m", modules()[words[1]], *words[2:]]
    return [word for word in words if not re.fullmatch(r"[A-Z_]+=\S*", word) or words[0] == "make"]


def called(module: str, *arguments: str) -> str:
    """What `python -m module arguments` prints; it must end well."""
    out, before = io.StringIO(), sys.argv
    sys.argv = [module, *arguments]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            runpy.run_module(module, run_name="__main__", alter_sys=False)
    except SystemExit as end:
        assert not end.code, out.getvalue()[-500:]
    finally:
        sys.argv = before
    return out.getvalue()


@cache
def help_of(module: str) -> str:
    return called(module, "--help")


def check_module(module: str, arguments: list[str], folder: Path) -> None:
    """The reduced form of `python -m module arguments`."""
    if find_spec(module.partition(".")[0]) is None:
        pytest.skip(f"{module} is not installed")
    if module != "hoi.run" or "--help" in arguments:
        said = help_of(module)
        for option in (word.partition("=")[0] for word in arguments if re.match(r"--?[a-z]", word)):
            assert re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", said), f"{module} --help knows no {option}"
    elif "--config-name" in arguments:
        first = [word.partition(",")[0] for word in arguments]  # the first run of it
        called(module, *(str(ROOT / word) if word == "sweeps" else word for word in first), "--cfg", "hydra")
    else:
        if "--multirun" in arguments:  # the first run of it
            arguments = [word.partition(",")[0] for word in arguments if word != "--multirun"]
        overrides = [*(stand_in(word, folder) for word in arguments), "plan_only=true", f"out={folder}/out"]
        register()
        with initialize_config_dir(str(CONF), version_base="1.3"):  # `python -m hoi.run` composes twice
            execute(compose("config", typed(overrides)), overrides)


def stand_in(argument: str, folder: Path) -> str:
    """The argument, with a small cloud, an empty file or a folder in the place of a user's."""
    key, equals, value = argument.partition("=")
    if equals and (STANDS_IN.search(value) or key.endswith((".path", "checkpoint"))) and value != "null":
        place = folder / Path(value).name
        if writer := {".ply": write_ply, ".splat": write_splat, ".spz": write_spz}.get(place.suffix):
            writer(cloud_of(fibonacci_sphere(500), 0.05), place)
        else:
            place.touch() if STANDS_IN.search(value) else place.mkdir(exist_ok=True)
        return f"{key}={place}"
    return argument.replace("file://docs", f"file://{ROOT}/docs")


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("command", COMMANDS)
def test_command(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if reason := next((why for start, why in CANNOT.items() if command.startswith(start)), None):
        pytest.skip(reason)
    words = words_of(command)
    if words[:2] == ["python", "-m"]:
        return check_module(words[2], words[3:], tmp_path)
    if words[0] == "make":
        done = subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for line in re.findall(r"^\.venv/bin/python (-m (?:hoi|analysis)\..*)$", done.stdout, re.MULTILINE):
            _, module, *arguments = shlex.split(line)
            check_module(module, arguments, tmp_path)
        return None
    if words[:2] == ["pip", "install"]:
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        asked = re.findall(r"\[([\w,]+)\]", command)
        assert asked and set(asked[0].split(",")) <= set(extras), f"{command}: extras are {', '.join(extras)}"
        return None
    if words[0] == "python" and Path(words[1]).suffix == ".py":
        assert (ROOT / words[1]).is_file()
        return None
    pytest.fail(f"{command}: neither has a reduced form nor is in CANNOT")


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_files_and_names_that_a_page_speaks_of_exist(page):
    """Whole paths of the repository, and dotted names of Python."""
    prose = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    spans = {span for span in re.findall(r"`([^`\n]+)`", prose)}
    paths = {span for span in spans if re.fullmatch(r"(hoi|analysis|conf|docs|scripts|tests|sweeps)/[\w/.]+", span)}
    assert not sorted(path for path in paths if not (ROOT / path).exists())
    names = {span for span in spans if re.fullmatch(r"(hoi|analysis)(\.\w+)+", span)}
    missing = []
    for name in sorted(names - METADATA):
        try:
            pkgutil.resolve_name(name)
        except (ImportError, AttributeError):
            missing.append(name)
    assert not missing


def test_the_papers_symbols_are_where_the_method_page_says():
    """Each name of its tables stands in the files of its row, or is a key of the config."""
    known = {key.path for section in docs_config.sections() for key in section.keys}
    rows = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \|$", (ROOT / "docs" / "method.md").read_text(), re.MULTILINE)
    checked = 0
    for _, names, files in rows:
        texts = [(ROOT / file).read_text() for file in re.findall(r"`([\w/]+\.(?:py|yaml))`", files)]
        for name in re.findall(r"`([A-Za-z_][\w.]+)`", names) if texts else []:
            last = name.rpartition(".")[2]
            checked += 1
            assert name in known or any(re.search(rf"\b{last}\b", text) for text in texts), f"{name} is not in {files}"
    assert checked > 40


FLOORS = (
    ("training", "export", "view", "runner", "api"),
    ("plan", "config"),
    ("stages",),
    ("method",),
    ("body", "objects", "motion", "mpm", "refine", "render", "video_prior"),
    ("data", "gaussians", "errors", "files"),
)
"""As docs/code.md draws them."""


def imported(path: Path) -> Iterator[str]:
    """The rooms of hoi that a file imports when it runs, anywhere in it; not what it takes for types alone."""
    tree = ast.parse(path.read_text())
    kinds = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    apart = {id(inner) for node in kinds for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in apart:
            named = [node.module] if node.module != "hoi" else [f"hoi.{alias.name}" for alias in node.names]
            yield from (name.split(".")[1] for name in named if name.startswith("hoi."))


def test_imports_go_down_as_the_page_of_the_code_draws():
    for number, floor in enumerate(FLOORS):
        above = {room for higher in FLOORS[:number] for room in higher}
        for place in (ROOT / "hoi" / room for room in floor):
            for path in place.rglob("*.py") if place.is_dir() else [place.with_suffix(".py")]:
                upwards = set(imported(path)) & above
                assert not upwards, f"{path.relative_to(ROOT)} imports {', '.join(sorted(upwards))}"


@pytest.fixture(scope="module")
def keys():
    """The rows of the reference."""
    return [key for section in docs_config.sections() for key in section.keys]


def test_every_key_is_described(keys):
    """Every field of every schema is there, with what it is, and with its unit where it is a number with a fraction."""
    assert not [key.path for key in keys if not key.about]
    listed = {key.path.rpartition(".")[2] for key in keys}
    for schema in SCHEMAS.values():
        hints = get_type_hints(schema)
        for field in fields(schema):
            nested = is_dataclass(docs_config.inner_type(hints[field.name]))
            assert nested or field.name in listed, f"{schema.__name__}.{field.name}"
    config = docs_config.composed()
    numbers = [key for key in keys if "[]" not in key.path and isinstance(OmegaConf.select(config, key.path), float)]
    assert len(numbers) > 30 and not [key.path for key in numbers if not key.unit]


def test_every_key_of_every_option_is_on_the_page(keys):
    """What the files of conf/ set is what the page lists."""
    rows = {key.path for key in keys}
    for group in docs_config.groups():
        for option in docs_config.options(group):
            for path in dict(docs_config.settings(CONF / group / f"{option}.yaml", group.replace("/", "."))):
                whole = any(row.startswith(f"{path}.") for row in rows)
                assert whole or path in rows, f"{group}={option} sets {path}"


def test_defaults_and_sources_are_those_of_the_files(keys):
    keys = {key.path: key for key in reversed(keys)}  # the default option's, where several have a key
    sigma, youngs = keys["stage.attraction.sigma"], keys["material.youngs_modulus"]
    assert (sigma.unit, sigma.default, sigma.source) == ("frames", "2", "`conf/stage/attraction/windowed.yaml`")
    assert (youngs.unit, youngs.default, youngs.paper) == ("Pa", "700000", "1e+07")
    assert "inflated" in youngs.source and "`conf/material/soccer_ball.yaml`" in youngs.source
    assert (keys["object.size"].unit, keys["object.size"].default) == ("m", "0.22")
    assert keys["out"].default == "runs/${scene.name}/${experiment}/${ablation}/s${seed}"
    assert keys["scene.planes[].friction"].default == "null"


def test_the_pages_are_whole_tables():
    for page in (docs_config.page(), docs_record.page()):
        rows = [line for line in page.splitlines() if line.startswith("|")]
        columns = {len(re.findall(r"(?<!\\)\|", row)) for row in rows}
        assert rows and columns <= {3, 4, 7}


def test_the_record_page_has_every_topic_and_attachment(tmp_path):
    from mcap.reader import make_reader

    page = docs_record.page()
    topics = {*JSON_SCHEMAS, *PROTOBUF_SCHEMAS}
    assert all(f"### {topic}\n" in page and f"`{topic}`" in docs_record.OPENING + page for topic in topics)
    run, *points = make_run()
    write(run, tmp_path / "run.mcap", *points, plan_text="")
    with open(tmp_path / "run.mcap", "rb") as file:
        reader = make_reader(file)
        assert {attachment.name for attachment in reader.iter_attachments()} == set(ATTACHMENTS)
        assert {channel.topic for _, channel, _ in reader.iter_messages()} <= topics


@pytest.mark.skipif(find_spec("material") is None, reason="mkdocs-material is an extra: pip install 'hoi[docs]'")
def test_the_site_builds_and_asks_no_other_server(tmp_path):
    """Strictly: links between pages, to anchors and to pictures hold, and every page is in the menu."""
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 20
    fetched = re.compile(r"<(?:script|img|iframe|source|link)[^>]*(?:src|href)=[\"']?((?:https?:)?//[^\"'> ]+)[^>]*>")
    for page in pages:
        asked = [m[0] for m in fetched.finditer(page.read_text()) if 'rel="canonical"' not in m[0]]
        assert not asked, f"{page.name}: {asked}"
