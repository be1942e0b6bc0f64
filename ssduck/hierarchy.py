"""Hierarchical queries, row by row: START WITH … CONNECT BY … STOP WITH.

A state is the values of the state variables. In a state, each combination of the sources is a
row; SELECT, WHERE and STOP WITH see the state before the row's step, and CONNECT BY makes of
both the next state. At a row: where WHERE holds, the path up to it is a result and ends;
else, where STOP WITH holds, it is none and ends; else the search goes on from the next state.
Without WHERE the paths that STOP WITH ends are the results.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from ssduck.adapters import Rows
from ssduck.errors import LimitError
from ssduck.evaluate import Compiler, Frame, Thunk, hashable
from ssduck.rows import Clauses, Paths, Selected, checked_count
from ssduck.tree import Assignment, Node, Query, Recursion


@dataclass(frozen=True)
class Step:
    """A row on a path: its frame, what is selected of it, and what this is called."""

    frame: Frame
    values: tuple[Any, ...]
    names: tuple[Any, ...]

    @property
    def key(self) -> Any:
        """What rows are told apart by: what is selected, and what it is called."""
        return hashable((self.values, self.names))


@dataclass(eq=False)
class _Vertex:
    """A distinct selected row in the graph of MEMORIZE."""

    step: Step
    found: bool
    next: list[_Vertex] = field(default_factory=list)
    distance: int | None = None


class Hierarchy:
    """A hierarchical query as functions of frames.

    Args:
        query: the query.
        clauses: SELECT, and what is applied to the paths.
        compiler: makes functions of its parts.
        deepest: how many rows a path may have.
    """

    def __init__(self, query: Query, clauses: Clauses, compiler: Compiler, deepest: int) -> None:
        assert query.recursion is not None
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
        self._deepest = deepest

    def selected(self, outer: Frame, rows: Callable[[dict[str, Any]], Iterator[Frame]]) -> Selected:
        """The paths.

        Args:
            outer: what is around the query.
            rows: the rows of a state, in order.
        """
        recursion = self._recursion
        state = dict(outer.local)
        for name, value in self._start:
            frame = Frame(outer.scope, outer.elements, state, outer.given, (), outer.kept)
            state[name] = value(frame)
        search = self._graph_paths if recursion.memorizes else self._depth_first
        paths = search(outer, state, rows)
        most = self._number(recursion.maximum, "MAXIMUM", outer)
        found = list(islice(paths, most))
        limit = self._clauses.count(outer)
        made = self._apart if recursion.memorizes else self._joined
        return self._clauses.arranged(found, lambda path: path[-1].frame, made, limit)

    def _number(self, node: Node | None, what: str, outer: Frame) -> int | None:
        return None if node is None else checked_count(self._numbers[node](outer), what, node)

    def _joined(self, paths: list[list[Step]]) -> Paths:
        return Paths([self._rows(path) for path in paths])

    def _apart(self, paths: list[list[Step]]) -> Paths:
        return Paths([Paths([self._rows([step]) for step in path]) for path in paths])

    def _rows(self, path: Sequence[Step]) -> Rows:
        return self._clauses.items.gathered(
            [step.names for step in path], [step.values for step in path]
        )

    # -- what a row is --------------------------------------------------------------------

    def _step(self, frame: Frame) -> Step:
        items = self._clauses.items
        return Step(frame, items.values(frame), items.names(frame))

    def _is_found(self, frame: Frame, stops: bool) -> bool:
        return stops if self._where is None else bool(self._where(frame))

    def _after(self, frame: Frame) -> dict[str, Any]:
        """The state after a row's step; all of CONNECT BY sees the state before it."""
        return {**frame.local, **{name: value(frame) for name, value in self._next}}

    # -- searches -------------------------------------------------------------------------

    def _depth_first(
        self, _: Frame, state: dict[str, Any], rows: Callable[[dict[str, Any]], Iterator[Frame]]
    ) -> Iterator[list[Step]]:
        """The paths in depth-first order of the sources."""
        recursion = self._recursion
        tells_apart = recursion.no_cycle or recursion.unique
        visited: set[Any] = set()
        path: list[Step] = []
        open_rows = [rows(state)]
        while open_rows:
            frame = next(open_rows[-1], None)
            if frame is None:
                open_rows.pop()
                if path:
                    left = path.pop()
                    if recursion.no_cycle and not recursion.unique:
                        visited.discard(left.key)
                continue
            step = self._step(frame)
            if tells_apart and step.key in visited:
                continue
            stops = bool(self._stop(frame))
            found = self._is_found(frame, stops)
            if found:
                yield [*path, step]
            if recursion.unique and not stops:
                visited.add(step.key)
            if found or stops:
                continue
            if recursion.no_cycle:
                visited.add(step.key)
            path.append(step)
            if len(path) >= self._deepest:
                raise LimitError(
                    f"a path has more than {self._deepest} rows; bound the search in STOP WITH, "
                    "or with MEMORIZE n, or raise Limits(depth=…)",
                    span=recursion.span,
                )
            open_rows.append(rows(self._after(frame)))

    def _graph_paths(
        self,
        outer: Frame,
        state: dict[str, Any],
        rows: Callable[[dict[str, Any]], Iterator[Frame]],
    ) -> Iterator[list[Step]]:
        """The simple paths through the graph of distinct selected rows, shortest first."""
        levels = self._number(self._recursion.memorize, "MEMORIZE", outer)
        roots, vertices = self._graph(state, rows, levels)
        _measure(vertices)
        longest = len(vertices) if levels is None else min(levels, len(vertices))
        for length in range(1, longest + 1):
            for root in roots:
                for path in _simple_paths(root, length, outer.scope.step):
                    yield [vertex.step for vertex in path]

    def _graph(
        self,
        state: dict[str, Any],
        rows: Callable[[dict[str, Any]], Iterator[Frame]],
        levels: int | None,
    ) -> tuple[list[_Vertex], list[_Vertex]]:
        """The distinct rows that are reached, breadth first, and those of the first level."""
        known: dict[Any, _Vertex] = {}
        waiting: deque[tuple[_Vertex, int]] = deque()

        def reached(state: dict[str, Any], level: int) -> list[_Vertex]:
            found = []
            for frame in rows(state):
                step = self._step(frame)
                vertex = known.get(step.key)
                if vertex is None:
                    stops = bool(self._stop(frame))
                    is_found = self._is_found(frame, stops)
                    if stops and not is_found:
                        continue
                    vertex = known[step.key] = _Vertex(step, is_found)
                    if not is_found:
                        waiting.append((vertex, level))
                found.append(vertex)
            return found

        roots = reached(state, 1) if levels != 0 else []
        while waiting:
            vertex, level = waiting.popleft()
            if levels is None or level < levels:
                if level >= self._deepest:
                    raise LimitError(
                        f"the graph has more than {self._deepest} levels; write MEMORIZE n, "
                        "or raise Limits(depth=…)",
                        span=self._recursion.span,
                    )
                vertex.next = reached(self._after(vertex.step.frame), level + 1)
        return roots, list(known.values())


