"""Answers what a page asks: queries, completions, and facts about an entity.

All methods run in the one thread of a page's queries.
"""

from __future__ import annotations

import base64
import io
import time
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from ssduck import validation
from ssduck.adapters.display import DisplayTable, as_json, display_table
from ssduck.adapters.formats import FORMATS, png_of
from ssduck.adapters.marks import Mark, Marks
from ssduck.errors import (
    ArgumentError,
    LimitError,
    SelectScriptError,
    UnknownNameError,
    nearest,
)
from ssduck.interpreter.completion import KEYWORDS, complete
from ssduck.interpreter.stopping import StopRequest
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.view.asking import has_intervals, heads_of, lanes_of, not_shown, value_of
from ssduck.view.drawings import drawing_of
from ssduck.view.facts import facts_of, plot_of
from ssduck.view.scans import Scan
from ssduck.view.shown_values import shown_rows
from ssduck.view.sources import Asked, Source
from ssduck.world.world import World

# The rows that a page gets at most; downloads have all.
MAX_ROWS = 1000
MAX_COMPLETIONS = 60
# The longest text that is completed, letters: no limit of time ends that.
MAX_COMPLETED = 50_000
MAX_LINES = 100
# The formats of downloads.
_DOWNLOADS = ("csv", "json", "parquet")


