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

from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, islice, tee
from operator import itemgetter
from typing import Any, Generic, TypeAlias, TypeVar

from ssduck.errors import ArgumentError, LimitError
from ssduck.language.analysis import is_impure, mentions, states
from ssduck.language.clauses import Clauses, Paths, Rows, Selected, checked_count
from ssduck.language.deferred import LazyList
from ssduck.language.evaluator import ExpressionCompiler, Frame, Thunk, resolved
from ssduck.language.operators import check_size, truth
from ssduck.language.tree import Assignment, Name, Node, Query, Recursion, TimeIndex
from ssduck.language.value_keys import ValueKeys

# The largest number of states whose rows are cached.
MAX_STATES = 10_000
# The size of a row of a path with its frame, bytes, roughly.
_STEP_BYTES = 400
# The key of the selected values among the cached calls of a row; no call has it.
_SELECT = "SELECT"


class RowSelection:
    """The selected values of a row.

    Attributes:
        values: the values.
        names: the names of the columns.
        key: a number that identifies both; None while it is unknown.
    """

    __slots__ = ("key", "names", "values")

    def __init__(self, values: tuple[Any, ...], names: tuple[Any, ...]) -> None:
        self.values = values
        self.names = names
        self.key: int | None = None


class PathStep:
    """A row in a state that is not a dead end.

    Attributes:
        frame: the frame of the row.
        is_result: whether a path up to this row is a result.
        stops: whether STOP WITH holds; for a result, it is evaluated only under UNIQUE.
        selection: the selected values; None while they are unknown.
        successors: the rows of the state after its step; None while they are unknown.
    """

    __slots__ = ("frame", "is_result", "selection", "stops", "successors")

    def __init__(
        self,
        frame: Frame,
        selection: RowSelection | None,
        is_result: bool,  # positional, because keywords take time
        stops: bool,
    ) -> None:
        self.frame = frame
        self.selection = selection
        self.is_result = is_result
        self.stops = stops
        self.successors: Steps | None = None


# The rows of a state, in order, each made at its first use: an iterator of `tee` that stays at the
# first row.
Steps: TypeAlias = Iterator[PathStep]
RowsOf: TypeAlias = Callable[[dict[str, Any]], Iterable[Mapping[str | None, Any]]]
Calls: TypeAlias = dict[str, Any]


class _States:
    """The rows of each state that was reached; equal states share them.

    Rows of different states share the results of users' functions if the states differ only in
    variables that the calls do not mention.

    Args:
        make_steps: a function that yields the rows of a state, with the results of users'
            functions for each row.
        call_variables: the state variables that calls of users' functions mention; None if rows
            of different states share nothing.
        max_states: the largest number of cached states.

    Attributes:
        keys: the numbers that identify rows.
    """

    def __init__(
        self,
        make_steps: Callable[[dict[str, Any], Iterator[Calls]], Iterator[PathStep]],
        call_variables: Collection[str] | None,
        max_states: int,
    ) -> None:
        self.keys = ValueKeys()
        self._make_steps = make_steps
        self._call_variables = call_variables
        self._max_states = max_states
        self._known: dict[Any, Steps] = {}
        self._calls: dict[Any, dict[int, Calls]] = defaultdict(lambda: defaultdict(dict))
        self._picks: dict[int, Callable[[tuple[Any, ...]], Any]] = {}

    def __call__(self, state: dict[str, Any]) -> Steps:
        """Returns the rows of a state."""
        try:
            key = self.keys.exact(state.values())
        except ArgumentError:  # its values have no keys
            return self._steps(state, None)
        result = self._known.get(key)
        if result is not None:
            return result
        if len(self._known) >= self._max_states:
            return self._steps(state, None)
        result = self._known[key] = self._steps(state, key)
        return result

    def _steps(self, state: dict[str, Any], key: tuple[Any, ...] | None) -> Steps:
        return tee(self._make_steps(state, self._calls_of(state, key)), 1)[0]

    def _calls_of(self, state: dict[str, Any], key: tuple[Any, ...] | None) -> Iterator[Calls]:
        """Yields the results of users' functions for each row of a state."""
        if key is None or self._call_variables is None:
            return iter(dict, None)
        pick = self._picks.get(len(state))  # CONNECT BY may set more variables than START WITH
        if pick is None:
            places = [place for place, name in enumerate(state) if name in self._call_variables]
            pick = self._picks[len(state)] = itemgetter(*places) if places else _nothing
        return map(self._calls[pick(key)].__getitem__, count())


def _nothing(_: object) -> None:
    """Returns the key of a state for calls that mention none of its variables."""


def _from_start(steps: Steps) -> Iterator[PathStep]:
    """Yields the rows of a state from the first one."""
    return tee(steps)[1]  # the first one stays at the first row


