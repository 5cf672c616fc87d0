"""The machines, shells and folders that people have: no traceback, no abort, exit codes as documented, nothing half.

A line of `ENVIRONMENTS` is a command in an environment. Another user, as whom folders can be read-only, takes root and
setpriv; without those these lines are skipped.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from demo_run import make_run

from hoi import record
from hoi.caches import caches, user_caches

PLAN = ("run", "plan_only=true")
COMPILE = (
    "-c",
    "from hoi import compute; compute.start_compiler('float32', 1, 'cpu')\nfrom hoi.run import main; main()",
)
"""The compiler, which wants a cache, then a plan."""
SAMPLE = ("sample", "a person kicks", "--frames", "4", "-o", "m.npz")
SMOKE = (
    "run", "experiment=smoke", "ablation=no_mpm", "stage/motion=none", "stage.coordinate.iterations=1", "out=out",
    "human_points=500",
)  # fmt: skip
SOMEBODY = (
    "exec setpriv --reuid=65534 --regid=65534 --clear-groups --inh-caps=-all,+dac_read_search"
    ' --ambient-caps=-all,+dac_read_search "$@"'
)
"""Who may read all, as whoever uses what another has installed, and write what everybody may."""
FULL = 'ulimit -f 8; exec "$@"'
"""No file may have more than 8 kB: what a write meets on a full disk."""


@dataclass(frozen=True)
class Case:
    name: str
    command: tuple[str, ...] = PLAN
    shell: str = 'exec "$@"'
    """What bash does with the command."""
    code: int = 0
    says: str = ""
    """Somewhere in what is said."""
    leaves: tuple[str, ...] = ()
    """Files and folders there afterwards."""
    folder: str = "here"
    variables: dict[str, str | None] = field(default_factory=dict)
    """None takes one away; {folder} is the test's."""


def variables(name: str, command: tuple[str, ...] = PLAN, **changes: str | None) -> Case:
    return Case(name, command, variables=changes)


