"""`python -m ssduck`: the command `ssduck`."""

from ssduck.cli import main

main()
