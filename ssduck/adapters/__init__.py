"""What follows AS: forms that the rows of a query are turned into.

A form is an entry of the registry `ADAPTERS`; a family of them is a module of this folder.
"""

from __future__ import annotations

from ssduck.adapters.base import Adapter, Rows
from ssduck.adapters.values import VALUES

ADAPTERS: dict[str, Adapter] = {name: adapter for adapter in VALUES for name in adapter.names}

__all__ = ["ADAPTERS", "Adapter", "Rows"]
