"""Answers what a page asks: queries, completions, and facts about an entity.

All methods run in the one thread of a page's queries.
"""

from __future__ import annotations

import base64
import io
import math
import time
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.adapters.display import DisplayTable, are_numeric, as_json, display_table, readable
from ssduck.adapters.formats import FORMATS, png_of
from ssduck.adapters.grid_values import Grid
from ssduck.adapters.marks import Mark, Marks
from ssduck.adapters.point_cloud import PointCloud
from ssduck.errors import (
    ArgumentError,
    LimitError,
    SelectScriptError,
    check_known,
    heard_warnings,
)
from ssduck.interpreter.completion import KEYWORDS, Language, complete
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from ssduck.interpreter.program import value_to_show
from ssduck.interpreter.stopping import StopRequest
from ssduck.language import ast
from ssduck.language.analysis import calls_of
from ssduck.logic.why import Why
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.view.facts import facts_of, plot_of
from ssduck.view.live import Asked, Ticks
from ssduck.view.scans import Scan
from ssduck.world.world import World

# The functions whose values are intervals of simulated time.
_INTERVALS = "holds"
MAX_LANES = 12
_AHEAD = frozenset(name for name, form in TEMPORAL_FUNCTIONS.items() if form.looks_ahead)


def not_shown(ss: Interpreter, text: str, language: Language) -> Iterator[str]:
    """Yields a note if a program that was run has statements whose results are not shown."""
    if language == "sql":
        return
    *before, _ = ss.compile(text).tree.statements
    if any(not isinstance(statement, ast.Assignment) for statement in before):
        yield (
            f"this is the result of the last of {len(before) + 1} statements; run the others by "
            "themselves to see theirs"
        )


def has_intervals(ss: Interpreter, text: str, language: Language) -> bool:
    """Checks whether a program that was run asks when something held."""
    if language == "sql":
        return False
    calls = (name for part in ss.compile(text).tree.statements for name in calls_of(part))
    return _INTERVALS in calls


def heads_of(
    ss: Interpreter, text: str, language: Language, value: Any, columns: Sequence[str]
) -> list[str]:
    """Returns the heads of a value's table: those of its columns, or what intervals consist of."""
    if language == "selectscript" and _are_spans(value):
        last = ss.compile(text).tree.statements[-1]
        if isinstance(last, ast.Call) and last.name == _INTERVALS:
            return ["begin", "end"]
    return list(columns)


def lanes_of(
    value: Any, columns: Sequence[str], rows: Sequence[Sequence[Any]]
) -> Iterator[tuple[str, Any]]:
    """Yields the intervals of a value for the time line: a label, and spans [start, end] in s."""
    if _are_spans(value):
        yield "holds", value
        return
    for row in rows[:MAX_LANES]:
        names = [str(cell) for cell in row if isinstance(cell, str)]
        for column, cell in zip(columns, row, strict=True):
            if _are_spans(cell):
                yield " ".join(names) or column, cell


def _are_spans(value: Any) -> bool:
    return (
        isinstance(value, list)
        and all(isinstance(part, list) and len(part) == 2 for part in value)
        and all(isinstance(number, int | float) for part in value for number in part)
    )


# -- drawings ---------------------------------------------------------------------------------


# More points are thinned out evenly: a page draws them at each frame.
MAX_POINTS = 200_000


def drawing_of(value: Any) -> dict[str, Any] | None:
    """Returns a description of a grid, a cloud or the parts of a condition; None for other values.

    A flat grid has the share of its largest value in each cell, from 0 to 255, row by row along the
    first axis. A cloud has points (float32 x y z), and a number for the entity of each. A condition
    has its parts, each with its depth, whether it holds, its margin, its points and its time, null
    when it was asked.
    """
    if isinstance(value, Why):
        return {"kind": "why", "parts": value.rows()}
    if isinstance(value, PointCloud):
        return _cloud(value.points, value.owners, list(value.names), None)
    if not isinstance(value, Grid):
        return None
    cells = np.asarray(value.cells, dtype=float)
    shares = np.nan_to_num(cells / max(float(np.nanmax(np.abs(cells), initial=0.0)), 1e-12))
    if cells.ndim == 3:
        places = np.argwhere(shares > 0.0)
        points = np.array(value.origin) + (places + 0.5) * value.resolution
        return _cloud(points, np.zeros(len(points), np.intp), ["cells"], value.resolution)
    return {
        "kind": "grid",
        "origin": [float(number) for number in value.origin],
        "resolution": float(value.resolution),
        "shape": list(value.shape),
        "shares": _encoded((255 * np.clip(shares, 0.0, 1.0)).astype(np.uint8).tobytes()),
    }


