"""Texts for agents: what comes from a world cannot be taken for a part of the guide."""

from __future__ import annotations

import json
from typing import Any

from ssduck.adapters.display import as_json
from ssduck.errors import printable

# The largest length of a name in the guide, letters.
MAX_NAME = 200


def as_text(value: Any) -> str:
    r"""Returns a value as JSON on one line, in printable characters.

    Infinities and NaN are texts, because JSON has no such numbers and null stands for unknown.

    >>> as_text({"name": "cup\u202e\n", "distance": float("inf")})
    '{"name": "cup\\u202e\\n", "distance": "Infinity"}'
    """
    return printable(json.dumps(as_json(value, words=True), ensure_ascii=False))


def name_text(name: str) -> str:
    """Returns a name as JSON; … follows one that is cut."""
    return as_text(name) if len(name) <= MAX_NAME else f"{as_text(name[:MAX_NAME])}…"
