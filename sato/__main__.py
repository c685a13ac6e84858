"""Command line as `python -m sato`."""

from sato.cli import main

main()