def _measure(vertices: Sequence[_Vertex]) -> None:
    """How many steps each vertex is from the nearest one that is found."""
    before: dict[_Vertex, list[_Vertex]] = {}
    for vertex in vertices:
        for following in vertex.next:
            before.setdefault(following, []).append(vertex)
    waiting = deque(vertex for vertex in vertices if vertex.found)
    for vertex in waiting:
        vertex.distance = 0
    while waiting:
        vertex = waiting.popleft()
        assert vertex.distance is not None
        for earlier in before.get(vertex, ()):
            if earlier.distance is None:
                earlier.distance = vertex.distance + 1
                waiting.append(earlier)


def _simple_paths(root: _Vertex, length: int, count: Callable[[], None]) -> Iterator[list[_Vertex]]:
    """The paths of that many vertices from the root to one that is found, none met twice."""
    path = [root]
    open_ones = [iter(root.next)]
    if root.found:
        if length == 1:
            yield path
        return
    while open_ones:
        count()
        vertex = next(open_ones[-1], None)
        if vertex is None:
            open_ones.pop()
            path.pop()
            continue
        left = length - len(path) - 1
        if vertex.distance is None or vertex.distance > left or vertex in path:
            continue
        if vertex.found:
            if left == 0:
                yield [*path, vertex]
            continue
        path.append(vertex)
        open_ones.append(iter(vertex.next))


def _assignments(assignments: Sequence[Assignment], compiler: Compiler) -> list[tuple[str, Thunk]]:
    return [(assignment.name, compiler.thunk(assignment.value)) for assignment in assignments]