class Hierarchy:
    """A hierarchical query as functions of frames.

    Args:
        query: the query.
        clauses: SELECT, and the clauses that apply to the paths.
        compiler: the compiler of its parts.
        max_depth: the largest number of rows of a path.
    """

    def __init__(
        self, query: Query, clauses: Clauses, compiler: ExpressionCompiler, max_depth: int
    ) -> None:
        assert query.recursion is not None
        self._query = query
        self._recursion: Recursion = query.recursion
        self._clauses = clauses
        self._start = _assignments(query.recursion.start, compiler)
        self._next = _assignments(query.recursion.step, compiler)
        self._stop = compiler.thunk(query.recursion.stop)
        self._where = None if query.where is None else compiler.thunk(query.where)
        self._numbers = {
            node: compiler.thunk(node)
            for node in (query.recursion.memorize, query.recursion.maximum)
            if node is not None
        }
        self._deepest = max_depth
        self._has_side_effects = is_impure(query)
        self._call_variables = _call_variables(query, compiler)
        selected = _variables_read(query.items, states(query), compiler)
        self._shares_selected = (
            self._call_variables is not None
            and selected is not None
            and selected <= self._call_variables
        )

    def selected(self, outer: Frame, rows: RowsOf, cached: dict[Node, Any]) -> Selected:
        """Returns the paths.

        Args:
            outer: the frame of the outer query.
            rows: a function that returns the elements of the sources at each row of a state.
            cached: the values of constant parts that are evaluated already.
        """
        recursion = self._recursion
        state = dict(outer.local)
        for name, value in self._start:
            frame = Frame(outer.scope, outer.elements, state, outer.placeholders, (), outer.cached)
            initial = value(frame)
            if name is not None:
                state[name] = resolved(initial, frame) if isinstance(initial, LazyList) else initial
        max_states = 0 if self._has_side_effects else MAX_STATES
        states = _States(self._steps_of(outer, rows, cached), self._call_variables, max_states)
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

    def _number(self, node: Node | None, clause: str, outer: Frame) -> int | None:
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
        self, outer: Frame, rows: RowsOf, cached: dict[Node, Any]
    ) -> Callable[[dict[str, Any], Iterator[Calls]], Iterator[PathStep]]:
        """Returns a function that yields the rows of a state, without dead ends."""
        stop_node, (stop, where) = self._recursion.stop, (self._stop, self._where)
        result_node = stop_node if self._query.where is None else self._query.where
        # Under UNIQUE, STOP WITH decides whether a result counts as visited.
        always_stops = where is None or self._recursion.unique
        scope, placeholders = outer.scope, outer.placeholders
        count, charge = scope.meter.combination_counter(), scope.meter.charge

        def steps(state: dict[str, Any], calls: Iterator[Calls]) -> Iterator[PathStep]:
            state_values: dict[Node, Any] = {}
            frame = None
            for elements, known in zip(rows(state), calls, strict=False):
                count()
                if frame is None:
                    frame = Frame(scope, elements, state, placeholders, (), cached, state_values)
                frame.elements, frame.calls = elements, known
                selection = self._selected_of(frame) if self._has_side_effects else None
                result = False if where is None else where(frame)
                if result is not True and result is not False:
                    result = truth(result, result_node)
                stops = stop(frame) if always_stops or not result else True
                if stops is not True and stops is not False:
                    stops = truth(stops, stop_node)
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
        if self._shares_selected and _SELECT in frame.calls:
            shared: RowSelection = frame.calls[_SELECT]
            return shared
        items = self._clauses.items
        selection = RowSelection(items.values(frame), items.names(frame))
        if self._shares_selected:
            frame.calls[_SELECT] = selection
        return selection

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
    parts: Sequence[Node], compiler: ExpressionCompiler
) -> list[tuple[str | None, Thunk]]:
    """Returns the state variables and their values; without a name, the other expressions."""
    return [
        (part.name, compiler.thunk(part.value))
        if isinstance(part, Assignment)
        else (None, compiler.thunk(part))
        for part in parts
    ]


def _call_variables(query: Query, compiler: ExpressionCompiler) -> frozenset[str] | None:
    """Returns the state variables that calls of users' functions mention.

    None where there is no such call, or where each state has rows of its own.
    """
    names = states(query)
    calls = [node for node in query.walk() if compiler.calls_once(node)]
    if not calls or any(mentions(source.value, names) for source in query.sources):
        return None
    return _variables_read(calls, names, compiler)


def _variables_read(
    nodes: Sequence[Node], names: frozenset[str], compiler: ExpressionCompiler
) -> frozenset[str] | None:
    """Returns the state variables that nodes read; None if unknown."""
    read = [part for node in nodes for part in node.walk() if isinstance(part, Name | TimeIndex)]
    if any(compiler.is_deferred(part) for part in read):
        return None
    return names & {part.name for part in read}


T = TypeVar("T")


@dataclass(eq=False)
class Vertex(Generic[T]):
    """A distinct selected row.

    Attributes:
        value: the row.
        is_result: whether paths end here.
        next: the rows of its state, in order.
        distance: the number of steps to the nearest result.
    """

    value: T
    is_result: bool
    next: list[Vertex[T]] = field(default_factory=list)
    distance: int | None = None


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

    Args:
        roots: the first vertices of paths.
        vertices: all vertices.
        max_length: the largest number of vertices of a path; None for that of the shortest path.
        count: a function that is called once a step.
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
