"""The wheel: what is in it, and that it works in an environment of its own, far from the checkout."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest

from hoi import __version__
from tests.conftest import ROOT

SMOKE = ["experiment=smoke", "render=video", "render.width=96", "render.height=64"]


def ran(*command: str | Path, cwd: Path) -> str:
    """What a command prints, with nothing of this checkout on its path."""
    environment = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    ran(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT, cwd=folder)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The commands of an environment with the wheel and the packages that the running one has, but not its checkout."""
    folder = tmp_path_factory.mktemp("away") / "venv"
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    ran(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    # Named in a .pth the other folder is searched, after the own one; its own .pth, with the checkout, are not read.
    packages = ran(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    (Path(packages) / "shared.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin"


def test_it_has_all_that_runs_need_and_nothing_else_on_top(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        metadata = message_from_bytes(archive.read(f"hoi-{__version__}.dist-info/METADATA"))
    assert {name.partition("/")[0] for name in names} == {"hoi", "hydra_plugins", f"hoi-{__version__}.dist-info"}
    known = [
        "git",
        "ls-files",
        "--cached",
        "--others",
        "--exclude-standard",
        "hoi",
        "analysis",
        "conf",
        "hydra_plugins",
    ]
    listed = subprocess.run(known, cwd=ROOT, capture_output=True, text=True)
    files = {name if name.startswith(("hoi", "hydra")) else f"hoi/{name}" for name in listed.stdout.split()}
    assert files and not files - names  # the code, conf, weights, people, templates of pages, py.typed
    assert names - files == {name for name in names if ".dist-info/" in name}
    assert metadata["License-Expression"] == "Apache-2.0"
    licences = metadata.get_all("License-File", [])
    assert {"LICENSE", "hoi/body/NOTICE.md"} <= set(licences) and sum("weights" in name for name in licences) == 2
    assert {f"hoi-{__version__}.dist-info/licenses/{name}" for name in licences} <= names


def test_it_runs_away_from_the_checkout(installed, tmp_path):
    where, *paths = ran(
        installed / "python", "-c", "import hoi.analysis, sys; print(hoi.__file__, *sys.path)", cwd=tmp_path
    ).split()
    assert Path(where).is_relative_to(installed.parent)
    assert not [path for path in paths if (Path(path) / "pyproject.toml").is_file()]
    said = ran(installed / "hoi", "run", *SMOKE, "out=runs/s0", cwd=tmp_path)
    assert "recorded runs/s0/run.mcap" in said and (tmp_path / "runs" / "s0" / "run.mp4").is_file()
    assert "\n1 records (1 done, 0 failed, 0 unreadable)" in ran(installed / "hoi", "table", cwd=tmp_path)
    assert ran(installed / "hoi", "table", "--help", cwd=tmp_path).startswith("usage: python -m hoi.analysis.table")
    assert ran(installed / "hoi", "report", cwd=tmp_path).startswith("1 records in runs/report.html")
