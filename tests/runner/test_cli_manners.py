"""What every command owes its user: one front door, help that is quick and has an example, and a clean screen."""

import fcntl
import os
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from hoi import __version__
from hoi.runner.cli import main, modules
from hoi.runner.execute import LOCK, alone, let_go, what_next

ROOT = Path(__file__).parents[2]
HEAVY = {
    "torch", "taichi", "transformers", "diffusers", "matplotlib", "pandas", "scipy", "trimesh", "av", "PIL", "mcap",
    "jinja2", "plyfile", "viser", "rerun", "gsplat", "safetensors", "pygltflib",
}  # fmt: skip
QUICK = ["experiment=smoke", "ablation=no_mpm", "stage/motion=none", "stage.coordinate.iterations=2"]
QUICK += ["render=video", "render.width=96", "render.height=64"]


def python(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=os.environ | environment)


def hoi(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return python("-m", "hoi", *arguments, cwd=cwd, **environment)


# --- the front door ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"], ["help"]])
def test_it_lists_every_command_in_a_line(arguments, tmp_path):
    shown = hoi(*arguments, cwd=tmp_path)
    assert shown.returncode == 0 and not shown.stderr
    lines = shown.stdout.splitlines()
    for name in modules():
        assert len([line for line in lines if line.split()[:1] == [name]]) == 1, name
    assert "hoi run scene=kick_soccer_ball" in shown.stdout
    assert max(map(len, lines)) <= 100 and len(lines) < 60


def test_every_command_is_there():
    for name, module in modules().items():
        spec = find_spec(module)
        assert spec is not None, name
        if spec.submodule_search_locations is not None:
            assert find_spec(f"{module}.__main__") is not None, name


def test_the_script_is_the_front_door():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"hoi": "hoi.runner.cli:main"}


def test_version(tmp_path):
    assert hoi("--version", cwd=tmp_path).stdout == f"hoi {__version__}\n"


@pytest.mark.parametrize(
    ("word", "nearest"), [("veiw", "hoi view"), ("exprot", "hoi export"), ("scene=x", "hoi run scene=x"), ("~", "hoi ")]
)
def test_a_wrong_command_is_one_line(word, nearest, tmp_path):
    done = hoi(word, cwd=tmp_path)
    assert done.returncode == 2 and not done.stdout
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"hoi: no command {word};") and nearest in line


@pytest.mark.parametrize("arguments", [["plan_only=true", "scene=punch_jelly"], [], ["--cfg", "job"], ["--help"]])
@pytest.mark.parametrize("name", ["run", "view", "import-scene"])
def test_a_command_is_its_module(name, arguments, monkeypatch):
    became = []
    monkeypatch.setattr(os, "execv", lambda *program: became.append(program))
    monkeypatch.setattr(sys, "argv", ["hoi", name, *arguments])
    main()
    assert became == [(sys.executable, [sys.executable, "-m", modules()[name], *arguments])]


def test_hoi_run_ends_as_the_module(tmp_path):
    ours, theirs = hoi("run", "scene=nothing", cwd=tmp_path), python("-m", "hoi.run", "scene=nothing", cwd=tmp_path)
    assert (ours.returncode, ours.stdout, ours.stderr) == (2, theirs.stdout, theirs.stderr)
    assert theirs.returncode == 2 and not theirs.stdout


