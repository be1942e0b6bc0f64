"""Asks many recorded episodes one question, on one machine, on Ray or on Spark.

`Lake` lists the episodes of all records below a path in a `manifest`, which `scan` makes. A
question (`questions`) goes to batches of episodes, on one of the `engines`; each of their processes
answers batches (`workers`).
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.lakes.lake import Lake

__all__ = ["Lake"]

__getattr__, __dir__ = exports(__name__, {"lake": ("Lake",)})
