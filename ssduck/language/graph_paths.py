"""Finds simple paths in the graph of MEMORIZE, whose vertices are distinct selected rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

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