def test_other_commands_keep_their_exit_codes(tmp_path):
    (tmp_path / "foreign.mcap").write_text("no record")
    done = hoi("export", "foreign.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "export: foreign.mcap is not an MCAP file\n"


@pytest.mark.parametrize("name", ["export", "ingest", "layouts", "video", "view"])
def test_a_wrong_option_is_one_line(name, capsys):
    command = import_module(modules()[name])
    if not hasattr(command, "main"):  # a package
        command = import_module(f"{modules()[name]}.__main__")
    with pytest.raises(SystemExit) as ended:
        command.main(["--nonsense"])
    (line,) = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2 and line.startswith(f"{name}: ") and line.endswith("--help tells what is allowed")


# --- help -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", sorted(modules().values()))
def test_help_says_what_it_does_with_an_example_and_imports_nothing_heavy(module, tmp_path):
    code = f"""
import runpy, sys
sys.argv = ["{module}", "--help"]
try: runpy.run_module("{module}", run_name="__main__", alter_sys=True)
except SystemExit as end: assert not end.code, end.code
else: raise AssertionError("it did not stop after the help")
print(sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr)
"""
    shown = python("-c", code, cwd=tmp_path, COLUMNS="200")
    assert shown.returncode == 0, shown.stderr
    assert shown.stderr == "[]\n"
    usage, _, rest = shown.stdout.partition("xample")
    assert f"python -m {module} " in rest, "no example"
    assert max(len(line.split()) for line in usage.splitlines()) > 3
    assert not list(tmp_path.iterdir())


def test_help_of_a_run_lists_its_groups(tmp_path):
    shown = python("-m", "hoi.run", "--help", cwd=tmp_path).stdout
    for group in ("scene", "object", "human", "material", "experiment", "ablation", "render"):
        (line,) = (line for line in shown.splitlines() if line.startswith(f"{group}: ") and "," in line)
        options = {file.stem for file in (ROOT / "conf" / group).glob("*.yaml")}
        assert set(line.partition(": ")[2].split(", ")) == options
    assert "seed: 0" in shown


# --- completion -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shell(tmp_path_factory):
    """A folder with the command `hoi`, and `completion`, which a shell evaluates."""
    folder = tmp_path_factory.mktemp("bin")
    command = folder / "hoi"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m hoi "$@"\n')
    command.chmod(0o755)
    (folder / "completion").write_text(hoi("run", "-sc", "install=bash", cwd=folder).stdout)
    return folder


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("hoi run scene=kick_", {"scene=kick_basketball", "scene=kick_soccer_ball"}),
        ("hoi run ablation=no_mpm seed=1 stage/con", {"stage/contact="}),
        ("hoi vi", {"view", "video"}),
        ("hoi view ru", set()),
    ],
)
def test_completion_in_bash(line, expected, shell, tmp_path):
    words = line.split()
    bash = f"""
eval "$(cat {shell}/completion)"
complete -p hoi > /dev/null || exit 1
COMP_LINE="{line}" COMP_POINT={len(line)} COMP_CWORD={len(words) - 1}
hydra_bash_completion
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    path = f"{shell}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "--norc", "-c", bash], capture_output=True, text=True, cwd=tmp_path, env=os.environ | {"PATH": path}
    )
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == expected


# --- a run's screen ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of a run, and what it has said."""
    folder = tmp_path_factory.mktemp("run")
    result = hoi("run", *QUICK, "out=here", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder, result


def test_the_last_lines_say_where_all_is_and_what_to_try_next(done):
    folder, result = done
    *_, recorded, filmed, following = result.stdout.splitlines()
    assert recorded == "recorded here/run.mcap" and (folder / "here" / "run.mcap").is_file()
    assert filmed == "filmed here/run.mp4" and (folder / "here" / "run.mp4").is_file()
    assert following.startswith("next: hoi view here/run.mcap")
    assert {word for word in ("view", "export", "strip", "video") if f"hoi {word}" in following} <= set(modules())
    assert sorted(path.name for path in folder.iterdir()) == ["here"]


def test_a_sweep_does_not_say_it(done):
    folder, _ = done
    sweep = hoi("run", "--multirun", *QUICK, "out=here", "seed=0", cwd=folder)
    assert sweep.returncode == 0, sweep.stderr
    assert "already computed" in sweep.stdout and "next:" not in sweep.stdout


def test_a_path_with_spaces_can_be_pasted():
    assert what_next([Path("my runs/run.mcap")]).startswith("next: hoi view 'my runs/run.mcap' ")


def test_no_library_warns_on_the_screen(done):
    folder, result = done
    commands = [["video", "here/run.mcap", "-o", "side.mp4", "--view", "side"], ["strip", "here/run.mcap"]]
    commands += [["table", "here", "-o", "tables"], ["report", "here", "-o", "page.html", "--jobs", "1"]]
    commands += [["layouts", "foxglove"]]
    # In one process, which imports the libraries once.
    code = """
import runpy, sys
for module, *arguments in eval(sys.argv[1]):
    sys.argv = [module, *arguments]
    try: runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end: assert not end.code, (module, end.code)
"""
    shown = python("-c", code, repr([[modules()[name], *rest] for name, *rest in commands]), cwd=folder)
    assert shown.returncode == 0, shown.stderr
    for text in (result.stderr, shown.stderr):
        assert "warn" not in text.lower() and "deprecat" not in text.lower(), text
    assert {"side.mp4", "tables", "page.html", "hoi.foxglove.json"} <= {path.name for path in folder.iterdir()}


# --- locks ------------------------------------------------------------------------------------------------------------


def test_an_interrupt_that_is_swallowed_leaves_no_lock(tmp_path):
    code = """
import os, signal, time
from pathlib import Path
from hoi.terminal import interrupt
from hoi.runner.execute import alone
interrupt.GRACE = 0.1
signal.signal(signal.SIGINT, signal.default_int_handler)
with interrupt.interruptible(), alone(Path("here")):
    assert Path("here/.lock").exists()
    try: os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt: time.sleep(20)
"""
    ended = python("-c", code, cwd=tmp_path)
    assert ended.returncode == 130, ended.stderr
    assert not list((tmp_path / "here").iterdir())


def test_the_lock_of_a_killed_process_goes_and_a_held_one_stays(composed, tmp_path):
    conf = composed(f"out={tmp_path}/here")
    folder = tmp_path / "here"
    let_go(conf)  # there is none
    folder.mkdir()
    (folder / LOCK).touch()
    let_go(conf)
    assert not list(folder.iterdir())
    with alone(folder):
        let_go(conf)
        assert (folder / LOCK).exists()
    with open(folder / LOCK, "w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        let_go(conf)
        assert (folder / LOCK).exists()
