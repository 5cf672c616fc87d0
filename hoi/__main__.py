"""`python -m hoi` is the command `hoi`."""

from hoi.cli import main

main()
