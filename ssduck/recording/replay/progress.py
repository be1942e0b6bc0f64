"""Shows the progress of long programs and questions: on terminals, and in notebooks."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any, TypeAlias

from ssduck.limits import UsageMeter

# A program shows its progress if it takes longer, s.
DELAY = 1.0
# The time between two updates of what is shown, s.
INTERVAL = 0.1


class TerminalDisplay:
    """A bar on a terminal, by its rich console; it disappears at the end."""

    def __init__(self, console: Any) -> None:
        from rich import progress as rich

        text, remaining = rich.TextColumn("{task.description}"), rich.TimeRemainingColumn()
        columns = text, rich.BarColumn(), rich.MofNCompleteColumn(), remaining
        self._bar = rich.Progress(*columns, console=console, transient=True, auto_refresh=False)
        self._task = self._bar.add_task("", total=None)

    def show(self, description: str, done: int, total: int | None) -> None:
        """Shows the bar."""
        self._bar.update(self._task, description=description, completed=done, total=total)
        self._bar.start()
        self._bar.refresh()

    def close(self) -> None:
        """Removes the bar."""
        self._bar.stop()


class NotebookDisplay:
    """A line of text below a notebook's cell."""

    def __init__(self) -> None:
        from IPython.display import display

        self._handle: Any = display({"text/plain": ""}, raw=True, display_id=True)

    def show(self, description: str, done: int, total: int | None) -> None:
        """Replaces the line."""
        text = f"{description}: {done:,}"
        if total is not None:
            text += f" of {total:,} ({done / max(total, 1):.0%})"
        self._handle.update({"text/plain": text}, raw=True)

    def close(self) -> None:
        """Empties the line."""
        self._handle.update({"text/plain": ""}, raw=True)


# Shows how much of a task is done.
Display: TypeAlias = TerminalDisplay | NotebookDisplay


def find_display() -> Display | None:
    """Returns the display of a terminal or a notebook; None where there is neither.

    Progress is shown on standard error, if that is a terminal.
    """
    if "IPython" in sys.modules and _is_notebook():
        return NotebookDisplay()
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(stderr=True)
    return TerminalDisplay(console) if console.is_terminal else None


def _is_notebook() -> bool:
    from IPython.core.getipython import get_ipython

    shell = get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


@contextmanager
def task(meter: UsageMeter, description: str, total: int) -> Iterator[Callable[[int], None]]:
    """Begins a task of a program, whose progress is shown if the program takes long."""
    progress = Progress(description, total, meter.start, is_shown=meter.limits.progress)

    def advance(count: int) -> None:
        meter.check_time()
        progress.advance(count)

    with closing(progress):
        yield advance


class Progress:
    """Shows how much of a task is done, if it takes long; `close` removes what is shown.

    Only the main thread shows anything, so that displays do not mix.
    """

    def __init__(
        self, description: str, total: int | None, since: float, *, is_shown: bool = True
    ) -> None:
        self._description, self._total, self._done = description, total, 0
        self._next_update = since + DELAY
        self._is_shown = is_shown and threading.current_thread() is threading.main_thread()
        self._display: Display | None = None

    def advance(self, count: int) -> None:
        """Adds the number of parts that were done since the last call."""
        self._done += count
        now = time.monotonic()
        if not self._is_shown or now < self._next_update:
            return
        if self._display is None:
            self._display = find_display()
            self._is_shown = self._display is not None
        if self._display is not None:
            self._display.show(self._description, self._done, self._total)
        self._next_update = now + INTERVAL

    def close(self) -> None:
        """Removes what is shown."""
        if self._display is not None:
            self._display.close()
