"""`python -m ssduck`: the command `ssduck`."""

from ssduck.cli.app import main

main()
