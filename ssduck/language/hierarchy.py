"""Runs hierarchical queries row by row: START WITH … CONNECT BY … STOP WITH.

A state is the values of the state variables. In a state, each combination of the sources is a
row; SELECT, WHERE and STOP WITH see the state before the row's step, and CONNECT BY computes the
next state from the row and the state. If WHERE holds at a row, the path up to it is a result and
ends. Otherwise, if STOP WITH holds, the path ends without a result. Otherwise, the search goes on
from the next state. Without WHERE, the paths that STOP WITH ends are the results.

A row that ends a path without a result is a dead end. As in SQL, it is not selected, unless the
query has side effects.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice, tee
from typing import Any, Generic, TypeAlias, TypeVar

from ssduck.errors import ArgumentError, LimitError
from ssduck.language import ast
from ssduck.language.analysis import is_impure
from ssduck.language.clauses import Clauses, Paths, Rows, Selected, checked_count
from ssduck.language.evaluator import ExpressionCompiler, Frame, Thunk, resolved
from ssduck.language.operators import check_size
from ssduck.language.value_history import LazyList
from ssduck.language.value_keys import ValueKeys

# The largest number of states whose rows are cached.
MAX_STATES = 10_000
# The size of a row of a path with its frame, bytes, roughly.
_STEP_BYTES = 400


@dataclass(eq=False, slots=True)
class RowSelection:
    """The selected values of a row."""

    values: tuple[Any, ...]  # the values
    names: tuple[Any, ...]  # the names of the columns
    key: int | None = None  # a number that identifies both; None while it is unknown


@dataclass(eq=False, slots=True)
class PathStep:
    """A row in a state that is not a dead end."""

    frame: Frame  # the frame of the row
    selection: RowSelection | None  # the selected values; None while they are unknown
    is_result: bool  # whether a path up to this row is a result
    stops: bool  # whether STOP WITH holds; for a result, it is evaluated only under UNIQUE
    # The rows of the state after its step; None while they are unknown.
    successors: Steps | None = None


# The rows of a state, in order, each made at its first use: an iterator of `tee` that stays at the
# first row.
Steps: TypeAlias = Iterator[PathStep]
RowsOf: TypeAlias = Callable[[dict[str, Any]], Iterable[Mapping[str | None, Any]]]


class _States:
    """The rows of each state that was reached, by a function that yields them; equal ones share.

    Attributes:
        keys: the numbers that identify rows.
    """

    def __init__(
        self, make_steps: Callable[[dict[str, Any]], Iterator[PathStep]], max_states: int
    ) -> None:
        self.keys = ValueKeys()
        self._make_steps = make_steps
        self._max_states = max_states
        self._known: dict[Any, Steps] = {}

    def __call__(self, state: dict[str, Any]) -> Steps:
        key = None
        with suppress(ArgumentError):  # its values have no keys
            key = self.keys.exact(state.values())
        steps = None if key is None else self._known.get(key)
        if steps is None:
            steps = tee(self._make_steps(state), 1)[0]
            if key is not None and len(self._known) < self._max_states:
                self._known[key] = steps
        return steps


def _from_start(steps: Steps) -> Iterator[PathStep]:
    """Yields the rows of a state from the first one."""
    return tee(steps)[1]  # the first one stays at the first row


class Hierarchy:
    """A hierarchical query as functions of frames."""

    def __init__(
        self, query: ast.Query, clauses: Clauses, compiler: ExpressionCompiler, max_depth: int
    ) -> None:
        assert query.recursion is not None
        self._query = query
        self._recursion: ast.Recursion = query.recursion
        self._clauses = clauses
        self._start = _assignments(query.recursion.start, compiler)
        self._next = _assignments(query.recursion.step, compiler)
        self._stop = compiler.condition(query.recursion.stop)
        self._where = None if query.where is None else compiler.condition(query.where)
        self._numbers = {
            node: compiler.thunk(node)
            for node in (query.recursion.memorize, query.recursion.maximum)
            if node is not None
        }
        self._deepest = max_depth
        self._has_side_effects = is_impure(query)

    def selected(self, outer: Frame, rows: RowsOf, cached: dict[ast.Node, Any]) -> Selected:
        """Returns the paths."""
        recursion = self._recursion
        state = dict(outer.local)
        for name, value in self._start:
            frame = Frame(outer.scope, outer.elements, state, outer.placeholders, (), outer.cached)
            initial = value(frame)
            if name is not None:
                state[name] = resolved(initial, frame) if isinstance(initial, LazyList) else initial
        max_states = 0 if self._has_side_effects else MAX_STATES
        states = _States(self._steps_of(outer, rows, cached), max_states)
        search = self._graph_paths if recursion.memorizes else self._depth_first
        paths = search(outer, states, state)
        max_paths = self._number(recursion.maximum, "MAXIMUM", outer)
        meter = outer.scope.meter
        result: list[list[PathStep]] = []
        for path in islice(paths, max_paths):
            result.append(path)
            meter.check_rows(len(result))
        window = self._clauses.window(outer)

        def formed(paths: list[list[PathStep]]) -> Paths:
            results = []
            for path in paths:
                meter.step()
                results.append(self._distinct(path) if recursion.memorizes else self._rows(path))
            return Paths(results)

        return self._clauses.arranged(result, lambda path: path[-1].frame, formed, window, outer)

    def _number(self, node: ast.Node | None, clause: str, outer: Frame) -> int | None:
        return None if node is None else checked_count(self._numbers[node](outer), clause, node)

    def _distinct(self, path: list[PathStep]) -> Paths:
        return Paths([self._rows([step]) for step in path])

    def _rows(self, path: Sequence[PathStep]) -> Rows:
        selections = [self._selection(step) for step in path]
        return self._clauses.items.rows_of_values(
            [selection.names for selection in selections],
            [selection.values for selection in selections],
        )

    # -- rows ------------------------------------------------------------------------------

    def _steps_of(
        self, outer: Frame, rows: RowsOf, cached: dict[ast.Node, Any]
    ) -> Callable[[dict[str, Any]], Iterator[PathStep]]:
        """Returns a function that yields the rows of a state, without dead ends."""
        stop, where = self._stop, self._where
        # Under UNIQUE, STOP WITH decides whether a result counts as visited.
        always_stops = where is None or self._recursion.unique
        scope, placeholders = outer.scope, outer.placeholders
        count, charge = scope.meter.combination_counter(), scope.meter.charge

        def steps(state: dict[str, Any]) -> Iterator[PathStep]:
            state_values: dict[ast.Node, Any] = {}
            frame = None
            for elements in rows(state):
                count()
                if frame is None:
                    frame = Frame(scope, elements, state, placeholders, (), cached, state_values)
                frame.elements, frame.calls = elements, {}
                selection = self._selected_of(frame) if self._has_side_effects else None
                result = False if where is None else where(frame)
                stops = stop(frame) if always_stops or not result else True
                if where is None:
                    result = stops
                if result or not stops:
                    charge(_STEP_BYTES)
                    yield PathStep(frame, selection, result, stops)
                    frame = None  # the step refers to it; a dead end's frame is reused

        return steps

    def _selection(self, step: PathStep) -> RowSelection:
        """Returns the selected values of a row, evaluated on first use."""
        if step.selection is None:
            step.selection = self._selected_of(step.frame)
        return step.selection

    def _selected_of(self, frame: Frame) -> RowSelection:
        items = self._clauses.items
        return RowSelection(items.values(frame), items.names(frame))

    def _key(self, step: PathStep, keys: ValueKeys) -> int:
        """Returns the key by which rows are distinguished."""
        selection = step.selection or self._selection(step)
        if selection.key is None:
            selection.key = keys.of(selection.values, selection.names)
        return selection.key

    def _successors(self, step: PathStep, states: _States) -> Iterator[PathStep]:
        """Yields the rows of the state after a row; all of CONNECT BY sees the state before it."""
        if step.successors is None:
            state = dict(step.frame.local)
            for name, value in self._next:
                next_value = value(step.frame)
                check_size(next_value, self._recursion.span)
                if name is not None:
                    state[name] = next_value
            step.successors = states(state)
        return _from_start(step.successors)

    # -- searches -------------------------------------------------------------------------

    def _depth_first(
        self, outer: Frame, states: _States, state: dict[str, Any]
    ) -> Iterator[list[PathStep]]:
        """Yields the paths in depth-first order of the sources."""
        unique = self._recursion.unique
        skips_visited = unique or self._recursion.no_cycle
        keys = states.keys
        visited: set[int | None] = set()
        path: list[PathStep] = []
        open_rows = [_from_start(states(state))]
        count = outer.scope.meter.combination_counter()
        while open_rows:
            for step in open_rows[-1]:
                count()
                if skips_visited and self._key(step, keys) in visited:
                    continue
                if step.is_result:
                    yield [*path, step]
                continues = not (step.is_result or step.stops)
                if skips_visited and (not step.stops if unique else continues):
                    visited.add(self._key(step, keys))
                if continues:
                    path.append(step)
                    self._check_depth(len(path), "a path", "rows")
                    open_rows.append(self._successors(step, states))
                    break
            else:
                open_rows.pop()
                finished = path.pop() if path else None
                if finished is not None and skips_visited and not unique:
                    visited.discard(self._key(finished, keys))

    def _check_depth(self, depth: int, subject: str, parts: str) -> None:
        if depth >= self._deepest:
            raise LimitError(
                f"{subject} has more than {self._deepest} {parts}; bound the search in STOP WITH, "
                "or with MEMORIZE n, or raise Limits(depth=…)",
                span=self._recursion.span,
            )

    def _graph_paths(
        self, outer: Frame, states: _States, state: dict[str, Any]
    ) -> Iterator[list[PathStep]]:
        """Yields the simple paths through the graph of distinct selected rows, shortest first."""
        levels = self._number(self._recursion.memorize, "MEMORIZE", outer)
        roots, vertices = self._graph(states, state, levels)
        return simple_paths(roots, vertices, levels, outer.scope.meter.step)

    def _graph(
        self, states: _States, state: dict[str, Any], levels: int | None
    ) -> tuple[list[Vertex[PathStep]], list[Vertex[PathStep]]]:
        """Returns the distinct rows that are reached, breadth first, and those of the first level.

        Without a number of levels there are as many as it takes to find a path.
        """
        keys = states.keys
        max_depth = levels
        vertices: dict[int, Vertex[PathStep]] = {}
        queue: deque[tuple[Vertex[PathStep], int]] = deque()

        def reached(steps: Iterator[PathStep], level: int) -> list[Vertex[PathStep]]:
            nonlocal max_depth
            result: dict[Vertex[PathStep], None] = {}  # an ordered set
            for step in steps:
                key = self._key(step, keys)
                vertex = vertices.get(key)
                if vertex is None:
                    vertex = vertices[key] = Vertex(step, step.is_result)
                    if not step.is_result:
                        queue.append((vertex, level))
                    elif max_depth is None:  # no shortest path is longer
                        max_depth = level
                result[vertex] = None
            return list(result)

        roots = reached(_from_start(states(state)), 1) if levels != 0 else []
        while queue:
            vertex, level = queue.popleft()
            if max_depth is None or level < max_depth:
                self._check_depth(level, "the graph", "levels")
                vertex.next = reached(self._successors(vertex.value, states), level + 1)
        return roots, list(vertices.values())


def _assignments(
    parts: Sequence[ast.Node], compiler: ExpressionCompiler
) -> list[tuple[str | None, Thunk]]:
    """Returns the state variables and their values; without a name, the other expressions."""
    return [
        (part.name, compiler.thunk(part.value))
        if isinstance(part, ast.Assignment)
        else (None, compiler.thunk(part))
        for part in parts
    ]


T = TypeVar("T")


@dataclass(eq=False)
class Vertex(Generic[T]):
    """A distinct selected row."""

    value: T  # the row
    is_result: bool  # whether paths end here
    next: list[Vertex[T]] = field(default_factory=list)  # the rows of its state, in order
    distance: int | None = None  # the number of steps to the nearest result


def simple_paths(
    roots: Sequence[Vertex[T]],
    vertices: Sequence[Vertex[T]],
    max_length: int | None,
    count: Callable[[], None],
) -> Iterator[list[T]]:
    """Yields the simple paths from a root to a result, shortest first.

    There may be too many simple paths of any length; without a maximum length, only the shortest
    ones are yielded.

    At the end, the edges are removed, which is faster than garbage collection.
    """
    _set_distances(vertices)
    limit = _shortest(roots) if max_length is None else min(max_length, len(vertices))
    try:
        for length in range(1, limit + 1):
            for root in roots:
                if root.distance is not None and root.distance < length:
                    for path in _paths_of_length(root, length, count):
                        yield [vertex.value for vertex in path]
    finally:
        for vertex in vertices:
            vertex.next.clear()


def _shortest(roots: Sequence[Vertex[T]]) -> int:
    """Returns the number of vertices of the shortest path; 0 if there is none."""
    return min((1 + root.distance for root in roots if root.distance is not None), default=0)


def _set_distances(vertices: Sequence[Vertex[T]]) -> None:
    predecessors: dict[Vertex[T], list[Vertex[T]]] = {}
    for vertex in vertices:
        for successor in vertex.next:
            predecessors.setdefault(successor, []).append(vertex)
    queue = deque(vertex for vertex in vertices if vertex.is_result)
    for vertex in queue:
        vertex.distance = 0
    while queue:
        vertex = queue.popleft()
        assert vertex.distance is not None
        for predecessor in predecessors.get(vertex, ()):
            if predecessor.distance is None:
                predecessor.distance = vertex.distance + 1
                queue.append(predecessor)


def _paths_of_length(
    root: Vertex[T], length: int, count: Callable[[], None]
) -> Iterator[list[Vertex[T]]]:
    if root.is_result:
        if length == 1:
            yield [root]
        return
    path = [root]
    visited = {root}
    stack = [iter(root.next)]
    while stack:
        count()
        vertex = next(stack[-1], None)
        if vertex is None:
            stack.pop()
            visited.discard(path.pop())
            continue
        remaining = length - len(path) - 1
        if vertex.distance is None or vertex.distance > remaining or vertex in visited:
            continue
        if vertex.is_result:
            if remaining == 0:
                yield [*path, vertex]
            continue
        path.append(vertex)
        visited.add(vertex)
        stack.append(iter(vertex.next))
