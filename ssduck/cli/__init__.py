"""The command `ssduck`: `app` has its subcommands, `records` those about records."""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.cli.app import app, main

__all__ = ["app", "main"]

__getattr__, __dir__ = exports(__name__, {"app": ("app", "main")})
