"""Reads what a user types at a terminal, with completion, colours and a history."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from prompt_toolkit import PromptSession
from prompt_toolkit.completion import Completer
from prompt_toolkit.completion import Completion as Choice
from prompt_toolkit.filters import completion_is_selected
from prompt_toolkit.history import FileHistory, History, InMemoryHistory
from prompt_toolkit.key_binding import KeyBindings
from prompt_toolkit.lexers import DynamicLexer, PygmentsLexer
from pygments.lexer import RegexLexer, words
from pygments.lexers.sql import SqlLexer
from pygments.token import Comment, Keyword, Name, Number, String, Text

from ssduck.interpreter.completion import KEYWORDS, complete
from ssduck.shell.session import COMMANDS, Session, is_command, run


class SelectScriptLexer(RegexLexer):
    """Colours the words, texts, numbers and comments of SelectScript."""

    name = "SelectScript"
    flags = 0
    _words = sorted({part for word in KEYWORDS["selectscript"] for part in word.split()})
    tokens = {  # noqa: RUF012  # as pygments has it
        "root": [
            (r"(//|#|--\s)[^\n]*|/\*[\s\S]*?\*/", Comment),
            (r"'(?:[^'\\]|\\.|'')*'|\"(?:[^\"\\]|\\.|\"\")*\"", String),
            (r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?", Number),
            (words((*_words, *map(str.lower, _words)), prefix=r"\b", suffix=r"\b"), Keyword),
            (r"\w+(?=\s*\()", Name.Function),
            (r"\w+|\s+|.", Text),
        ]
    }


class NameCompleter(Completer):
    """Completes names at the cursor."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def get_completions(self, document: Any, _event: Any) -> Iterator[Any]:
        """Yields what may stand at the cursor."""
        text, cursor = document.text, document.cursor_position
        if is_command(text) or text.strip() == ".":
            typed = text[:cursor].lstrip()[1:]
            for name, known in COMMANDS.items():
                if name.startswith(typed):
                    yield Choice(name, -len(typed), display_meta=known.about)
            return
        for each in complete(self._session.ss, text, cursor, self._session.language):
            about = " ".join(filter(None, (each.usage, each.about)))
            yield Choice(each.text, each.start - cursor, display_meta=about or each.kind)


def history_path() -> Path:
    """Returns the file of the history, in the folder of the user's state (XDG_STATE_HOME)."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "ssduck" / "history"


def _history(*, is_kept: bool) -> History:
    if not is_kept:
        return InMemoryHistory()
    path = history_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.touch(mode=0o600)
    except OSError as error:
        sys.stderr.write(
            f"warning: {path} cannot be written, so the history is not kept: {error}\n"
        )
        return InMemoryHistory()
    return FileHistory(str(path))


def prompt_session(session: Session, *, with_history: bool, **others: Any) -> PromptSession[str]:
    """Returns the prompt of a session; further arguments are those of prompt_toolkit's."""
    keys = KeyBindings()

    @keys.add("enter", filter=~completion_is_selected)
    def _(event: Any) -> None:
        buffer = event.current_buffer
        if session.is_complete(buffer.text):
            buffer.validate_and_handle()
        else:
            buffer.newline()

    lexers = {"selectscript": PygmentsLexer(SelectScriptLexer), "sql": PygmentsLexer(SqlLexer)}
    return PromptSession(
        message=lambda: session.prompt,
        multiline=True,
        prompt_continuation=lambda width, *_: "... ".rjust(width),
        completer=NameCompleter(session),
        lexer=DynamicLexer(lambda: lexers[session.language]),
        history=_history(is_kept=with_history),
        key_bindings=keys,
        **others,
    )


def run_terminal(session: Session, prompt: PromptSession[str]) -> None:
    """Runs what a user types until Ctrl-D or `.quit`; Ctrl-C stops a query, or empties the line."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    while not session.is_over:
        try:
            text = prompt.prompt()
        except KeyboardInterrupt:
            continue
        except EOFError:
            return
        run(session, text)