def _cloud(
    points: npt.NDArray[Any], owners: npt.NDArray[Any], names: list[str], size: float | None
) -> dict[str, Any]:
    step = -(-len(points) // MAX_POINTS) or 1
    return {
        "kind": "cloud",
        "points": _encoded(points[::step].astype("<f4").tobytes()),
        "owners": _encoded(owners[::step].astype("<u4").tobytes()),
        "names": names,
        "size": size,
    }


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode()


# -- shown values -----------------------------------------------------------------------------


# The numbers of values in all rows of an answer, and of the letters of a text; downloads have all.
MAX_VALUES = 100_000
MAX_LETTERS = 100_000


def shown_rows(rows: Iterable[Sequence[Any]], most: int = MAX_VALUES) -> list[list[Any]]:
    """Returns the first rows as JSON; lists that are cut off end in a text that says so.

    Cells are NULL, the numbers that JavaScript has exactly, and texts as the terminal shows them.
    """
    values = _ShownValues(most)
    shown = []
    for row in rows:
        if values.left <= 0:
            break
        shown.append(list(map(_cell, values.list_of(row))))
    return shown


# JavaScript rounds greater integers.
_MAX_INTEGER = 2**53


def _cell(value: Any) -> float | str | None:
    match value:
        case None | str():
            return value
        case Decimal() if value.is_finite() and abs(value) > _MAX_INTEGER:
            return str(value)
        case float() | Decimal() if math.isfinite(value):
            return float(value)
        case int() if not isinstance(value, bool) and abs(value) <= _MAX_INTEGER:
            return value
    return readable(value)


class _ShownValues:
    """Cuts values off when there are too many."""

    def __init__(self, most: int) -> None:
        self.left = most

    def of(self, value: Any) -> Any:
        """Returns a value, or its beginning."""
        self.left -= 1
        match value:
            case str() | bytes() if len(value) > MAX_LETTERS:
                start = as_json(value[:MAX_LETTERS])
                return f"{start}… ({len(value) - MAX_LETTERS:,} more)"
            case list() | tuple():
                return self.list_of(value)
            case np.ndarray() if value.ndim:
                return self.list_of(value)
            case dict():
                return self._dict_of(value)
            case np.generic() | np.ndarray():
                return value.item()
        return value

    def list_of(self, values: Sequence[Any] | npt.NDArray[Any]) -> list[Any]:
        """Returns the first of some values."""
        shown: list[Any] = []
        for value in values:
            if self.left <= 0:
                return [*shown, _more(len(values) - len(shown))]
            shown.append(self.of(value))
        return shown

    def _dict_of(self, values: dict[Any, Any]) -> dict[Any, Any]:
        shown: dict[Any, Any] = {}
        for key, value in values.items():
            if self.left <= 0:
                return shown | {"…": _more(len(values) - len(shown))}
            shown[key] = self.of(value)
        return shown


def _more(count: int) -> str:
    return f"… ({count:,} more)"


# -- the questions of a page ------------------------------------------------------------------


# The rows that a page gets at most; downloads have all.
MAX_ROWS = 1000
MAX_COMPLETIONS = 60
# The longest text that is completed, letters: no limit of time ends that.
MAX_COMPLETED = 50_000
MAX_LINES = 100
# The formats of downloads.
_DOWNLOADS = ("csv", "json", "parquet")


class AskedSource(Protocol):
    """The worlds that the questions of a page are about."""

    def mirror(self, time: float | None) -> Asked:
        """Returns the world at a time, s; at present for None."""

    def recorded(self) -> Asked:
        """Returns a world that goes through the recorded ticks."""

    def ticks(self) -> Ticks | None:
        """Returns the recorded ticks; None if nothing is recorded."""


class Answers:
    """Answers the questions of one page."""

    def __init__(self, source: AskedSource) -> None:
        self._source = source
        self._result: Any = None
        # Ends the programs of the question that is being answered.
        self._stop = StopRequest()
        # A program with intervals, its language and the last tick, and its bars there.
        self._bars: tuple[Any, list[Any]] = None, []

    def answer(self, question: dict[str, Any], stop: StopRequest) -> dict[str, Any]:
        """Returns the answer to a question; an error has its place and suggestions."""
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
        asked = self._source.mirror(self._time_of(question, text, language))
        world = asked.world
        with heard_warnings() as heard:
            value = self._value_of(asked, text, language)
            picture, drawing = _picture(value), drawing_of(value)
            table, marked = _table_of(value, picture)
            everything = list(map(Marks(world).of, marked))
        self._result = value
        is_why = isinstance(value, Why)
        rows = shown_rows(table.rows[:MAX_ROWS])
        return {
            "columns": heads_of(asked.interpreter, text, language, value, table.columns),
            "rows": rows,
            "numeric": are_numeric(DisplayTable(table.columns, table.rows[: len(rows)])),
            "marks": everything[: len(rows)],
            "all": sorted({mark for each in everything for mark in each}),
            "lines": [] if is_why else list(_lines(world, everything)),
            "boxes": [] if is_why else list(_boxes(world, everything)),
            "count": len(table.rows),
            "picture": picture,
            "drawing": drawing,
            "decided": value.decided_at if is_why else None,
            "lanes": bars,
            "warnings": [*not_shown(asked.interpreter, text, language), *heard],
            "time": world.time,
            "ms": (time.perf_counter() - started) * 1e3,
        }

    def _time_of(self, question: dict[str, Any], text: str, language: Any) -> float | None:
        """Returns the time at which a question is asked, s; None for the present.

        A new WHY of what looks ahead is of all recorded ticks: it has just begun at the first one.
        """
        at, ticks = _time(question), self._source.ticks()
        if at is None or ticks is None or language == "sql" or question.get("anew") is not True:
            return at
        tree = self._source.mirror(at).interpreter.compile(text).tree
        calls = frozenset().union(*map(calls_of, tree.statements))
        is_whole = tree.explain == "WHY" and not calls.isdisjoint(_AHEAD)
        return float(ticks.times[-1]) if is_whole else at

    def _value_of(self, asked: Asked, text: str, language: Any) -> Any:
        with self._stop.applies_to(asked.interpreter):
            return value_to_show(asked.interpreter, text, language)

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
        """Returns a search for the changes of an answer; only the thread of scans calls this."""
        asked = self._source.recorded()
        world = asked.world
        assert isinstance(world, ReplayedWorld)
        text, language = text_of(question, "text"), language_of(question)
        return Scan(asked.interpreter, world, text, language, stop)

    def _complete(self, question: dict[str, Any]) -> dict[str, Any]:
        text, language = text_of(question, "text"), language_of(question)
        cursor, end = question.get("cursor"), _unit(text, len(text))
        cursor = validation.integer(cursor, "complete: cursor", minimum=0, maximum=end)
        if len(text) > MAX_COMPLETED:
            return {"completions": []}
        cursor = bisect_left(range(len(text)), cursor, key=partial(_unit, text))
        found = complete(self._source.mirror(_time(question)).interpreter, text, cursor, language)
        return {
            "completions": [
                [each.text, _unit(text, each.start), each.kind, each.usage, each.about]
                for each in found[:MAX_COMPLETIONS]
            ]
        }

    def _download(self, question: dict[str, Any]) -> dict[str, Any]:
        name = question.get("format")
        check_known(name, _DOWNLOADS, f"there is no download {name!r}")
        stream = io.BytesIO()
        FORMATS[str(name)].write_bytes(self._result, stream)
        return {"content": _encoded(stream.getvalue()), "name": f"result.{name}"}

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


def _table_of(value: Any, picture: str | None) -> tuple[DisplayTable, Sequence[Any]]:
    """Returns the table that a page shows of a value, and what stands out for each of its rows."""
    if picture:
        return DisplayTable([], []), []
    if not isinstance(value, Why):
        table = display_table(value)
        return table, table.rows
    rows = [
        (f"{part.mark} {part.text}\n{told}".strip(), part.margin)
        for _, part, told in value.told(margins=False)
    ]
    entities = [part.entities for _, part in value.walk()]
    return DisplayTable(["why", "margin"], rows), entities


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
    """Yields the boxes of the bodies in a result, unless they are many: entity, low, high, m."""
    ids = dict.fromkeys(entity for row in rows for entity, _ in row)
    bodies = {info.id for info in world.snapshot.entities if info.body is not None}
    if len(ids) <= MAX_LINES:
        for id in bodies.intersection(ids):
            low, high = world.entity(id).aabb
            yield [id, *map(float, low), *map(float, high)]


def _picture(value: Any) -> str | None:
    """Returns a picture that a value has, base64 of PNG; None if it is shown as a table."""
    content = None if isinstance(value, World) else png_of(value)
    return None if content is None else _encoded(content)


def error_message(error: SelectScriptError) -> dict[str, Any]:
    """Returns an error with its place and suggestions, as a page shows it."""
    text, span, column = error.text, error.span, error.column
    start = end = None
    if text is not None and span is not None and column is not None:
        start, end = _unit(text, span.start), _unit(text, span.end)
        column = start - _unit(text, span.start + 1 - column) + 1
    return {
        "type": type(error).__name__,
        "message": error.message,
        "suggestions": list(error.suggestions),
        "start": start,
        "end": end,
        "line": error.line,
        "column": column,
    }


def _unit(text: str, character: int) -> int:
    """Returns a place in a text as JavaScript counts: in units of UTF-16, two for an emoji."""
    return len(text[:character].encode("utf-16-le", "surrogatepass")) // 2


def text_of(question: dict[str, Any], key: str) -> str:
    """Returns a text of a question."""
    return validation.text(question.get(key), f"{question['type']}: {key} is a text")


def _time(question: dict[str, Any]) -> float | None:
    value = question.get("at")
    return None if value is None else validation.seconds(value, "a time")


def language_of(question: dict[str, Any]) -> Any:
    """Returns the language of a question."""
    language = question.get("language", "selectscript")
    check_known(str(language), KEYWORDS, f"there is no language {str(language)[:40]!r}")
    return language
