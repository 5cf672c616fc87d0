"""The front door.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1
    python -m hoi.run --config-dir sweeps --config-name ablations

From Python, `hoi.run(hoi.compose("scene=kick_soccer_ball"))` (see `hoi.api`).
"""

from hoi.callable import called

called(__name__)


def main() -> None:
    """The command line; see `hoi.runner.main`."""
    from hoi.runner.main import main

    main()


if __name__ == "__main__":
    main()
