"""Texts for agents: what comes from a world cannot be taken for a part of the guide."""

from __future__ import annotations

import json
from typing import Any

from ssduck.adapters.display import as_json

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


def printable(text: str, kept: str = "") -> str:
    """Escapes control characters, and those that turn the direction of what follows.

    Args:
        text: the text.
        kept: characters that stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in kept else _escaped(one) for one in text)


def _escaped(character: str) -> str:
    """Returns a character as JSON writes it: one beyond 16 bits as two."""
    units = character.encode("utf-16-be", errors="surrogatepass")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))
