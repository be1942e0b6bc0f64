"""The state of a shell: its interpreter, language, format and last result."""

from __future__ import annotations

from typing import Any

from ssduck.adapters.formats import FORMATS
from ssduck.interpreter.completion import Language, delimited_parts
from ssduck.interpreter.interpreter import Interpreter, ServedPage


class Session:
    """A shell's interpreter, its language and format, and its last result.

    Args:
        ss: the interpreter.

    Attributes:
        ss: the interpreter.
        language: the language of what is typed.
        format: the format of results, a text format of `FORMATS`.
        result: the last result; None before the first one.
        pages: the pages that are served until the session ends.
        is_over: whether the user has left.
    """

    def __init__(self, ss: Interpreter) -> None:
        self.ss = ss
        self.language: Language = "selectscript"
        self.format = FORMATS["table"]
        self.result: Any = None
        self.pages: list[ServedPage] = []
        self.is_over = False

    @property
    def prompt(self) -> str:
        """What stands before what is typed: the first world, and the language if it is SQL."""
        name = next((world.name for world in self.ss.worlds), "ssduck")
        return f"{name} sql> " if self.language == "sql" else f"{name}> "

    def close(self) -> None:
        """Ends what the session serves."""
        while self.pages:
            self.pages.pop().close()

    def is_complete(self, text: str) -> bool:
        """Checks whether a text can run: it is a command, empty, or ends with a semicolon."""
        if not text.strip() or is_command(text):
            return True
        return self._without_end(text).endswith(";")

    def _without_end(self, text: str) -> str:
        """Returns a text up to its last sign that is not in a comment; "" in an open text."""
        for part in reversed(list(delimited_parts(text, self.language))):
            is_text = part.opening in ("'", '"')
            if is_text and not part.is_closed:
                return ""
            if not is_text and not text[part.end :].strip():
                is_open = part.opening == "/*" and not part.is_closed
                text = "" if is_open else text[: part.start]
        return text.rstrip()


def is_command(text: str) -> bool:
    """Checks whether a text is a command of the shell: a full stop and a letter begin it."""
    stripped = text.lstrip()
    return stripped[:1] == "." and stripped[1:2].isalpha()
