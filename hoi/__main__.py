"""`python -m hoi` is the command `hoi`."""

from hoi.runner.cli import main

main()
