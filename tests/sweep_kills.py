"""A sweep that is killed again and again: `python -m tests.sweep_kills --kills 20`."""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd

from analysis.table import collect
from hoi.record import message_digest, read

RUN = [
    "experiment=smoke", "stage/motion=none", "stage/attraction=none", "scene.frames=8", "scene.contact_frame=4",
    "human.gaussians=1000", "human_points=100", "object.max_gaussians=300",
]  # fmt: skip
"""As little as a run can be: a person who stands still."""

VIDEO = ["render=video", "render.width=32", "render.height=32"]
TAKEN = ("seconds", "memory", "frames_per_second", "path")
"""What a column is called that says what a run took, or where it is."""


def joblib(workers: int) -> list[str]:
    return ["hydra/launcher=joblib", f"hydra.launcher.n_jobs={workers}"]


def command(*overrides: str, workers: int = 2) -> list[str]:
    """A sweep on so many workers, or by Hydra's basic launcher."""
    launcher = joblib(workers) if workers else []
    return [sys.executable, "-m", "hoi.run", "--multirun", *launcher, *RUN, *overrides]


def records(folder: Path) -> dict[str, str]:
    """The digest of each record below; every one of them can be read, and has its video if it was filmed."""
    found = {}
    for path in sorted(folder.rglob("run.mcap")):
        run = read(path)
        assert run.result["status"] == "done"
        assert path.with_suffix(".mp4").exists() == any(step.name == "render" for step in run.plan.steps), path
        found[str(path.relative_to(folder))] = message_digest(path)
    return found


def table(folder: Path) -> pd.DataFrame:
    """All that the table says of the runs below but what they took."""
    rows = collect(folder)
    return rows.drop(columns=[name for name in rows.columns if any(word in name for word in TAKEN)])


def at_work(folder: Path) -> list[int]:
    """The processes that sweep or run in `folder`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if (entry / "cwd").resolve() == folder and "hoi." in (entry / "cmdline").read_text():
                found.append(int(entry.name))
        except OSError:
            continue  # it has ended, or is another's
    return found


def start(folder: Path, *overrides: str, workers: int = 2) -> subprocess.Popen[bytes]:
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "sweep.log", "ab") as log:
        return subprocess.Popen(
            command(*overrides, workers=workers),
            cwd=folder,
            stdout=log,
            stderr=log,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job inherits it as ignored
        )


def moment(sweep: subprocess.Popen[bytes], folder: Path, chance: random.Random, run: float) -> bool:
    """Waits for a random moment of a sweep whose runs take `run` [s]; whether it came before the sweep's end."""
    if chance.random() < 0.8:  # else it is hardly there
        while sweep.poll() is None and not list(folder.rglob(".lock")):
            time.sleep(0.1)
    try:
        sweep.wait(timeout=chance.uniform(0, run))
    except subprocess.TimeoutExpired:
        return True
    return False


def kill_and_resume(
    reference: Path, folder: Path, overrides: list[str], kills: int, run: float, seed: int
) -> list[int]:
    """Kill -9 a sweep `kills` times, at random moments, on one core or two; then let it end, and compare.

    A sweep that ends before it is killed begins anew.

    Args:
        run: how long a run takes [s].

    Returns:
        how many runs of it were finished at each kill.
    """
    chance, undisturbed, done = random.Random(seed), records(reference), []
    while len(done) < kills:
        sweep = start(folder, *overrides, workers=chance.choice([0, 2]))
        if moment(sweep, folder, chance, run):
            os.kill(sweep.pid, signal.SIGKILL)
            sweep.wait()
        else:
            assert sweep.returncode == 0, (folder / "sweep.log").read_text()
            assert records(folder) == undisturbed
            shutil.rmtree(folder)
            continue
        deadline = time.monotonic() + 60
        while at_work(folder):
            assert time.monotonic() < deadline, f"still at work: {at_work(folder)}"
            time.sleep(0.2)
        found = records(folder)
        assert found.items() <= undisturbed.items()
        assert not list(folder.rglob("run.failed.mcap"))
        done.append(len(found))
        print(f"kill {len(done)}: {len(found)} of {len(undisturbed)} finished", flush=True)
    assert start(folder, *overrides).wait() == 0, (folder / "sweep.log").read_text()
    assert records(folder) == undisturbed
    left = {path.name for path in folder.rglob("*") if path.is_file()}
    assert left <= {"run.mcap", "run.mp4", "sweep.log"}, left
    pd.testing.assert_frame_equal(table(folder), table(reference))
    return done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    overrides = ["ablation=no_mpm,no_contact", "seed=0,1", *VIDEO]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary).resolve()
        started = time.monotonic()
        assert start(folder / "undisturbed", *overrides).wait() == 0
        run = (time.monotonic() - started) / len(records(folder))
        print(f"undisturbed: {run:.0f} s a run", flush=True)
        done = kill_and_resume(
            folder / "undisturbed", folder / "killed", overrides, arguments.kills, run, arguments.seed
        )
    print(f"{len(done)} kills, with {done} runs finished; in the end the same records and the same table")


if __name__ == "__main__":
    main()
