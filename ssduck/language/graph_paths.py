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
        found: whether a path may end here; then it goes no further.
        next: the rows of its state, in order.
        distance: how many steps it is from the nearest one that is found.
    """

    value: T
    found: bool
    next: list[Vertex[T]] = field(default_factory=list)
    distance: int | None = None


def simple_paths(
    roots: Sequence[Vertex[T]],
    vertices: Sequence[Vertex[T]],
    longest: int | None,
    count: Callable[[], None],
) -> Iterator[list[T]]:
    """Yields the simple paths from a root to a vertex that is found, shortest first.

    All simple paths of any length are more than anybody can wait for: without a longest length
    they are those that are as short as the shortest.

    At the end the graph is taken apart, for the garbage collector would be slower.

    Args:
        roots: where paths begin.
        vertices: all there are.
        longest: how many vertices a path may have; None for as few as any path has.
        count: is called once a step.
    """
    _measure(vertices)
    most = _shortest(roots) if longest is None else min(longest, len(vertices))
    try:
        for length in range(1, most + 1):
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


def _measure(vertices: Sequence[Vertex[T]]) -> None:
    before: dict[Vertex[T], list[Vertex[T]]] = {}
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


def _paths_of_length(
    root: Vertex[T], length: int, count: Callable[[], None]
) -> Iterator[list[Vertex[T]]]:
    if root.found:
        if length == 1:
            yield [root]
        return
    path = [root]
    met = {root}
    open_ones = [iter(root.next)]
    while open_ones:
        count()
        vertex = next(open_ones[-1], None)
        if vertex is None:
            open_ones.pop()
            met.discard(path.pop())
            continue
        left = length - len(path) - 1
        if vertex.distance is None or vertex.distance > left or vertex in met:
            continue
        if vertex.found:
            if left == 0:
                yield [*path, vertex]
            continue
        path.append(vertex)
        met.add(vertex)
        open_ones.append(iter(vertex.next))