class Answers:
    """Answers the questions of one page.

    Args:
        source: what is shown.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._result: Any = None
        # Ends the programs of the question that is being answered.
        self._stop = StopRequest()
        # A program with intervals, its language and the last tick, and its bars there.
        self._bars: tuple[Any, list[Any]] = None, []

    def answer(self, question: dict[str, Any], stop: StopRequest) -> dict[str, Any]:
        """Returns the answer to a question; an error has its place and suggestions.

        Args:
            question: what the page sent.
            stop: ends the programs of the question.
        """
        self._stop = stop
        kinds = {
            "ask": self._ask,
            "complete": self._complete,
            "pick": self._pick,
            "plot": self._plot,
            "download": self._download,
        }
        try:
            kind = question.get("type")
            if not isinstance(kind, str) or kind not in kinds:
                raise ArgumentError(f"a page cannot ask {str(kind)[:40]!r}")
            if stop.is_made:
                raise LimitError("the page asked something else before this began")
            return kinds[kind](question)
        except SelectScriptError as error:
            return {"error": error_message(error)}

    # -- queries ------------------------------------------------------------------------------

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        text, language = text_of(question, "text"), language_of(question)
        started = time.perf_counter()
        bars = self._bars_of(text, language, _time(question))
        asked = self._source.mirror(_time(question))
        world = asked.world
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            value = self._value_of(asked, text, language)
            picture, drawing = _picture(value), drawing_of(value)
            table = DisplayTable([], []) if picture else display_table(value)
            everything = list(map(Marks(world).of, table.rows))
        self._result = value
        rows = shown_rows(table.rows[:MAX_ROWS])
        return {
            "columns": heads_of(asked.interpreter, text, language, value, table.columns),
            "rows": rows,
            "marks": everything[: len(rows)],
            "all": sorted({mark for each in everything for mark in each}),
            "lines": list(_lines(world, everything)),
            "boxes": list(_boxes(world, everything)),
            "count": len(table.rows),
            "picture": picture,
            "drawing": drawing,
            "lanes": bars,
            "warnings": [
                *not_shown(asked.interpreter, text, language),
                *(str(each.message) for each in caught),
            ],
            "time": world.time,
            "ms": (time.perf_counter() - started) * 1e3,
        }

    def _value_of(self, asked: Asked, text: str, language: Any) -> Any:
        with self._stop.applies_to(asked.interpreter):
            return value_of(asked.interpreter, text, language)

    def _bars_of(self, text: str, language: Any, at: float | None) -> list[Any]:
        """Returns the intervals of a program over all recorded ticks, for the time line."""
        asked = self._source.mirror(at)
        if not has_intervals(asked.interpreter, text, language):
            return []
        ticks = self._source.ticks()
        if ticks is None or not len(ticks.times):
            return []
        key = text, language, int(ticks.numbers[-1])
        if self._bars[0] != key:
            asked = self._source.mirror(None if at is None else float(ticks.times[-1]))
            value = self._value_of(asked, text, language)
            table = display_table(value, MAX_ROWS)
            self._bars = key, [list(lane) for lane in lanes_of(value, table.columns, table.rows)]
        return self._bars[1]

    def scan(self, question: dict[str, Any], stop: StopRequest) -> Scan:
        """Returns a search for the changes of an answer; only the thread of scans calls this.

        Args:
            question: what the page sent.
            stop: ends the programs of the search.

        Raises:
            SelectScriptError: nothing is recorded, or the question is wrong.
        """
        asked = self._source.recorded()
        world = asked.world
        assert isinstance(world, ReplayedWorld)
        text, language = text_of(question, "text"), language_of(question)
        return Scan(asked.interpreter, world, text, language, stop)

    def _complete(self, question: dict[str, Any]) -> dict[str, Any]:
        text, language = text_of(question, "text"), language_of(question)
        cursor = validation.integer(question.get("cursor"), "complete: cursor", minimum=0)
        if len(text) > MAX_COMPLETED:
            return {"completions": []}
        found = complete(self._source.mirror(_time(question)).interpreter, text, cursor, language)
        return {
            "completions": [
                [each.text, each.start, each.kind, each.usage, each.about]
                for each in found[:MAX_COMPLETIONS]
            ]
        }

    def _download(self, question: dict[str, Any]) -> dict[str, Any]:
        name = question.get("format")
        if name not in _DOWNLOADS:
            raise UnknownNameError(
                f"there is no download {name!r}", suggestions=nearest(name, _DOWNLOADS)
            )
        format = FORMATS[name]
        if format.is_binary:
            stream = io.BytesIO()
            format.write(self._result, stream)
            content = stream.getvalue()
        else:
            text = io.StringIO()
            format.write(self._result, text)
            content = text.getvalue().encode()
        return {"content": base64.b64encode(content).decode(), "name": f"result.{name}"}

    # -- an entity ----------------------------------------------------------------------------

    def _pick(self, question: dict[str, Any]) -> dict[str, Any]:
        id = validation.integer(question.get("entity"), "pick: entity", minimum=0)
        asked = self._source.mirror(_time(question))
        with self._stop.applies_to(asked.interpreter):
            facts: dict[str, Any] = as_json(facts_of(asked.interpreter, asked.world, id))
        return facts

    def _plot(self, question: dict[str, Any]) -> dict[str, Any]:
        id = validation.integer(question.get("entity"), "plot: entity", minimum=0)
        joint = question.get("joint")
        name = None if joint is None else validation.text(joint, "plot: joint is a text")
        column = validation.text(question.get("column", ""), "plot: column is a text")
        ss = self._source.mirror(None).interpreter
        with self._stop.applies_to(ss):
            return plot_of(ss, id, column, name)


def _lines(world: World, rows: Sequence[list[Mark]]) -> Iterator[list[list[float]]]:
    """Yields the nearest points of the two entities of each row that has two."""
    bodies = {info.id for info in world.snapshot.entities if info.body is not None}
    pairs = [
        (row[0][0], row[1][0])
        for row in rows
        if len(row) == 2 and row[0][0] != row[1][0] and {row[0][0], row[1][0]} <= bodies
    ]
    if not pairs:
        return
    world.request_tables(("shapes",))
    shapes = world.snapshot.shapes()
    for first, second in pairs[:MAX_LINES]:
        points = shapes.points(first, second)
        if points is not None:
            yield points


def _boxes(world: World, rows: Sequence[list[Mark]]) -> Iterator[list[float]]:
    """Yields the boxes of the bodies in a result, unless they are many.

    A box is the number of its entity, its lower corner and its upper one, m.
    """
    ids = dict.fromkeys(entity for row in rows for entity, _ in row)
    bodies = {info.id for info in world.snapshot.entities if info.body is not None}
    if len(ids) <= MAX_LINES:
        for id in bodies.intersection(ids):
            low, high = world.entity(id).aabb
            yield [id, *map(float, low), *map(float, high)]


def _picture(value: Any) -> str | None:
    """Returns a picture that a value has, base64 of PNG; None if it is shown as a table."""
    content = None if isinstance(value, World) else png_of(value)
    return None if content is None else base64.b64encode(content).decode()


def error_message(error: SelectScriptError) -> dict[str, Any]:
    """Returns an error with its place and suggestions, as a page shows it."""
    span = error.span
    return {
        "type": type(error).__name__,
        "message": error.message,
        "suggestions": list(error.suggestions),
        "start": None if span is None else span.start,
        "end": None if span is None else span.end,
        "line": error.line,
        "column": error.column,
    }


def text_of(question: dict[str, Any], key: str) -> str:
    """Returns a text of a question."""
    return validation.text(question.get(key), f"{question['type']}: {key} is a text")


def _time(question: dict[str, Any]) -> float | None:
    value = question.get("at")
    return None if value is None else validation.seconds(value, "a time")


def language_of(question: dict[str, Any]) -> Any:
    """Returns the language of a question."""
    language = question.get("language", "selectscript")
    if not isinstance(language, str) or language not in KEYWORDS:
        raise UnknownNameError(
            f"there is no language {str(language)[:40]!r}",
            suggestions=nearest(str(language), KEYWORDS),
        )
    return language
