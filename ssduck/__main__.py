"""Runs the command `ssduck` for `python -m ssduck`."""

from ssduck.cli.app import main

main()