ENVIRONMENTS = [
    # where things are kept
    variables("no HOME", COMPILE, HOME=None), variables("a HOME that is a file", COMPILE, HOME="{folder}/file"),
    variables("a HOME in /proc", COMPILE, HOME="/proc/nope"), variables("a relative HOME", COMPILE, HOME="there"),
    variables("a HOME with spaces and accents", HOME="{folder}/ä ö"), variables("an empty HOME", HOME=""),
    variables("a cache in /proc", COMPILE, XDG_CACHE_HOME="/proc/x"), variables("a relative cache", XDG_CACHE_HOME="x"),
    variables("no TMPDIR", TMPDIR="/nowhere"),
    Case("nothing at all", COMPILE, 'exec env -i PYTHONPATH="$PYTHONPATH" "$@"'),
    Case("another user without a home", COMPILE, SOMEBODY, variables={"HOME": "/nonexistent"}),
    Case("another user, read-only HOME", COMPILE, SOMEBODY, variables={"HOME": "{folder}"}),
    # languages
    variables("C", LC_ALL="C"),
    variables("POSIX without UTF-8", LC_ALL="POSIX", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0"),
    variables("German", LC_ALL="de_DE.UTF-8"), variables("Turkish", LC_ALL="tr_TR.UTF-8"),
    variables("a locale that is not there", LC_ALL="xx_XX"), variables("an empty locale", LC_ALL="", LANG=""),
    variables("a console in Latin 1", PYTHONIOENCODING="latin-1"),
    variables("a console in ASCII", PYTHONIOENCODING="ascii"),
    # paths
    variables("an odd PATH", PATH="/nowhere"), variables("an empty PATH", PATH=""), variables("no PATH", PATH=None),
    Case("a folder with spaces", folder="a b c"), Case("a folder in Chinese", folder="踢 球"),
    Case("a folder of grammar", folder="ä (b), c=[d] {e} 'f' $g"), Case("a folder of two lines", folder="a\nb"),
    Case("a long path", folder="/".join(["x" * 200] * 5)),
    Case("a folder that is gone", PLAN, 'mkdir gone; cd gone; rmdir ../gone; exec "$@"', 2, "the folder that this was"),
    Case("a link to the folder", shell='ln -s . link; cd link; "$@"; code=$?; rm ../here/link; exit $code'),
    # terminals
    variables("a dumb terminal", TERM="dumb"), variables("no terminal type", TERM=None),
    variables("ten columns", COLUMNS="10"), variables("no columns", COLUMNS="0"), variables("no colours", NO_COLOR="1"),
    Case("a terminal", shell='script -qec "$(printf "%q " "$@")" /dev/null', says="variant full"),
    # streams
    Case("a reader who leaves", shell='"$@" | head -1; exit ${PIPESTATUS[0]}'),
    Case("a reader who reads nothing", shell='"$@" | true; exit ${PIPESTATUS[0]}'),
    Case("no stdin", shell='exec "$@" <&-'), Case("no stdout", shell='exec "$@" >&-'),
    Case("no stderr", shell='exec "$@" 2>&-'), Case("no streams", shell='exec "$@" <&- >&- 2>&-'),
    Case("a full stdout", shell='exec "$@" >/dev/full', code=3, says="stdout cannot be written to"),
    Case("help to a full disk", ("--help",), 'exec "$@" >/dev/full', 3, "stdout cannot be written to"),
    Case("a wrong key to a full stderr", ("run", "nothing=1"), 'exec "$@" 2>/dev/full', 2),
    # Python
    Case("python -O", shell='python=$1; shift; exec "$python" -O "$@"'),
    Case("python -OO", shell='python=$1; shift; exec "$python" -OO "$@"'),
    Case("python -OO, help", ("sample", "--help"), 'python=$1; shift; exec "$python" -OO "$@"', says="Draw a motion"),
    variables("no bytecode", PYTHONDONTWRITEBYTECODE="1"), variables("a safe path", PYTHONSAFEPATH="1"),
    variables("unbuffered", PYTHONUNBUFFERED="1"), variables("a hash seed", PYTHONHASHSEED="7"),
    # limits and users
    Case("a strict umask", shell='umask 077; exec "$@"'), Case("few open files", shell='ulimit -n 64; exec "$@"'),
    Case("no new files", shell='ulimit -f 0; exec "$@"'), Case("another user", shell=SOMEBODY),
    Case("a read-only folder", SMOKE, SOMEBODY, 2, "out: cannot write to out", variables={"HOME": "/nonexistent"}),
    # work
    Case("a sample, strictly", SAMPLE, 'umask 077; exec "$@"', leaves=("m.npz",)),
    Case(
        "a sample in a read-only folder", SAMPLE, SOMEBODY, 2, "cannot write m.npz", variables={"HOME": "/nonexistent"}
    ),
    Case("a sample on a full disk", (*SAMPLE[:-1], "m.mcap"), FULL, 3, "cannot write m.mcap"),
    Case("a run on a full disk", SMOKE, FULL, 3, "File too large", ("out",)),
    Case("a picture on a full disk", ("strip", "{folder}/run.mcap", "--frames", "2"), FULL, 3, "File too large"),
    Case("an export on a full disk", ("export", "{folder}/run.mcap", "--glb", "-o", "x"), FULL, 3, "too large", ("x",)),
    Case("a video on a full disk", ("video", "{folder}/run.mcap", "-o", "v.mp4"), FULL, 3, "File too large"),
]  # fmt: skip


def test_there_are_enough():
    assert len({case.name for case in ENVIRONMENTS}) == len(ENVIRONMENTS) >= 40


@pytest.fixture(scope="module")
def shared(tmp_path_factory) -> Path:
    """A folder with a record, and a file where a folder is expected."""
    folder = tmp_path_factory.mktemp("shared")
    made, *points = make_run(frames=4, points=300, gaussians=100, particles=120, contact_frame=2.0)
    record.write(made, folder / "run.mcap", *points, plan_text="")
    (folder / "file").write_text("")
    return folder


@pytest.mark.parametrize("case", ENVIRONMENTS, ids=lambda case: case.name)
def test_it_runs_or_says_why(case, shared, tmp_path):
    if case.shell == SOMEBODY and (os.getuid() != 0 or shutil.which("setpriv") is None):
        pytest.skip("to be another user takes root and setpriv")
    folder = tmp_path / "here" / case.folder if case.folder != "here" else tmp_path / "here"
    folder.mkdir(parents=True)
    environment = dict(os.environ)
    environment.setdefault("PYTHONPATH", str(Path(__file__).parents[2]))
    for key, value in case.variables.items():
        environment.pop(key, None)
        if value is not None:
            environment[key] = value.format(folder=shared)
    words = [word.replace("{folder}", str(shared)) for word in case.command]
    command = [sys.executable, *(words if words[0] == "-c" else ["-m", "hoi", *words])]
    command += ["plan_only=true"] * (case.command is COMPILE)
    shell = [shutil.which("bash") or "/bin/bash", "-c", case.shell, "bash", *command]
    done = subprocess.run(shell, cwd=folder, env=environment, capture_output=True, stdin=subprocess.DEVNULL)
    said = (done.stdout + done.stderr).decode(errors="replace")
    assert done.returncode == case.code, said
    assert case.says in said and not re.search("Traceback|core dumped|terminate called|Fatal Python", said), said
    assert sorted(path.name for path in folder.iterdir()) == sorted(case.leaves)
    assert not [path for path in folder.rglob("*") if path.suffix in (".part", ".mp4") or path.name == "run.mcap"]


def test_ctrl_c_in_a_sample_leaves_nothing(tmp_path):
    command = [sys.executable, "-m", "hoi", "sample", "a person kicks the ball", "--frames", "4000", "-o", "m.npz"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=tmp_path, text=True, **pipes) as sample:
        assert sample.stdout is not None and sample.stderr is not None
        assert sample.stdout.readline().startswith("sentence:")  # all is imported
        time.sleep(1.0)
        sample.send_signal(signal.SIGINT)
        said = sample.stderr.read()
    assert sample.returncode == 130 and "Traceback" not in said and "interrupted" in said
    assert not list(tmp_path.iterdir())


def test_two_runs_at_once_in_one_folder_are_one(tmp_path):
    """The second waits for the first and finds its record."""
    command = [sys.executable, "-m", "hoi", *SMOKE]
    both = [
        subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for _ in range(2)
    ]
    said = [each.communicate()[0] for each in both]
    assert [each.returncode for each in both] == [0, 0], said
    assert sum("already computed" in each for each in said) == 1 and not any("Traceback" in each for each in said)
    assert record.read(tmp_path / "out" / "run.mcap").result["status"] == "done"


def test_caches_are_where_they_can_be_written_to(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    assert user_caches() == tmp_path / "new"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "below"))
    assert user_caches() is None
    caches.cache_clear()
    folder = caches()
    assert folder is not None and folder.is_dir()
    caches.cache_clear()
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("nobody knows")))
    assert user_caches() is None
