"""Shows how many episodes have answered, or were read for a manifest."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TypeVar

T = TypeVar("T")

# How long a manifest is made before its progress is shown, s.
PATIENCE = 1.0


def counted(entries: Iterable[T]) -> Iterator[T]:
    """Yields the episodes of a manifest; a terminal shows their number if it takes long."""
    started = time.monotonic()
    advance: Callable[[int], None] | None = None
    with ExitStack() as bar:
        for number, entry in enumerate(entries, 1):
            if advance is not None:
                advance(1)
            elif time.monotonic() - started >= PATIENCE:
                advance = bar.enter_context(shown_progress(None, shown=True))
                advance(number)
            yield entry


@contextmanager
def shown_progress(total: int | None, *, shown: bool) -> Iterator[Callable[[int], None]]:
    """Yields a function to call with the number of further episodes that are done.

    Args:
        total: the number of episodes; None if it is unknown.
        shown: whether to show a bar on standard error, if that is a terminal.
    """
    if not (shown and sys.stderr.isatty()):
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("episodes"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("episodes", total=total)
        yield lambda count: bar.advance(task, count)
