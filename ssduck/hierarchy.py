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
from itertools import count, islice
from typing import Any, TypeAlias

from ssduck.adapters import Rows
from ssduck.dependencies import is_impure
from ssduck.errors import ArgumentError, LimitError
from ssduck.evaluate import Compiler, Frame, Keys, Thunk, check_size, hashable
from ssduck.graphs import Vertex, simple_paths
from ssduck.rows import Clauses, Paths, Selected, checked_count
from ssduck.tree import Assignment, Node, Query, Recursion

# So many states keep their rows, so that a state that is reached again costs nothing.
MOST_STATES = 10_000


class Step:
    """A row in a state: its frame, what is selected of it, and what this is called.

    Attributes:
        frame: what the row's expressions see.
        values: what is selected.
        names: what that is called.
        stops: whether STOP WITH holds.
        found: whether a path up to this row is a result.
        after: the rows of the state after its step, once they are asked for.
    """

    __slots__ = ("_key", "after", "found", "frame", "names", "stops", "values")

    def __init__(
        self,
        frame: Frame,
        values: tuple[Any, ...],
        names: tuple[Any, ...],
        stops: bool,
        found: bool,
    ) -> None:
        self.frame = frame
        self.values = values
        self.names = names
        self.stops = stops
        self.found = found
        self.after: Steps | None = None
        self._key: int | None = None

    def key(self, keys: Keys) -> int:
        """What rows are told apart by: a number for what is selected and what it is called."""
        if self._key is None:
            self._key = keys.of(self.values, self.names)
        return self._key


class Steps:
    """The rows of a state, in order, each one made when it is first asked for.

    Args:
        steps: makes them.
    """

    __slots__ = ("_is_complete", "_made", "_steps")

    def __init__(self, steps: Iterator[Step]) -> None:
        self._steps = steps
        self._made: list[Step] = []
        self._is_complete = False

    def __iter__(self) -> Iterator[Step]:
        return iter(self._made) if self._is_complete else self._making()

    def _making(self) -> Iterator[Step]:
        yield from self._made
        for index in count(len(self._made)):
            if index >= len(self._made):  # nobody else has asked for it meanwhile
                step = next(self._steps, None)
                if step is None:
                    self._is_complete = True
                    return
                self._made.append(step)
            yield self._made[index]


RowsOf: TypeAlias = Callable[[dict[str, Any]], Iterator[Frame]]


class _States:
    """The rows of each state that was reached; those of equal states are the same.

    Args:
        steps: makes the rows of a state.
        most: so many states are kept; the others are made each time.
    """

    def __init__(self, steps: Callable[[dict[str, Any]], Iterator[Step]], most: int) -> None:
        self._steps = steps
        self._most = most
        self._known: dict[Any, Steps] = {}

    def __call__(self, state: dict[str, Any]) -> Steps:
        """The rows of a state."""
        try:
            key = hashable(state)
        except ArgumentError:  # it cannot be told apart from others
            return Steps(self._steps(state))
        found = self._known.get(key)
        if found is None:
            found = Steps(self._steps(state))
            if len(self._known) < self._most:
                self._known[key] = found
        return found


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
        # What happens at a row of a query that does something is to happen each time.
        self._most_states = 0 if is_impure(query) else MOST_STATES

    def selected(self, outer: Frame, rows: RowsOf) -> Selected:
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
        states = _States(lambda state: map(self._step, rows(state)), self._most_states)
        search = self._graph_paths if recursion.memorizes else self._depth_first
        paths = search(outer, states, state)
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
        values, names = items.values(frame), items.names(frame)
        stops = bool(self._stop(frame))
        found = stops if self._where is None else bool(self._where(frame))
        return Step(frame, values, names, stops, found)

    def _after(self, step: Step, states: _States) -> Steps:
        """The rows of the state after a row; all of CONNECT BY sees the state before it."""
        if step.after is None:
            frame = step.frame
            state = dict(frame.local)
            for name, value in self._next:
                state[name] = value(frame)
                check_size(state[name], self._recursion.span)
            step.after = states(state)
        return step.after

    # -- searches -------------------------------------------------------------------------

    def _depth_first(
        self, outer: Frame, states: _States, state: dict[str, Any]
    ) -> Iterator[list[Step]]:
        """The paths in depth-first order of the sources."""
        recursion = self._recursion
        tells_apart = recursion.no_cycle or recursion.unique
        keys = Keys()
        visited: set[int] = set()
        path: list[Step] = []
        open_rows = [iter(states(state))]
        count_step = outer.scope.meter.step
        while open_rows:
            step = next(open_rows[-1], None)
            count_step()
            if step is None:
                open_rows.pop()
                if path:
                    left = path.pop()
                    if recursion.no_cycle and not recursion.unique:
                        visited.discard(left.key(keys))
                continue
            if tells_apart and step.key(keys) in visited:
                continue
            if step.found:
                yield [*path, step]
            ends = step.found or step.stops
            if tells_apart and not (step.stops if recursion.unique else ends):
                visited.add(step.key(keys))
            if not ends:
                path.append(step)
                self._check_depth(len(path), "a path", "rows")
                open_rows.append(iter(self._after(step, states)))

    def _check_depth(self, depth: int, what: str, parts: str) -> None:
        if depth >= self._deepest:
            raise LimitError(
                f"{what} has more than {self._deepest} {parts}; bound the search in STOP WITH, "
                "or with MEMORIZE n, or raise Limits(depth=…)",
                span=self._recursion.span,
            )

    def _graph_paths(
        self, outer: Frame, states: _States, state: dict[str, Any]
    ) -> Iterator[list[Step]]:
        """The simple paths through the graph of distinct selected rows, shortest first."""
        levels = self._number(self._recursion.memorize, "MEMORIZE", outer)
        roots, vertices = self._graph(states, state, levels)
        return simple_paths(roots, vertices, levels, outer.scope.meter.step)

    def _graph(
        self, states: _States, state: dict[str, Any], levels: int | None
    ) -> tuple[list[Vertex[Step]], list[Vertex[Step]]]:
        """The distinct rows that are reached, breadth first, and those of the first level."""
        keys = Keys()
        known: dict[int, Vertex[Step]] = {}
        waiting: deque[tuple[Vertex[Step], int]] = deque()

        def reached(steps: Steps, level: int) -> list[Vertex[Step]]:
            found: dict[Vertex[Step], None] = {}  # in order, each one once
            for step in steps:
                if step.stops and not step.found:
                    continue
                vertex = known.get(step.key(keys))
                if vertex is None:
                    vertex = known[step.key(keys)] = Vertex(step, step.found)
                    if not step.found:
                        waiting.append((vertex, level))
                found[vertex] = None
            return list(found)

        roots = reached(states(state), 1) if levels != 0 else []
        while waiting:
            vertex, level = waiting.popleft()
            if levels is None or level < levels:
                self._check_depth(level, "the graph", "levels")
                vertex.next = reached(self._after(vertex.value, states), level + 1)
        return roots, list(known.values())


def _assignments(assignments: Sequence[Assignment], compiler: Compiler) -> list[tuple[str, Thunk]]:
    return [(assignment.name, compiler.thunk(assignment.value)) for assignment in assignments]
